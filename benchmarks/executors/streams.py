"""Runs cells side by side on one GPU, each in a thread and on a CUDA stream of its own.

An update is one CUDA graph whose kernels are far too small for the device; what fills it is many cells at once.
Processes would take turns on the device, where the streams of one process share it.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from benchmarks.events import Advanced, Event, Finished, Started
from benchmarks.tasks import Task, Work, execute
from bgn.training.cell import Progress


class _Stopped(BaseException):
    """Ends a task whose result nobody waits for; not a failure, so not an ``Exception``."""


def run_tasks(tasks: Sequence[Task], *, jobs: int, work: Work) -> Generator[Event]:
    """Do all tasks, in order, at most ``jobs`` at a time; yield what happens.

    Closing the iterator stops the threads at their next report of progress; checkpoints stand.
    """
    stopped = threading.Event()
    messages: queue.SimpleQueue[Event | Future[None]] = queue.SimpleQueue()

    def do(task: Task) -> None:
        def report(progress: Progress) -> None:
            if stopped.is_set():
                raise _Stopped
            messages.put(Advanced(task, progress))

        messages.put(Started(task))
        messages.put(Finished(task, execute(task, work, report)))

    pool = ThreadPoolExecutor(jobs)
    try:
        for task in tasks:
            pool.submit(do, task).add_done_callback(messages.put)
        left = len(tasks)
        while left:
            message = messages.get()
            if isinstance(message, Future):
                message.result()  # raises what is not a failure of the task, such as a full disk
                left -= 1
            else:
                yield message
    finally:
        stopped.set()
        pool.shutdown(cancel_futures=True)
