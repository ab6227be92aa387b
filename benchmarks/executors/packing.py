"""Which seeds share a stack: whatever a checkpoint holds, and otherwise as many as keep all workers busy.

Seeds that are trained as one stack share most of its time, so a cell's seeds stay together as long as there are cells
for everybody. A seed's curve does not depend on the others in its stack, so no number depends on how cells are split.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace

from benchmarks.tasks import CellTask, Task
from bgn.results.store import Store


def along_checkpoints(tasks: Iterable[Task]) -> list[Task]:
    """Split cells so that every stack that has a checkpoint is taken up as it was left; the longest first."""
    parts = [part for task in tasks for part in _along_checkpoints(task)]
    return sorted(parts, key=lambda task: -task.cost)


def split(tasks: Sequence[Task], workers: int) -> list[Task]:
    """Split cells until there is a task for every worker, or none that can be split; the longest first.

    It is always a cell with the longest parts that gets one part more. What has a checkpoint is not split.
    """
    counts = [1] * len(tasks)
    limits = [_splittable(task) for task in tasks]
    while sum(counts) < workers:
        candidates = [i for i, count in enumerate(counts) if count < limits[i]]
        if not candidates:
            break
        counts[max(candidates, key=lambda i: tasks[i].cost / counts[i])] += 1
    parts = [part for task, count in zip(tasks, counts, strict=True) for part in _parts(task, count)]
    return sorted(parts, key=lambda task: -task.cost)


def _along_checkpoints(task: Task) -> list[Task]:
    if not isinstance(task, CellTask):
        return [task]
    parts: list[Task] = []
    left = set(task.seeds)
    for seeds in sorted(_unfinished(task), key=len, reverse=True):
        if left.issuperset(seeds):
            parts.append(_part(task, seeds))
            left -= set(seeds)
    return [*parts, *([_part(task, sorted(left))] if left else [])]


def _splittable(task: Task) -> int:
    """Return into how many parts a task can be split."""
    if not isinstance(task, CellTask) or task.seeds in _unfinished(task):
        return 1
    return len(task.seeds)


def _unfinished(task: CellTask) -> list[tuple[int, ...]]:
    return Store(task.store).unfinished(task.name, task.origin.key)


def _parts(task: Task, count: int) -> list[Task]:
    if count == 1 or not isinstance(task, CellTask):
        return [task]
    total = len(task.seeds)
    ends = [total * i // count for i in range(count + 1)]
    return [_part(task, task.seeds[i:j]) for i, j in itertools.pairwise(ends)]


def _part(task: CellTask, seeds: Sequence[int]) -> CellTask:
    return replace(task, seeds=tuple(seeds), cost=task.cost * len(seeds) / len(task.seeds))
