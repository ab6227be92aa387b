"""Runs tasks side by side in worker processes of this machine; a worker that dies fails only its task."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from benchmarks.events import Advanced, Event, Finished, Started
from benchmarks.tasks import Failure, Task, Work, execute, now, record_failure
from bgn.training.cell import Progress

#: One thread a worker: cells run side by side, so more would only fight over the cores.
_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
_CONTEXT = multiprocessing.get_context("spawn")  # fork would copy the state of torch's and numba's threads
_GRACE_SECONDS = 5.0


def run_tasks(tasks: Sequence[Task], *, jobs: int, work: Work) -> Generator[Event]:
    """Do all tasks, in order, at most ``jobs`` at a time; yield what happens.

    Closing the iterator (or an exception in the caller, such as Ctrl-C) stops the workers.
    """
    waiting = deque(tasks)
    workers: list[_Worker] = []
    try:
        while waiting or workers:
            while waiting and len(workers) < jobs:
                workers.append(_Worker(work))
                yield workers[-1].start(waiting.popleft())
            for worker in _ready(workers):
                for message in worker.messages():
                    yield worker.event(message)
                if worker.task is None and waiting and worker.alive:
                    yield worker.start(waiting.popleft())
                elif worker.task is None or not worker.alive:
                    workers.remove(worker)
                    if worker.task is not None:
                        yield worker.died()
                    worker.stop()
    finally:
        for worker in workers:
            worker.stop()


class _Worker:
    """A process that does one task after another, seen from the parent."""

    def __init__(self, work: Work) -> None:
        self.task: Task | None = None
        self.started_at = now()
        self.alive = True
        self.connection, theirs = _CONTEXT.Pipe()
        self.process: BaseProcess = _CONTEXT.Process(target=_serve, args=(theirs, work), daemon=True)
        with _environment(_ONE_THREAD):
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

    def event(self, message: Progress | Failure | None) -> Event:
        """Translate a message: progress, or how the task ended."""
        assert self.task is not None
        if isinstance(message, Progress):
            return Advanced(self.task, message)
        task, self.task = self.task, None
        return Finished(task, message)

    def died(self) -> Finished:
        """Record that the process ended in the middle of its task."""
        assert self.task is not None
        self.process.join(_GRACE_SECONDS)
        error = f"the worker process died ({_describe_exit(self.process.exitcode)})"
        failure = Failure(error, "", self.started_at)
        record_failure(self.task, failure)
        return Finished(self.task, failure)

    def stop(self) -> None:
        """End the process, whatever it is doing."""
        self.connection.close()
        if self.task is not None:
            self.process.terminate()
        self.process.join(_GRACE_SECONDS)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def _ready(workers: Sequence[_Worker]) -> list[_Worker]:
    connections = wait([worker.connection for worker in workers])
    return [worker for worker in workers if worker.connection in connections]


def _serve(connection: Connection[Any, Any], work: Work) -> None:
    """Do tasks until the parent hangs up; the body of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which stops its workers

    def report(message: Progress | Failure | None) -> None:
        try:
            connection.send(message)
        except OSError:  # the parent is gone: nobody wants the rest, and the checkpoint stands
            os._exit(1)

    with contextlib.suppress(EOFError, ConnectionResetError):
        while True:
            report(execute(connection.recv(), work, report))


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
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


def _describe_exit(code: int | None) -> str:
    if code is not None and code < 0:
        return f"{signal.Signals(-code).name}; out of memory, or killed"
    return f"exit status {code}"
