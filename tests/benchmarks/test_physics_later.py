"""Physics that was missing when a run finished: the row says so, and a later call fills in just that."""

from __future__ import annotations

import pathlib
from dataclasses import replace

import pandas as pd
import pytest
import torch

import benchmarks.__main__ as command
from benchmarks import plan, registry, tasks
from benchmarks.__main__ import main
from benchmarks.plan import Selection, State
from benchmarks.tasks import CellTask, PhysicsTask, Work, execute
from bgn.results.schema import PHYSICS_METRICS
from bgn.results.store import Store
from bgn.training import physics_evaluation
from tests.benchmarks import fakes

CHOSEN = ["--budget", "smoke", "--domain", "top-plate", "--agent", "ah-ch", "--seeds", "0,1", "--jobs", "1"]


def selection() -> Selection:
    benchmark = registry.load()
    preset = benchmark.defaults.preset
    return Selection(benchmark, "smoke", preset, ("top-plate",), ("ah-ch",), (), (0, 1))


@pytest.fixture
def no_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (tasks, command, physics_evaluation):
        monkeypatch.setattr(module, "has_physics", lambda: False)


def trained(store: Store, work: Work = Work()) -> None:  # noqa: B008
    """Do the cell in this process, as the thread of a GPU does it."""
    (task,) = selection().tasks(selection().requests(), store, "cpu")
    assert isinstance(task, CellTask)
    assert execute(replace(task, device="cuda"), work, lambda progress: None) is None


def test_a_row_says_what_it_lacks_and_is_filled_in(tmp_path: pathlib.Path) -> None:
    """Filled in later, a run has the physics that it would have got at once."""
    if not physics_evaluation.has_physics():
        pytest.skip("MuJoCo is not installed")
    at_once, later = Store(tmp_path / "once"), Store(tmp_path / "later")
    spec_episodes = registry.load().budget("smoke").physics_episodes
    (task,) = selection().tasks(selection().requests(), at_once, "cpu")
    assert isinstance(task, CellTask)
    for store, physics in ((at_once, True), (later, False)):
        done = replace(task, store=store.root)
        train = tasks.train_cell

        def here(spec, seeds, *, train=train, wanted=physics, **options):
            return train(spec, seeds, **(options | {"physics": wanted}))

        assert execute(done, Work(train_cell=here), lambda progress: None) is None
    statuses = plan.statuses(selection().requests(), later)
    assert {status.state for status in statuses} == {State.INCOMPLETE}
    assert {status.detail for status in statuses} == {"physics: not evaluated yet"}
    before = later.read("runs").set_index("run")
    assert not set(PHYSICS_METRICS) & set(before)

    (fill,) = selection().physics_tasks([status.request for status in statuses], later)
    assert isinstance(fill, PhysicsTask)
    assert fill.name == "top-plate/ah-ch in physics"
    assert execute(fill, Work(), lambda progress: None) is None
    after, expected = (store.read("runs").set_index("run") for store in (later, at_once))
    pd.testing.assert_frame_equal(after[list(PHYSICS_METRICS)], expected[list(PHYSICS_METRICS)])
    assert (after["physics_episodes"] == spec_episodes).all()
    assert {status.state for status in plan.statuses(selection().requests(), later)} == {State.CURRENT}
    kept = [name for name in before if name not in ("missing", "version_mujoco")]
    pd.testing.assert_frame_equal(after[kept], before[kept])  # training, provenance and all


@pytest.mark.usefixtures("no_mujoco")
def test_a_machine_without_mujoco_keeps_the_result_and_says_what_is_missing(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda _: "a GPU")
    store = selection().store(tmp_path)
    trained(store, fakes.WORKING)
    assert main(["run", "--results", str(tmp_path), *CHOSEN], work=fakes.WORKING) == 1
    text = capsys.readouterr().out
    assert "0 of 2 runs" in text
    assert "incomplete" in text
    assert "physics: MuJoCo is not installed" in text
    assert set(store.read("runs")["status"]) == {"ok"}


def test_a_later_call_fills_in_the_physics_and_trains_nothing(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = selection().store(tmp_path)
    trained(store, fakes.WORKING)
    finished = store.read("runs")["finished_at"].tolist()
    assert main(["run", "--results", str(tmp_path), *CHOSEN], work=fakes.WORKING) == 0
    rows = store.read("runs").sort_values("seed")
    assert rows["physics_success"].tolist() == [0.25, 1.25]
    assert rows["finished_at"].tolist() == finished
    assert "done   top-plate/ah-ch in physics (2 runs)" in capsys.readouterr().out


def test_failed_physics_leaves_the_row_incomplete(tmp_path: pathlib.Path) -> None:
    store = selection().store(tmp_path)
    trained(store, fakes.WORKING)

    def failing(*_: object) -> dict[str, float]:
        raise FloatingPointError("the simulation diverged")

    requests = selection().requests()
    (fill,) = selection().physics_tasks(requests, store)
    failure = execute(fill, replace(fakes.WORKING, evaluate_in_physics=failing), lambda progress: None)
    assert failure is not None
    assert {status.state for status in plan.statuses(requests, store)} == {State.INCOMPLETE}
    assert sorted(store.read("runs")["status"]) == ["failed", "failed", "ok", "ok"]


def test_the_gpus_thread_is_not_kept_waiting_for_physics(tmp_path: pathlib.Path) -> None:
    asked: list[object] = []

    def train(spec, seeds, **options):
        asked.append(options["physics"])
        return fakes.train_cell(spec, seeds, **options)

    for device in ("cuda", "cpu"):
        store = selection().store(tmp_path / device)
        (task,) = selection().tasks(selection().requests(), store, device)
        execute(task, replace(fakes.WORKING, train_cell=train), lambda progress: None)
    assert asked == [False, True]
