"""Cells in threads: the executor itself needs no GPU."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pathlib
from collections.abc import Generator, Iterator, Sequence
from typing import Any

import pandas as pd
import pytest
import torch

from benchmarks import registry
from benchmarks.__main__ import main
from benchmarks.events import Advanced, Finished, Idle, Started
from benchmarks.executors import beside
from benchmarks.executors.streams import run_tasks
from benchmarks.plan import Selection
from benchmarks.tasks import CellTask, Task, Work
from bgn.results.store import Store, StoreError
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
    with contextlib.closing(run_tasks(work, jobs=2, work=fakes.HANGING)) as events:
        advanced = {
            event.task.name for event in (next(events) for _ in range(20)) if isinstance(event, Advanced)
        }
    assert advanced
    assert not multiprocessing.active_children()
    assert Store(tmp_path).read("runs").empty  # nothing failed: it was stopped
    assert all(isinstance(task, CellTask) for task in work)
    # The fake finishes at once where there is a checkpoint.
    list(run_tasks(work, jobs=2, work=fakes.HANGING))
    assert set(Store(tmp_path).read("runs")["status"]) == {"ok"}


def test_a_lost_device_fails_its_cell_and_a_fresh_process_goes_on(tmp_path: pathlib.Path) -> None:
    """The others were running when the device was lost; they go on from their checkpoints."""
    work = tasks(tmp_path, (fakes.FAILING_AGENT, "ah-ch", "ah-cb"))
    events = list(run_tasks(work, jobs=3, work=fakes.LOSING))
    rows = Store(tmp_path).read("runs").set_index("run")
    assert rows["status"].value_counts().to_dict() == {"ok": 4, "failed": 2}
    failed = rows[rows["status"] == "failed"]
    assert set(failed["agent"]) == {fakes.FAILING_AGENT}
    assert set(failed["error"]) == {"DeviceLostError: an illegal memory access was encountered"}
    began, resumed = (set(fakes.said(tmp_path, what)) for what in ("began", "resumed"))
    assert len(began) == len(resumed) == 1
    assert began != resumed  # process ids
    started = [event.task.name for event in events if isinstance(event, Started)]
    assert sorted(started) == sorted(task.name for task in work)  # each once, whatever the process
    finished = [event for event in events if isinstance(event, Finished)]
    assert len(finished) == 3


def test_a_cell_that_kills_its_process_is_given_up(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, (fakes.DYING_AGENT, "ah-ch"))
    failures = {
        event.task.name: event.failure
        for event in run_tasks(work, jobs=1, work=fakes.BREAKING)
        if isinstance(event, Finished)
    }
    assert failures["top-plate/ah-ch"] is None
    failure = failures[f"top-plate/{fakes.DYING_AGENT}"]
    assert failure is not None
    assert failure.error.startswith("the GPU's process died 2 times while it ran (SIGKILL")
    assert sorted(Store(tmp_path).read("runs")["status"]) == ["failed", "failed", "ok", "ok"]


def test_a_full_disk_ends_the_run(tmp_path: pathlib.Path) -> None:
    with pytest.raises(StoreError, match="No space left"):
        list(run_tasks(tasks(tmp_path, ("ah-ch", "ab-cb")), jobs=1, work=fakes.FULL))
    assert not multiprocessing.active_children()


def test_the_process_may_use_as_many_connections_as_streams(tmp_path: pathlib.Path) -> None:
    list(run_tasks(tasks(tmp_path, ("ah-ch",)), jobs=1, work=fakes.ASKING))
    assert fakes.said(tmp_path, "connections") == ["32"]
    assert fakes.said(tmp_path, "threads") == ["1"]
    assert "CUDA_DEVICE_MAX_CONNECTIONS" not in os.environ


def test_executors_take_turns() -> None:
    def counting(name: str, n: int) -> Generator[Any]:
        for i in range(n):
            yield f"{name}{i}"
            yield Idle()

    said = [event for event in beside(counting("a", 3), counting("b", 1)) if not isinstance(event, Idle)]
    assert said == ["a0", "b0", "a1", "a2"]


def test_closing_closes_all_executors() -> None:
    closed = []

    def endless(name: str) -> Generator[Any]:
        try:
            while True:
                yield Idle()
        finally:
            closed.append(name)

    both = beside(endless("a"), endless("b"))
    next(both)
    next(both)
    both.close()
    assert closed == ["a", "b"]


def test_nothing_happens_for_a_while(tmp_path: pathlib.Path) -> None:
    work = tasks(tmp_path, ("ah-ch",))
    assert any(isinstance(event, Idle) for event in run_tasks(work, jobs=1, work=fakes.WORKING, tick=0.01))


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


def test_the_gpu_gets_cells_and_the_cpu_planners_and_physics(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    chosen = ["--budget", "smoke", "--domain", "top-plate", "--device", "cuda", "--jobs", "3"]
    assert main(["run", "--results", str(tmp_path), *chosen], work=fakes.WORKING) == 0
    store = Store(tmp_path / "smoke" / registry.load().defaults.preset)
    runs = store.read("runs")
    assert set(runs["device"]) == {"cuda"}
    benchmark = registry.load()
    assert len(runs) == len(benchmark.agents) * benchmark.budgets["smoke"].seeds
    assert runs["missing"].isna().all()
    assert (runs["physics_success"] == 0.25 + runs["seed"]).all()  # by the task of its own
    assert set(store.read("references")["reference"]) == {"random", "perfect"}


def test_a_gpu_has_at_most_31_cells_at_once(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    chosen = ["--results", str(tmp_path), "--device", "cuda", "--jobs", "32"]
    assert main(["run", *chosen], work=fakes.WORKING) == 2
    assert "--jobs 32: a GPU runs at most 31 cells side by side" in capsys.readouterr().err


def test_a_missing_gpu_is_said_before_anything_runs(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert main(["run", "--results", str(tmp_path), "--device", "cuda"], work=fakes.WORKING) == 2
    assert "--device cuda: torch" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
