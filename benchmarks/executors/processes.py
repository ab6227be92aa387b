"""Runs tasks side by side in worker processes of this machine; a worker that dies fails only its task.

Signals are the parent's to answer: workers hold them back, and are told to stop through their pipe, so that
they leave a checkpoint. None outlives its parent.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from benchmarks.events import Advanced, Event, Finished, Idle, Started
from benchmarks.executors import lifeline
from benchmarks.executors.deaths import record_death
from benchmarks.signals import held_back
from benchmarks.tasks import Failure, PhysicsTask, ReferenceTask, Task, Work, execute, now
from bgn.results.store import StoreError
from bgn.training.cell import Interrupted, Progress

#: One thread a worker: cells run side by side, so more would only fight over the cores.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
CONTEXT = multiprocessing.get_context("spawn")  # fork would copy the state of torch's and numba's threads
_GRACE_SECONDS = 10.0


def run_tasks(
    tasks: Sequence[Task], *, jobs: int, work: Work, tick: float | None = None
) -> Generator[Event | Idle]:
    """Do all tasks, in order, at most ``jobs`` at a time; yield what happens.

    With ``tick`` it yields :class:`~benchmarks.events.Idle` whenever nothing happened for that many seconds.

    Closing the iterator (or an exception in the caller, such as Ctrl-C) stops the workers, whose cells leave
    checkpoints.

    Raises
    ------
    StoreError
        A worker cannot write, for lack of space or of permission.
    """
    waiting = deque(tasks)
    workers: list[Worker] = []
    try:
        while waiting or workers:
            while waiting and len(workers) < jobs:
                workers.append(Worker(work))
                yield workers[-1].start(waiting.popleft())
            ready = _ready(workers, tick)
            if not ready:
                yield Idle()
            for worker in ready:
                for message in worker.messages():
                    yield worker.event(message)
                if worker.task is None and waiting and worker.alive:
                    yield worker.start(waiting.popleft())
                elif worker.task is None or not worker.alive:
                    workers.remove(worker)
                    if worker.task is not None:
                        yield worker.died()
                    stop([worker])
    finally:
        stop(workers)


class Worker:
    """A process that does one task after another, seen from the parent."""

    def __init__(self, work: Work) -> None:
        self.task: Task | None = None
        self.started_at = now()
        self.alive = True
        self.connection, theirs = CONTEXT.Pipe()
        arguments = (theirs, work, os.getpid())
        self.process: BaseProcess = CONTEXT.Process(target=_serve, args=arguments, daemon=True)
        resource_tracker.ensure_running()  # or the first worker's start does it, and lets signals through
        with environment(ONE_THREAD), held_back():
            self.process.start()
        theirs.close()

    def start(self, task: Task) -> Started:
        """Hand the process a task."""
        self.task, self.started_at = task, now()
        with contextlib.suppress(BrokenPipeError):  # it died just now; the next wait() reports it
            self.connection.send(task)
        return Started(task)

    def messages(self) -> Iterator[Any]:
        """Yield what the process sent since the last call; note if it is gone."""
        try:
            while self.connection.poll():
                yield self.connection.recv()
        except (EOFError, ConnectionResetError):
            self.alive = False

    def event(self, message: Progress | Failure | StoreError | None) -> Event:
        """Translate a message: progress, or how the task ended; raise what ends all work."""
        if isinstance(message, StoreError):
            self.task = None
            raise message
        assert self.task is not None
        if isinstance(message, Progress):
            return Advanced(self.task, message)
        task, self.task = self.task, None
        return Finished(task, message)

    def died(self) -> Finished:
        """Record that the process ended in the middle of its task; what it had stored stands."""
        assert self.task is not None
        self.process.join(_GRACE_SECONDS)
        error = f"the worker process died ({describe_exit(self.process.exitcode)})"
        return Finished(self.task, record_death(self.task, Failure(error, "", self.started_at)))

    def ask_to_stop(self) -> None:
        """Ask the process to end: at its next report of progress, after writing a checkpoint."""
        with contextlib.suppress(OSError):
            self.connection.send(None)
        # These report nothing, and would have nothing to keep.
        if isinstance(self.task, PhysicsTask | ReferenceTask):
            self.process.kill()

    def end(self, deadline: float) -> None:
        """Wait for the process to end, and make it end at the deadline."""
        self.process.join(max(0.0, deadline - time.monotonic()))
        self.kill()
        self.connection.close()

    def kill(self) -> None:
        """End the process at once."""
        if self.process.is_alive():
            self.process.kill()
        self.process.join()


def stop(workers: Sequence[Worker]) -> None:
    """End all workers together: asked first, then, or when this is interrupted in turn, at once."""
    try:
        for worker in workers:
            worker.ask_to_stop()
        deadline = time.monotonic() + _GRACE_SECONDS
        for worker in workers:
            worker.end(deadline)
    finally:
        for worker in workers:
            worker.kill()


def _ready(workers: Sequence[Worker], tick: float | None) -> list[Worker]:
    connections = wait([worker.connection for worker in workers], tick)
    return [worker for worker in workers if worker.connection in connections]


def _serve(connection: Connection[Any, Any], work: Work, parent: int) -> None:
    """Do tasks until the parent hangs up or says stop; the body of a worker process."""
    lifeline.hold(parent)

    def report(message: Progress | Failure | StoreError | None) -> None:
        try:
            if isinstance(message, Progress) and connection.poll():
                raise Interrupted  # nothing but a request to stop comes in the middle of a task
            connection.send(message)
        except OSError:  # the parent is gone: nobody wants the rest, and the checkpoint stands
            os._exit(1)

    with contextlib.suppress(EOFError, ConnectionResetError, Interrupted):
        while task := connection.recv():
            outcome: Failure | StoreError | None
            try:
                outcome = execute(task, work, report)
            except StoreError as error:
                outcome = error
            report(outcome)


@contextlib.contextmanager
def environment(variables: dict[str, str]) -> Iterator[None]:
    """Let processes that are started meanwhile have these variables."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def describe_exit(code: int | None) -> str:
    """Say how a process ended."""
    if code is not None and code < 0:
        return f"{signal.Signals(-code).name}; out of memory, or killed"
    return f"exit status {code}"
