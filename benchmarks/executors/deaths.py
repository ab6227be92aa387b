"""What the death of a process means for its task: what it stored before stays, and only the rest has failed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from benchmarks.tasks import Failure, PhysicsTask, ReferenceTask, Task, record_failure
from bgn.results.store import Store, read_shard


def unstored(task: Task) -> Task | None:
    """Return what of a task has no result yet; None if all has: its process may have had no time to say so."""
    if isinstance(task, ReferenceTask):
        return None if _is_stored(task, task.name) else task
    left = tuple(_seeds_left(task))
    return replace(task, seeds=left) if left else None


def record_death(task: Task, failure: Failure) -> Failure | None:
    """Store a failure for every run that a process had not stored when it died; None if there is none."""
    left = unstored(task)
    if left is None:
        return None
    record_failure(left, failure)
    return failure


def _seeds_left(task: Task) -> Iterator[int]:
    assert not isinstance(task, ReferenceTask)
    return (seed for run, seed in zip(task.runs, task.seeds, strict=True) if not _is_stored(task, run))


def _is_stored(task: Task, run: str) -> bool:
    """Say whether the result of a run is there; one to be filled in, whether nothing is missing from it."""
    shard = Store(task.store).shard(task.kind, run)
    if not shard.exists():
        return False
    (row,) = read_shard(shard).to_pylist()
    filled_in = not isinstance(task, PhysicsTask) or row.get("missing") is None
    return bool(row["key"] == task.origin.key and row["status"] == "ok" and filled_in)
