"""Runs tasks on the workers of a Dask cluster; a worker that is lost is replaced, a run that fails is not repeated.

Tasks are handed out one by one as workers are free, the longest first. What a worker reports, and how a task
ends, arrives here in one queue and leaves as the same events as from worker processes of this machine.
"""

from __future__ import annotations

import pathlib
import queue
import time
import traceback
import uuid
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace
from typing import Any

import distributed
from dask.typing import Key
from distributed.scheduler import KilledWorker

from benchmarks.events import Advanced, Event, Finished, Idle, Restarted, Started
from benchmarks.executors.remote import Order, Outcome, perform, sources, token_path
from benchmarks.executors.sites import SchedulerLostError, Site
from benchmarks.tasks import Failure, Task, Work, now, record_failure
from bgn.results.store import Store, StoreError
from bgn.training.cell import Progress

_SECONDS_BETWEEN_COUNTS = 2.0


def run_tasks(
    tasks: Sequence[Task], *, site: Site, work: Work, tick: float | None = None
) -> Generator[Event | Idle]:
    """Do all tasks, in order, as many at a time as the site has workers; yield what happens.

    With ``tick`` it yields :class:`~benchmarks.events.Idle` whenever nothing happened for that many seconds.

    Closing the iterator makes the workers stop; checkpoints in a shared store stand.

    Raises
    ------
    SchedulerLostError
        The scheduler is gone, and with it everything that was not stored.
    StoreError
        A worker cannot write, for lack of space or of permission.
    """
    run = _Run(tasks, site, work)
    try:
        yield from run.events(tick)
    finally:
        run.close()


class _Run:
    """Tasks on their way through a cluster."""

    def __init__(self, tasks: Sequence[Task], site: Site, work: Work) -> None:
        self.tasks, self.site, self.work = tasks, site, work
        self.topic = f"bgn-{uuid.uuid4().hex}"
        self.sources = sources()
        self.waiting = deque(range(len(tasks)))
        self.flying: dict[Key, int] = {}
        """Keys of what the scheduler was given, and the task's number."""
        self.futures: dict[Key, distributed.Future[Outcome]] = {}
        self.started: set[int] = set()
        self.farthest = [0] * len(tasks)
        """Steps that a task ever reported."""
        self.farthest_before = [-1] * len(tasks)
        """The same when it was last given to the scheduler."""
        self.workers, self.counted = site.expected, 0.0
        self.messages: queue.SimpleQueue[dict[str, Any] | distributed.Future[Outcome]] = queue.SimpleQueue()
        self.tokens = {token_path(task.store, self.topic) for task in tasks}

    def events(self, tick: float | None) -> Iterator[Event | Idle]:
        for token in self.tokens:
            token.parent.mkdir(parents=True, exist_ok=True)
            token.touch()
        self.site.client.subscribe_topic(self.topic, lambda event: self.messages.put(event[1]))
        while self.waiting or self.flying:
            self._count()
            while self.waiting and len(self.flying) < max(self.workers, 1):
                self._submit(self.waiting.popleft())
            yield from self._next(tick)

    def close(self) -> None:
        """Take back what is still out."""
        for token in self.tokens:
            token.unlink(missing_ok=True)
        if self.site.client.status == "running":
            self.site.client.cancel(list(self.futures.values()))
            self.site.client.unsubscribe_topic(self.topic)

    def _count(self) -> None:
        """Count the workers now and then: they come and go."""
        if time.monotonic() - self.counted > _SECONDS_BETWEEN_COUNTS:
            self.workers = self.site.workers(wanted=len(self.waiting) + len(self.flying))
            self.counted = time.monotonic()

    def _submit(self, number: int) -> None:
        task = self.tasks[number]
        self.farthest_before[number] = self.farthest[number]
        order = Order(
            number=number,
            task=replace(task, store=pathlib.Path(task.store).resolve()),
            work=self.work,
            topic=self.topic,
            sources=self.sources,
            token=self.topic,
        )
        key = f"{task.name}-{uuid.uuid4().hex}"
        self.flying[key] = number
        self.futures[key] = self.site.client.submit(perform, order, key=key, pure=False)
        self.futures[key].add_done_callback(self.messages.put)

    def _next(self, tick: float | None) -> Iterator[Event | Idle]:
        try:
            message = self.messages.get(timeout=_SECONDS_BETWEEN_COUNTS if tick is None else tick)
        except queue.Empty:
            if self.site.client.status != "running":
                raise self._lost() from None
            if tick is not None:
                yield Idle()
            return
        if isinstance(message, distributed.Future):
            yield from self._ended(message)
        elif message["number"] in self.flying.values():  # reports may come after the end
            yield from self._reported(message["number"], message)

    def _reported(self, number: int, message: dict[str, Any]) -> Iterator[Event]:
        task = self.tasks[number]
        if number in self.started and "started" in message:
            yield Restarted(task, f"its worker was lost; {message['started']} goes on")
        yield from self._start(number)
        if "progress" in message:
            progress = Progress(*message["progress"])
            self.farthest[number] = max(self.farthest[number], progress.env_steps)
            yield Advanced(task, progress)

    def _start(self, number: int) -> Iterator[Event]:
        if number not in self.started:
            self.started.add(number)
            yield Started(self.tasks[number])

    def _ended(self, future: distributed.Future[Outcome]) -> Iterator[Event]:
        number = self.flying.pop(future.key)
        del self.futures[future.key]
        task = self.tasks[number]
        if future.cancelled():
            raise self._lost()
        error = future.exception()
        if isinstance(error, StoreError):
            raise error
        if isinstance(error, KilledWorker) and self.farthest[number] > self.farthest_before[number]:
            self.waiting.appendleft(number)  # it got further each time: no fault of the task
            return
        failure = self._adopt(task, future.result()) if error is None else _failure(error)
        if error is not None:
            record_failure(task, _failure(error))
        yield from self._start(number)
        yield Finished(task, failure)

    def _adopt(self, task: Task, outcome: Outcome) -> Failure | None:
        Store(task.store).adopt(task.kind, task.runs, outcome.files)
        return outcome.failure

    def _lost(self) -> SchedulerLostError:
        return SchedulerLostError(
            f"the Dask scheduler at {self.site.address} is gone; finished runs are stored, and the same command "
            "goes on from there once a scheduler is back"
        )


def _failure(error: BaseException) -> Failure:
    """Describe what kept a task from ending by itself."""
    if isinstance(error, KilledWorker):
        text = "its worker was lost again and again without getting further; out of memory, perhaps"
        return Failure(f"{text} (last: {error.last_worker.address})", str(error), now())
    lines = traceback.format_exception(error)
    return Failure(f"{type(error).__name__}: {error}", "".join(lines), now())
