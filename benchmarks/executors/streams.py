"""Runs cells side by side on one GPU, each in a thread and on a CUDA stream of its own.

An update is one CUDA graph whose kernels are far too small for the device; what fills it is many cells at once.
Processes would take turns on the device, where the streams of one process share it. So all cells run in one
process, and that is not the parent's: an error of CUDA leaves a process unable to use the device, whatever it
does. Then the cell that met it has failed, and a fresh process goes on with the others from their checkpoints.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
import traceback
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from benchmarks.events import Advanced, Event, Finished, Idle, Started
from benchmarks.executors import lifeline
from benchmarks.executors.deaths import record_death, unstored
from benchmarks.executors.processes import CONTEXT, ONE_THREAD, describe_exit, environment
from benchmarks.signals import held_back
from benchmarks.tasks import Failure, Task, Work, execute, now
from bgn.results.store import StoreError
from bgn.training.cell import Interrupted, Progress

#: Cells run on streams of their own; by default the driver would queue them all in eight.
VARIABLES = {"CUDA_DEVICE_MAX_CONNECTIONS": "32", **ONE_THREAD}
#: Processes that may end for no known reason while a task is running, before the task is given up.
MAX_DEATHS = 2
_GRACE_SECONDS = 20.0  # for up to 31 checkpoints
_POLL_SECONDS = 0.1
_LOST = 3  # exit status of a process that has lost its device

#: What a process says of a task, by its place in the list: that it started, how far it is, how it ended.
_Message = tuple[int, type[Started] | Progress | Failure | StoreError | None]


def run_tasks(
    tasks: Sequence[Task], *, jobs: int, work: Work, tick: float | None = None
) -> Generator[Event | Idle]:
    """Do all tasks, in order, at most ``jobs`` at a time; yield what happens.

    With ``tick`` it yields :class:`~benchmarks.events.Idle` whenever nothing happened for that many seconds.
    Closing the iterator stops the threads at their next report of progress, each with a checkpoint written.

    Raises
    ------
    StoreError
        Nothing more can be written.
    """
    left, seen, deaths = list(tasks), set[str](), Counter[str]()
    while left:
        process = _Process(left, jobs, work)
        try:
            for event in process.events(tick):
                if isinstance(event, Started):
                    if event.task.name in seen:  # it goes on in a fresh process
                        continue
                    seen.add(event.task.name)
                yield event
        finally:
            process.stop()
        left = process.unfinished
        if process.lost_device:
            continue
        for task in process.running or left[:1]:
            deaths[task.name] += 1
            if unstored(task) and deaths[task.name] < MAX_DEATHS:
                continue
            left.remove(task)
            if task.name not in seen:  # no process came so far as to start anything
                yield Started(task)
            yield Finished(task, _given_up(task, process))


def _given_up(task: Task, process: _Process) -> Failure | None:
    why = describe_exit(process.exitcode)
    failure = Failure(
        f"the GPU's process died {MAX_DEATHS} times while it ran ({why})", "", process.started_at
    )
    return record_death(task, failure)


class _Process:
    """The process that has the GPU, seen from the parent."""

    def __init__(self, tasks: Sequence[Task], jobs: int, work: Work) -> None:
        self.tasks, self.started_at = tasks, now()
        self.unfinished, self.running = list(tasks), list[Task]()
        self.connection, theirs = CONTEXT.Pipe()
        arguments = (theirs, list(tasks), jobs, work, os.getpid())
        self.process: BaseProcess = CONTEXT.Process(target=_serve, args=arguments, daemon=True)
        resource_tracker.ensure_running()
        with environment(VARIABLES), held_back():
            self.process.start()
        theirs.close()

    def events(self, tick: float | None) -> Iterator[Event | Idle]:
        """Yield what the process tells, until it is gone."""
        with contextlib.suppress(EOFError, ConnectionResetError):
            while True:
                if not self.connection.poll(tick):
                    yield Idle()
                    continue
                yield self._event(*self.connection.recv())
        self.process.join(_GRACE_SECONDS)

    def _event(self, place: int, said: Any) -> Event:
        task = self.tasks[place]
        if said is Started:
            self.running.append(task)
            return Started(task)
        if isinstance(said, Progress):
            return Advanced(task, said)
        if isinstance(said, StoreError):
            raise said
        self.running.remove(task)
        self.unfinished.remove(task)
        return Finished(task, said)

    @property
    def exitcode(self) -> int | None:
        """How it ended."""
        return self.process.exitcode

    @property
    def lost_device(self) -> bool:
        """Whether it ended because its device failed."""
        return self.exitcode == _LOST

    def stop(self) -> None:
        """Ask the process to end, after its cells have written checkpoints; end it after a while."""
        try:
            with contextlib.suppress(OSError):
                self.connection.send(None)
            self._drain(time.monotonic() + _GRACE_SECONDS)
        finally:
            if self.process.is_alive():
                self.process.kill()
            self.process.join()
            self.connection.close()

    def _drain(self, deadline: float) -> None:
        """Read what nobody waits for any more, so that the process is never held up by a full pipe."""
        with contextlib.suppress(EOFError, ConnectionResetError):
            while self.connection.poll(max(0.0, deadline - time.monotonic())):
                self.connection.recv()


def _serve(connection: Connection[Any, Any], tasks: list[Task], jobs: int, work: Work, parent: int) -> None:
    """Do the tasks in threads; the body of the process."""
    lifeline.hold(parent)
    _Threads(connection, tasks, jobs, work).run()


class _Threads:
    """The cells of one process, and what they tell."""

    def __init__(self, connection: Connection[Any, Any], tasks: list[Task], jobs: int, work: Work) -> None:
        self.connection, self.tasks, self.work = connection, tasks, work
        self.pool = ThreadPoolExecutor(min(jobs, len(tasks)))
        self.messages: queue.SimpleQueue[_Message | Exception] = queue.SimpleQueue()
        self.stopped = threading.Event()

    def run(self) -> None:
        for place in range(len(self.tasks)):
            self.pool.submit(self._do, place)
        left = len(self.tasks)
        try:
            while left and not self._asked_to_stop():
                with contextlib.suppress(queue.Empty):
                    message = self.messages.get(timeout=_POLL_SECONDS)
                    left -= self._tell(message)
        except OSError:  # the parent is gone: nobody wants the rest, and checkpoints stand
            os._exit(1)
        self.stopped.set()
        self.pool.shutdown(cancel_futures=True)

    def _tell(self, message: _Message | Exception) -> bool:
        """Pass a message on; say whether it was a task's last one."""
        if isinstance(message, Exception):
            traceback.print_exception(message)
            os._exit(1)
        self.connection.send(message)
        _, said = message
        if isinstance(said, Failure) and said.device_lost:
            os._exit(_LOST)  # at once: other threads may wait for the device for ever
        return said is None or isinstance(said, Failure)

    def _asked_to_stop(self) -> bool:
        return self.connection.poll()

    def _do(self, place: int) -> None:
        """Do one task, in a thread."""

        def report(progress: Progress) -> None:
            if self.stopped.is_set():
                raise Interrupted
            self.messages.put((place, progress))

        self.messages.put((place, Started))
        try:
            self.messages.put((place, execute(self.tasks[place], self.work, report)))
        except Interrupted:
            return
        except StoreError as error:
            self.messages.put((place, error))
        except Exception as error:  # not the task's failure: it ends the process
            self.messages.put(error)
