"""Cells in threads: the executor itself needs no GPU."""

from __future__ import annotations

import contextlib
import pathlib
import threading
from collections.abc import Iterator, Sequence

import pandas as pd
import pytest
import torch

from benchmarks import registry
from benchmarks.__main__ import main
from benchmarks.events import Advanced, Finished, Started
from benchmarks.executors import streams
from benchmarks.executors.streams import run_tasks
from benchmarks.plan import Selection
from benchmarks.tasks import CellTask, Task, Work
from bgn.results.store import Store
from bgn.training.trainer import train_cell
from tests.benchmarks import fakes


def tasks(results: pathlib.Path, agents: Sequence[str]) -> list[Task]:
    selection = Selection(registry.load(), "smoke", "authors-code", ("top-plate",), tuple(agents), (), (0, 1))
    return selection.tasks(selection.requests(), Store(results), "cpu")


@pytest.fixture
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def test_every_task_starts_advances_and_finishes(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch", "ab-cb", "ah-cb"))
    events = list(run_tasks(work, jobs=2, work=fakes.WORKING))
    for task in work:
        own = [type(event) for event in events if event.task is task]
        assert own == [Started, Advanced, Advanced, Finished]
    assert set(Store(tmp_path).read("runs")["status"]) == {"ok"}
    assert len(Store(tmp_path).read("runs")) == 6


def test_no_tasks_are_done_at_once() -> None:
    assert list(run_tasks([], jobs=2, work=fakes.WORKING)) == []


def test_a_failure_is_a_row_and_the_rest_goes_on(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, (fakes.FAILING_AGENT, "ah-ch"))
    failures = {
        event.task.name: event.failure
        for event in run_tasks(work, jobs=1, work=fakes.BREAKING)
        if isinstance(event, Finished)
    }
    assert failures["top-plate/ah-ch"] is None
    failure = failures[f"top-plate/{fakes.FAILING_AGENT}"]
    assert failure is not None
    assert failure.error == "FloatingPointError: the loss is NaN"
    assert sorted(Store(tmp_path).read("runs")["status"]) == ["failed", "failed", "ok", "ok"]


def test_closing_stops_the_threads_and_keeps_checkpoints(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch", "ab-cb"))
    before = threading.active_count()
    with contextlib.closing(run_tasks(work, jobs=2, work=fakes.HANGING)) as events:
        advanced = {
            event.task.name for event in (next(events) for _ in range(20)) if isinstance(event, Advanced)
        }
    assert advanced
    assert threading.active_count() == before
    assert Store(tmp_path).read("runs").empty  # nothing failed: it was stopped
    assert all(isinstance(task, CellTask) for task in work)
    # The fake finishes at once where there is a checkpoint.
    list(run_tasks(work, jobs=2, work=fakes.HANGING))
    assert set(Store(tmp_path).read("runs")["status"]) == {"ok"}


def test_what_is_not_a_failure_of_a_task_ends_the_run(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def out_of_space(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(streams, "execute", out_of_space)
    with pytest.raises(OSError, match="no space left"):
        list(run_tasks(tasks(tmp_path, ("ah-ch", "ab-cb")), jobs=1, work=fakes.WORKING))


@pytest.mark.usefixtures("one_thread")
def test_cells_side_by_side_train_as_alone(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch+bgn", "ab-cb"))
    list(run_tasks(work, jobs=2, work=Work()))
    curves = Store(tmp_path).read("curves")
    for task in work:
        assert isinstance(task, CellTask)
        for alone, run in zip(train_cell(task.spec, task.seeds), task.runs, strict=True):
            ours = curves[curves["run"] == run].sort_values("env_steps").reset_index(drop=True)
            columns = [name for name in alone.curve if name != "seconds"]
            pd.testing.assert_frame_equal(ours[columns], alone.curve[columns], check_dtype=False)


def test_the_gpu_gets_cells_and_the_cpu_the_planners(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    chosen = ["--budget", "smoke", "--domain", "top-plate", "--device", "cuda", "--jobs", "3"]
    assert main(["run", "--results", str(tmp_path), *chosen], work=fakes.WORKING) == 0
    store = Store(tmp_path / "smoke" / registry.load().defaults.preset)
    assert set(store.read("runs")["device"]) == {"cuda"}
    benchmark = registry.load()
    assert len(store.read("runs")) == len(benchmark.agents) * benchmark.budgets["smoke"].seeds
    assert set(store.read("references")["reference"]) == {"random", "perfect"}


def test_a_missing_gpu_is_said_before_anything_runs(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert main(["run", "--results", str(tmp_path), "--device", "cuda"], work=fakes.WORKING) == 2
    assert "--device cuda: torch" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
