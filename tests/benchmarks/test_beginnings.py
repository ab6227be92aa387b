"""Several budgets in one call: what they have in common is trained once."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from benchmarks import plan, registry, tasks
from benchmarks.__main__ import main
from benchmarks.beginnings import take_along
from benchmarks.plan import Selection
from benchmarks.registry import Registry
from benchmarks.tasks import CellTask, ReferenceTask, Work, execute
from bgn.results.store import Store
from bgn.training.cell import CellSpec, RunResult
from tests.benchmarks import fakes
from tests.training.test_determinism import assert_identical

PRESET = "reproduction"


@pytest.fixture(autouse=True)
def shipped_but_short(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """Let `paper` and `overnight` be a few updates long, with two seeds and with three."""
    shipped = registry.load()
    short = {
        name: shipped.budgets[name].model_copy(
            update={
                "env_steps": dict.fromkeys(shipped.domains, steps),
                "seeds": seeds,
                "evaluation_episodes": episodes,
                "physics_episodes": 0,
            }
        )
        for name, steps, seeds, episodes in (("paper", 960, 3, 4), ("overnight", 480, 2, 6))
    }
    tiny = shipped.model_copy(update={"budgets": {**shipped.budgets, **short}})
    monkeypatch.setattr(registry, "load", lambda *_: tiny)
    return tiny


def selection(tiny: Registry, budget: str, domain: str, *seeds: int) -> Selection:
    return Selection(tiny, budget, PRESET, (domain,), ("ah-ch",), (), seeds)


def stack(tiny: Registry, results: pathlib.Path, domain: str, *seeds: int, budget: str = "paper") -> CellTask:
    chosen = selection(tiny, budget, domain, *seeds)
    (task,) = chosen.tasks(chosen.requests(), chosen.store(results), "cpu")
    assert isinstance(task, CellTask)
    return task


def command(results: pathlib.Path, *budgets: str) -> list[str]:
    chosen = ["--domain", "two-bumps-2d", "--agent", "ah-ch", "--jobs", "1"]
    return ["run", "--results", str(results), "--budget", *budgets, *chosen]


def test_two_budgets_are_as_if_each_had_been_run_alone(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(tmp_path, "overnight", "paper")) == 0
    told = capsys.readouterr().out
    assert "0 of 3 runs" in told
    assert "0 of 2 runs" in told
    for budget, seeds in (("paper", 3), ("overnight", 2)):
        together = Store(tmp_path / budget / PRESET)
        assert main(command(tmp_path / "alone", budget)) == 0
        alone = Store(tmp_path / "alone" / budget / PRESET)
        assert len(together.read("runs")) == seeds
        times = {"env_steps_per_second", "wall_seconds", "cpu_seconds", "started_at", "finished_at"}
        one, other = (
            store.read("runs").drop(columns=list(times), errors="ignore") for store in (together, alone)
        )
        assert one.equals(other)
        curves = [store.read("curves").drop(columns="seconds") for store in (together, alone)]
        assert curves[0].equals(curves[1])
        for run in one["run"]:
            assert together.policy(run).read_bytes() == alone.policy(run).read_bytes()
        assert not list(together.root.rglob("*.checkpoint"))


def test_what_was_left_on_the_way_is_only_evaluated(
    shipped_but_short: Registry, tmp_path: pathlib.Path
) -> None:
    results: dict[str, list[RunResult]] = {}
    stages: list[str] = []

    def train(spec: CellSpec, seeds: Sequence[int], **options: Any) -> list[RunResult]:
        results[str(spec.env_steps)] = tasks.train_cell(spec, seeds, **options)
        return results[str(spec.env_steps)]

    work = Work(train_cell=train)
    shorter = selection(shipped_but_short, "overnight", "two-bumps-2d", 0, 1)
    (long,) = take_along([stack(shipped_but_short, tmp_path, "two-bumps-2d", 0, 1, 2)], [shorter], tmp_path)
    assert execute(long, work, lambda _: None) is None
    short = stack(shipped_but_short, tmp_path, "two-bumps-2d", 0, 1, budget="overnight")
    assert execute(short, work, lambda progress: stages.append(progress.stage)) is None
    assert set(stages) == {"evaluate"}
    for one, other in zip(results["480"], tasks.train_cell(short.spec, (0, 1)), strict=True):
        assert_identical(one, other)


def test_only_what_is_missing_is_taken_along(shipped_but_short: Registry, tmp_path: pathlib.Path) -> None:
    shorter = selection(shipped_but_short, "overnight", "two-bumps-2d", 0, 1, 2)
    done = stack(shipped_but_short, tmp_path, "two-bumps-2d", 1, budget="overnight")
    assert execute(done, fakes.WORKING, lambda _: None) is None
    (task,) = take_along([stack(shipped_but_short, tmp_path, "two-bumps-2d", 0, 1)], [shorter], tmp_path)
    assert isinstance(task, CellTask)
    (beginning,) = task.beginnings
    assert (beginning.spec, beginning.seeds) == (done.spec, (0,))
    assert beginning.checkpoint == Store(done.store).checkpoint(done.name, done.origin.key, (0,))


def test_a_stack_that_has_begun_is_taken_along_as_a_whole(
    shipped_but_short: Registry, tmp_path: pathlib.Path
) -> None:
    shorter = selection(shipped_but_short, "overnight", "two-bumps-2d", 0, 1, 2)
    begun = stack(shipped_but_short, tmp_path, "two-bumps-2d", 1, 2, budget="overnight")
    checkpoint = Store(begun.store).checkpoint(begun.name, begun.origin.key, begun.seeds)
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    for seeds, expected in (((0, 1), [(0,)]), ((0, 1, 2, 3), [(1, 2), (0,)])):
        long = stack(shipped_but_short, tmp_path, "two-bumps-2d", *seeds)
        (task,) = take_along([long], [shorter], tmp_path)
        assert isinstance(task, CellTask)
        assert [beginning.seeds for beginning in task.beginnings] == expected


def test_other_cells_settings_and_references_take_nothing_along(
    shipped_but_short: Registry, tmp_path: pathlib.Path
) -> None:
    long = stack(shipped_but_short, tmp_path, "two-bumps-2d", 0)
    reference = Selection(shipped_but_short, "paper", PRESET, ("two-bumps-2d",), (), ("random",), (0,))
    (row,) = reference.tasks(reference.requests(), reference.store(tmp_path), "cpu")
    assert isinstance(row, ReferenceTask)
    others = [
        selection(shipped_but_short, "overnight", "two-bumps-1d", 0),
        replace(selection(shipped_but_short, "overnight", "two-bumps-2d", 0), agents=("ah-cs",)),
        replace(selection(shipped_but_short, "overnight", "two-bumps-2d", 0), preset="ridge-start"),
        selection(shipped_but_short, "overnight", "two-bumps-2d", 7),
        selection(shipped_but_short, "paper", "two-bumps-2d", 0),
    ]
    assert take_along([long, row], others, tmp_path) == [long, row]


def test_the_longest_comes_first(shipped_but_short: Registry) -> None:
    steps = {
        name: selection(shipped_but_short, name, "two-bumps-2d", 0).env_steps()
        for name in ("paper", "overnight")
    }
    assert steps == {"paper": 960, "overnight": 480}


def test_all_budgets_are_checked_before_any_is_run(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(tmp_path, "paper", "overnigth")) == 2
    assert "overnigth" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_store_that_is_in_use_stops_the_call_before_anything_is_computed(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Store(tmp_path / "overnight" / PRESET).lock():
        assert main(command(tmp_path, "paper", "overnight"), work=fakes.BREAKING) == 2
    assert "another process" in capsys.readouterr().err
    assert Store(tmp_path / "paper" / PRESET).read("runs").empty


def test_damaged_rows_of_a_shorter_budget_are_set_aside_first(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shard = Store(tmp_path / "overnight" / PRESET).shard("runs", "two-bumps-2d/ah-ch/seed-0")
    shard.parent.mkdir(parents=True)
    shard.write_bytes(b"garbage")
    assert main(command(tmp_path, "paper", "overnight"), work=fakes.WORKING) == 0
    assert "its run is computed anew" in capsys.readouterr().err


def test_a_failure_in_any_budget_is_told(shipped_but_short: Registry, tmp_path: pathlib.Path) -> None:
    arguments = command(tmp_path, "paper", "overnight")
    arguments[arguments.index("ah-ch")] = fakes.FAILING_AGENT
    assert main(arguments, work=fakes.BREAKING) == 1
    for budget in ("paper", "overnight"):
        chosen = replace(
            selection(shipped_but_short, budget, "two-bumps-2d", 0), agents=(fakes.FAILING_AGENT,)
        )
        (status,) = plan.statuses(chosen.requests(), chosen.store(tmp_path))
        assert status.state is plan.State.FAILED
