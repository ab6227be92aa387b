"""What an executor tells of its tasks."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.tasks import Failure, Task
from bgn.training.cell import Progress


@dataclass(frozen=True)
class Started:
    """A worker took up a task."""

    task: Task


@dataclass(frozen=True)
class Advanced:
    """A task came further."""

    task: Task
    progress: Progress


@dataclass(frozen=True)
class Restarted:
    """A task's worker was lost; another one took the task up, from its last checkpoint if it has one."""

    task: Task
    reason: str


@dataclass(frozen=True)
class Finished:
    """A task ended; what it yielded (or its failure) is stored."""

    task: Task
    failure: Failure | None


@dataclass(frozen=True)
class Idle:
    """Nothing happened for a while: another executor, or a clock, may have its turn."""


Event = Started | Advanced | Restarted | Finished
