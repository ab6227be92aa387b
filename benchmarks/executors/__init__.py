"""Where tasks run: worker processes, or the streams of one GPU."""

from __future__ import annotations

from collections.abc import Generator

from benchmarks.events import Event, Idle

#: Events of one executor before it is another's turn.
_TURN = 64


def beside(*executors: Generator[Event | Idle]) -> Generator[Event | Idle]:
    """Run several executors side by side; each must yield :class:`~benchmarks.events.Idle` when it waits.

    Closing the iterator closes them all.
    """
    running = list(executors)
    try:
        while running:
            for executor in list(running):
                for _ in range(_TURN):
                    event = next(executor, None)
                    if event is None:
                        running.remove(executor)
                        break
                    yield event
                    if isinstance(event, Idle):
                        break
    finally:
        for executor in running:
            executor.close()
