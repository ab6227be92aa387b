"""Ends a command in an orderly way when a signal asks for it: Ctrl-C, SIGTERM or SIGHUP."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType

#: Signals that ask a command to end.
ASKING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stopped(BaseException):
    """A signal asked the command to end; no failure, so not an ``Exception``."""

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signal = signal.Signals(signum)

    @property
    def exit_status(self) -> int:
        """128 and the signal's number, as shells have it: 130 (SIGINT), 143 (SIGTERM), 129 (SIGHUP)."""
        return 128 + self.signal


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Raise :class:`Stopped` in the main thread when a signal asks to end.

    What is ignored stays ignored: ``nohup`` means it.
    """
    before = {one: signal.getsignal(one) for one in ASKING}
    for one, handler in before.items():
        if handler != signal.SIG_IGN:
            signal.signal(one, _raise)
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Let these signals wait, for this thread and for processes started in it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _raise(signum: int, frame: FrameType | None) -> None:
    raise Stopped(signum)
