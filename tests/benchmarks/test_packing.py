from __future__ import annotations

import functools
import pathlib
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from benchmarks import registry
from benchmarks.executors.packing import along_checkpoints, split
from benchmarks.plan import Selection
from benchmarks.tasks import CellTask, Task
from bgn.results.store import Store

TEN = tuple(range(10))


def tasks(store: pathlib.Path, agents: tuple[str, ...], seeds: tuple[int, ...] = TEN) -> list[Task]:
    return [replace(task, store=store) for task in planned(agents, seeds)]


@functools.cache
def planned(agents: tuple[str, ...], seeds: tuple[int, ...]) -> list[Task]:
    selection = Selection(registry.load(), "smoke", "authors-code", ("hallway",), agents, ("random",), seeds)
    return selection.tasks(selection.requests(), Store(pathlib.Path("nowhere")), "cpu")


def cells(parts: list[Task]) -> list[tuple[str, tuple[int, ...]]]:
    return sorted((part.name, part.seeds) for part in parts if isinstance(part, CellTask))


def leave_checkpoint(task: Task, seeds: tuple[int, ...]) -> None:
    path = Store(task.store).checkpoint(task.name, task.origin.key, seeds)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def test_cells_stay_whole_while_there_are_enough(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch", "ab-cb"))
    assert len(work) == 4  # two cells, two conventions of the random policy
    for workers in (0, 1, 4):
        assert split(work, workers) == work


def test_longest_cells_are_split_first(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch", "ab-cb"))  # costs as 1 to .45
    assert cells(split(work, 5)) == [
        ("hallway/ab-cb", TEN),
        ("hallway/ah-ch", (0, 1, 2, 3, 4)),
        ("hallway/ah-ch", (5, 6, 7, 8, 9)),
    ]
    assert cells(split(work, 7)) == [
        ("hallway/ab-cb", (0, 1, 2, 3, 4)),
        ("hallway/ab-cb", (5, 6, 7, 8, 9)),
        ("hallway/ah-ch", (0, 1, 2)),
        ("hallway/ah-ch", (3, 4, 5)),
        ("hallway/ah-ch", (6, 7, 8, 9)),
    ]


@given(workers=st.integers(0, 40), seeds=st.integers(1, 12))
def test_splitting_loses_nothing(workers: int, seeds: int) -> None:
    work = tasks(pathlib.Path("nowhere"), ("ah-ch", "ah-ch+bgn"), tuple(range(seeds)))
    parts = split(work, workers)
    assert sorted(run for part in parts for run in part.runs) == sorted(run for t in work for run in t.runs)
    assert sum(part.cost for part in parts) * (1 + 1e-12) >= sum(task.cost for task in work)
    assert len(parts) == max(len(work), min(workers, 2 * seeds + 2))
    costs = [part.cost for part in parts]
    assert costs == sorted(costs, reverse=True)
    sizes = [len(part.seeds) for part in parts if part.name == "hallway/ah-ch"]
    assert max(sizes) - min(sizes) <= 1


def test_stacks_with_checkpoints_are_taken_up_as_they_were(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch",))
    (cell,) = (task for task in work if isinstance(task, CellTask))
    leave_checkpoint(cell, (2, 3))
    leave_checkpoint(cell, (4, 5, 6))
    leave_checkpoint(cell, (6, 7))  # overlaps with the longer one
    leave_checkpoint(cell, (9, 10))  # seed 10 is not asked for
    parts = along_checkpoints(work)
    expected = [
        ("hallway/ah-ch", (0, 1, 7, 8, 9)),
        ("hallway/ah-ch", (2, 3)),
        ("hallway/ah-ch", (4, 5, 6)),
    ]
    assert cells(parts) == expected
    assert sum(part.cost for part in parts) == sum(task.cost for task in work)
    assert (("hallway/ah-ch", (2, 3))) in cells(split(parts, 100))
    assert len(cells(split(parts, 100))) == 5 + 2


def test_without_checkpoints_nothing_changes(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch", "ab-cb"))
    assert along_checkpoints(work) == work


def test_a_whole_stack_with_a_checkpoint_stays_whole(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch",))
    leave_checkpoint(work[0], TEN)
    assert cells(split(along_checkpoints(work), 50)) == [("hallway/ah-ch", TEN)]
