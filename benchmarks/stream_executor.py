"""Runs cells side by side on one GPU, each in a thread and on a CUDA stream of its own.

An update is one CUDA graph whose kernels are far too small for the device; what fills it is many cells at once.
Processes would take turns on the device, where the streams of one process share it.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Sequence

from benchmarks.events import Advanced, Event, Finished, Started
from benchmarks.tasks import Task, Tools, execute
from bgn.training.cell import Progress


class _Stopped(BaseException):
    """Ends a task whose result nobody waits for; no failure, so not an ``Exception``."""


def run_tasks(tasks: Sequence[Task], *, jobs: int, tools: Tools) -> Generator[Event]:
    """Do all tasks, in order, at most ``jobs`` at a time; yield what happens.

    Closing the iterator stops the threads at their next report of progress; checkpoints stand.
    """
    pool = _Pool(tasks, tools)
    threads = [threading.Thread(target=pool.work, daemon=True) for _ in range(min(jobs, len(tasks)))]
    for thread in threads:
        thread.start()
    try:
        left = len(tasks)
        while left:
            event = pool.events.get()
            left -= isinstance(event, Finished)
            yield event
    finally:
        pool.stopped.set()
        for thread in threads:
            thread.join()


class _Pool:
    """Tasks that wait for a thread, and events that wait for the caller."""

    def __init__(self, tasks: Sequence[Task], tools: Tools) -> None:
        self.tools = tools
        self.stopped = threading.Event()
        self.events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
        for task in tasks:
            self._waiting.put(task)

    def work(self) -> None:
        """Do tasks until none waits; the body of a thread."""
        while not self.stopped.is_set():
            try:
                task = self._waiting.get_nowait()
            except queue.Empty:
                return
            try:
                self._do(task)
            except _Stopped:
                return

    def _do(self, task: Task) -> None:
        def report(progress: Progress) -> None:
            if self.stopped.is_set():
                raise _Stopped
            self.events.put(Advanced(task, progress))

        self.events.put(Started(task))
        self.events.put(Finished(task, execute(task, self.tools, report)))
