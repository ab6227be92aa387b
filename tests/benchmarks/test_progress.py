from __future__ import annotations

import io
import pathlib

from rich.console import Console

from benchmarks import progress, registry
from benchmarks.events import Advanced, Finished, Started
from benchmarks.plan import Selection, State, statuses
from benchmarks.tasks import Failure, Task, now
from bgn.results.store import Store
from bgn.training.cell import Progress


def select(domain: str, agents: tuple[str, ...], seeds: tuple[int, ...]) -> Selection:
    return Selection(registry.load(), "smoke", "authors-code", (domain,), agents, ("random",), seeds)


def tasks(tmp_path: pathlib.Path) -> list[Task]:
    selection = select("hallway", ("ah-ch", "ab-cb"), (0, 1))
    return selection.tasks(selection.requests(), Store(tmp_path), "cpu")


def show(tmp_path: pathlib.Path, *, terminal: bool) -> str:
    work = tasks(tmp_path)
    text = io.StringIO()
    console = Console(file=text, force_terminal=terminal, width=200)
    with progress.display(work, console) as display:
        for task in work:
            display.note(Started(task))
        display.note(Advanced(work[0], Progress(1600, 3200, 12_345.0, 0.25)))
        display.note(Finished(work[0], None))
        display.note(Finished(work[1], Failure("ValueError: no", "", now())))
    return text.getvalue()


def test_longest_tasks_come_first(tmp_path: pathlib.Path) -> None:
    costs = [task.cost for task in tasks(tmp_path)]
    assert costs == sorted(costs, reverse=True)


def test_plain_lines_without_a_terminal(tmp_path: pathlib.Path) -> None:
    lines = show(tmp_path, terminal=False).splitlines()
    assert len(lines) == 2
    assert "\x1b" not in "".join(lines)
    assert "done " in lines[0]
    assert "1/4 cells and rows" in lines[0]
    assert "FAILED" in lines[1]
    assert "ValueError: no" in lines[1]
    assert "failed" in lines[1]


def test_bars_in_a_terminal(tmp_path: pathlib.Path) -> None:
    text = show(tmp_path, terminal=True)
    assert "\x1b" in text
    assert "2/4 cells and rows" in text


def test_everything_is_missing_in_an_empty_store(tmp_path: pathlib.Path) -> None:
    selection = select("top-plate", ("ah-ch",), (0,))
    found = statuses(selection.requests(), Store(tmp_path))
    assert [status.request.run for status in found] == [
        "top-plate/ah-ch/seed-0",
        "top-plate/random/clean",
    ]
    assert {status.state for status in found} == {State.MISSING}
