"""The worker's side of a cluster: does a task in a process of its own, and tells how far it is.

The process keeps what happens to a run apart from what happens to the worker: a run that crashes, or is killed
for its memory, is a failed run, and only a machine that is gone is a lost worker. It also keeps runs on the
threads of one worker out of each other's way.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import pathlib
import tempfile
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait
from typing import Any

import distributed
from distributed.core import Status

import benchmarks
import bgn
from benchmarks.events import Advanced, Finished
from benchmarks.executors.processes import Worker, stop
from benchmarks.tasks import Failure, Task, Work
from bgn.errors import BgnError
from bgn.training.cell import Progress

_PATIENCE_SECONDS = 1.0  # how long a task goes on that nobody wants any more


class OtherSourcesError(BgnError, RuntimeError):
    """A worker would run other code than what the results would be stored under."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """A task on its way to a worker."""

    number: int
    """What the worker calls the task when it reports."""
    task: Task
    work: Work
    topic: str
    """Where the worker reports."""
    sources: str
    """What :func:`sources` is at the sender."""
    token: str
    """Name of a file in the work folder of the task's store; whoever sees it shares the store."""


@dataclass(frozen=True)
class Outcome:
    """How a task ended."""

    failure: Failure | None
    files: Mapping[str, bytes] = field(default_factory=dict)
    """What it stored, by path below the store's root, if the worker does not share the store."""


def sources() -> str:
    """Hash every file of this project's packages: code, compiled tables, scenes and the registry."""
    digest = hashlib.sha256()
    for package in (bgn, benchmarks):
        root = pathlib.Path(str(package.__file__)).parent
        for path in sorted(root.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(f"{path.relative_to(root)} {path.stat().st_size} ".encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def token_path(store: pathlib.Path, token: str) -> pathlib.Path:
    """Return where the sender leaves the file that shows who shares the store."""
    return store / ".work" / f".{token}.partial"  # swept up with torn writes if it is left behind


def perform(order: Order) -> Outcome:
    """Do a task, in a thread of a Dask worker.

    Raises
    ------
    OtherSourcesError
        The worker has other sources than the sender.
    """
    if sources() != order.sources:
        raise OtherSourcesError(
            f"the worker {distributed.get_worker().address} has another version of bgn in "
            f"{pathlib.Path(bgn.__file__).parent}; install the same on every machine"
        )
    if token_path(order.task.store, order.token).exists():
        return Outcome(_do(order, order.task))
    with tempfile.TemporaryDirectory(prefix="bgn-") as folder:
        store = pathlib.Path(folder)
        failure = _do(order, replace(order.task, store=store))
        return Outcome(failure, _shards(store))


def _shards(store: pathlib.Path) -> dict[str, bytes]:
    paths = [path.relative_to(store) for path in store.rglob("*") if path.is_file()]
    return {str(path): (store / path).read_bytes() for path in paths if path.parts[0] != ".work"}


def _do(order: Order, task: Task) -> Failure | None:
    worker = distributed.get_worker()
    key = worker.get_current_task()

    def tell(**message: Any) -> None:
        worker.log_event(order.topic, {"number": order.number, **message})

    process = _hire(order.work)
    try:
        process.start(task)
        tell(started=worker.address)
        failure = _follow(
            process, lambda progress: tell(progress=_plain(progress)), lambda: _wanted(worker, key)
        )
    except BaseException:
        stop([process])
        raise
    if process.alive:
        _idle.append((order.work, process))
    else:
        stop([process])
    return failure


def _follow(process: Worker, tell: Callable[[Progress], None], wanted: Callable[[], bool]) -> Failure | None:
    """Wait for the end of a process's task; raise if it is not wanted any more."""
    while wanted():
        wait([process.connection], timeout=_PATIENCE_SECONDS)
        for message in process.messages():
            event = process.event(message)
            if isinstance(event, Advanced):
                tell(event.progress)
            elif isinstance(event, Finished):
                return event.failure
        if not process.alive:
            return process.died().failure
    raise distributed.Reschedule  # a worker that is asked to go leaves its task to others


def _plain(progress: Progress) -> list[Any]:
    """Return a progress as plain numbers and text, in the order of its fields."""
    return [
        int(progress.env_steps),
        int(progress.total_env_steps),
        float(progress.steps_per_second),
        float(progress.return_100),
        progress.stage,
    ]


def _wanted(worker: distributed.Worker, key: object) -> bool:
    """Say whether anybody waits for a task: the worker stays, and its scheduler has not taken the task back."""
    if worker.status not in (Status.running, Status.paused):
        return False
    task = worker.state.tasks.get(key)  # type: ignore[call-overload]
    return task is not None and task.state == "executing"


_idle: list[tuple[Work, Worker]] = []
"""Processes between two tasks, ready for the next one."""
_starting = threading.Lock()


def _hire(work: Work) -> Worker:
    """Return an idle process, or a new one."""
    while True:
        try:
            knows, process = _idle.pop()
        except IndexError:
            break
        if knows == work and process.process.is_alive():
            return process
        stop([process])
    with _starting:  # starting a process changes this one's environment for a moment
        # Dask's nanny marks its workers as daemons, which may have no children. Ours do not outlive their pipe.
        multiprocessing.current_process().daemon = False
        return Worker(work)
