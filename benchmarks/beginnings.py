"""Shorter budgets' runs that a longer budget's training passes through, so that they are not trained twice.

See :mod:`bgn.training.beginnings` for why they may be left on the way. What is left is the checkpoint of the shorter
run at its end; the shorter budget finds it like any other, and evaluates and stores the run.
"""

from __future__ import annotations

import pathlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

from benchmarks import plan
from benchmarks.executors.packing import along_checkpoints
from benchmarks.plan import Selection
from benchmarks.tasks import CellTask, Task
from bgn.results.store import Store
from bgn.training.cell import Beginning


def take_along(tasks: Sequence[Task], shorter: Sequence[Selection], results: pathlib.Path) -> list[Task]:
    """Add to stacks that are to be trained the missing runs of other selections that are their beginnings.

    The stores of these must be locked by the caller.
    """
    wanted = [task for selection in shorter for task in _missing(selection, results)]
    return [
        replace(task, beginnings=tuple(_beginnings(task, wanted))) if isinstance(task, CellTask) else task
        for task in tasks
    ]


def _missing(selection: Selection, results: pathlib.Path) -> list[CellTask]:
    """Return the stacks of a selection that are still to be trained."""
    store = selection.store(results)
    tasks = selection.tasks(plan.to_compute(plan.statuses(selection.requests(), store)), store, "cpu")
    return [task for task in along_checkpoints(tasks) if isinstance(task, CellTask)]


def _beginnings(task: CellTask, wanted: Sequence[CellTask]) -> Iterator[Beginning]:
    """Yield what of the wanted stacks lies on a stack's way."""
    for short in wanted:
        if not _may_begin(short, task):
            continue
        store, key = Store(short.store), short.origin.key
        seeds = tuple(seed for seed in task.seeds if seed in short.seeds)
        begun = store.checkpoint(short.name, key, short.seeds).exists()
        if seeds and (seeds == short.seeds or not begun):  # a stack that has begun goes on as a whole
            yield Beginning(spec=short.spec, seeds=seeds, checkpoint=store.checkpoint(short.name, key, seeds))


def _may_begin(short: CellTask, long: CellTask) -> bool:
    from bgn.training.beginnings import may_begin  # imported here because torch takes seconds

    return short.name == long.name and may_begin(short.spec, long.spec)
