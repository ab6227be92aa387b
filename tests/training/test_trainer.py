from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.training import checkpoint as checkpoints
from bgn.training import trainer
from bgn.training.cell import CellSpec, Progress
from bgn.training.trainer import CURVE_POINTS, CheckpointMismatchError, curve_points, train_cell
from tests.training.test_determinism import assert_identical

COLUMNS = [
    "env_steps",
    "return_100",
    "success_100",
    "episodes",
    "entropy",
    "actor_loss",
    "critic_loss",
    "belief_cross_entropy",
    "seconds",
]
EVALUATED = ("return", "return_se", "return_sd", "success", "success_se", "length")
METRICS = {"train_return", "train_success", "env_steps_per_second", "wall_seconds", "cpu_seconds"}
METRICS |= {f"{how}_{what}" for how in ("sampled", "greedy") for what in EVALUATED}

KL = {"sampled_belief_kl", "greedy_belief_kl"}  # of agents that reconstruct the belief


def cell(agent="ah-ch+bgn", domain="top-plate", *, updates=6, **options):
    settings = Hyperparameters(lanes=4, **options)
    return CellSpec(
        domain=domain,
        agent=agent,
        hyperparameters=settings,
        env_steps=updates * 20,
        evaluation_episodes=5,
    )


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", ["rocksample-4-4", "two-bumps-1d"])
def test_every_agent_yields_what_is_documented(agent_id, domain_id):
    results = train_cell(cell(agent_id, domain_id), (4, 0))
    assert [r.seed for r in results] == [4, 0]
    for result in results:
        curve, metrics = result.curve, result.metrics
        assert list(curve.columns) == COLUMNS
        assert curve["env_steps"].tolist() == [20, 40, 60, 80, 100, 120]
        assert curve["episodes"].is_monotonic_increasing
        assert curve["seconds"].is_monotonic_increasing
        grounded = agent_id.endswith("+bgn")
        assert curve["belief_cross_entropy"].notna().all() == grounded
        assert curve["belief_cross_entropy"].isna().all() != grounded
        actions = 9 if domain_id == "rocksample-4-4" else 4
        assert curve["entropy"].iloc[0] == pytest.approx(math.log(actions), abs=0.02)
        assert set(metrics) == METRICS | (KL if grounded else set())
        last = curve.iloc[-1]
        assert metrics["train_return"] == pytest.approx(last["return_100"], nan_ok=True)
        assert metrics["train_success"] == pytest.approx(last["success_100"], nan_ok=True)
        for how in ("sampled", "greedy"):
            assert 0 <= metrics[f"{how}_success"] <= 1
            assert 1 <= metrics[f"{how}_length"] <= 100
        assert metrics["wall_seconds"] > 0
        assert any(name.startswith("actor.head") for name in result.policy)
        assert not any(name.startswith("critic") for name in result.policy)


def test_steps_are_rounded_up_to_whole_updates():
    spec = replace(cell(), env_steps=21)
    assert train_cell(spec, (0,))[0].curve["env_steps"].tolist() == [20, 40]


def test_progress_is_reported(monkeypatch):
    monkeypatch.setattr(trainer, "PROGRESS_SECONDS", -1.0)
    seen: list[Progress] = []
    train_cell(cell(updates=3), (0, 1), on_progress=seen.append)
    assert [(p.env_steps, p.stage) for p in seen] == [
        (20, "train"),
        (40, "train"),
        (60, "train"),
        (60, "evaluate"),
        (60, "evaluate"),
    ]
    assert all(p.total_env_steps == 60 and p.steps_per_second > 0 for p in seen)


class KilledError(Exception):
    """Stands for a signal."""


def killer(after):
    """Raise at the ``after``-th report."""
    left = [after]

    def on_progress(progress):
        left[0] -= 1
        if left[0] == 0:
            raise KilledError

    return on_progress


@pytest.mark.parametrize(
    ("agent_id", "domain_id", "options", "kills"),
    [
        ("ah-ch+bgn", "top-plate", {}, [3]),  # between two checkpoints
        ("ah-ch", "hallway", {"shared_recurrence": False}, [1, 4]),  # before the first; twice
        ("ab-cb+bgn", "two-bumps-2d", {"stale_reset_info": True, "time_limit": "bootstrap"}, [4]),
        ("ah-cs", "rocksample-4-4", {"entropy_weight_start": 2.0}, [9]),  # while evaluating
    ],
)
def test_an_interrupted_run_ends_the_same(agent_id, domain_id, options, kills, tmp_path, monkeypatch):
    spec = cell(agent_id, domain_id, updates=8, **options)
    whole = train_cell(spec, (3, 5))
    monkeypatch.setattr(trainer, "PROGRESS_SECONDS", -1.0)
    monkeypatch.setattr(trainer, "CHECKPOINT_SECONDS", -1.0)
    path = tmp_path / "runs" / "stack.pt"
    for kill in kills:
        with pytest.raises(KilledError):
            train_cell(spec, (3, 5), checkpoint=path, on_progress=killer(kill))
    if kills != [1, 4]:
        assert checkpoints.load(path)["done"] == kills[0] - 1
    reports: list[Progress] = []
    resumed = train_cell(spec, (3, 5), checkpoint=path, on_progress=reports.append)
    assert len(reports) < 9
    for one, other in zip(whole, resumed, strict=True):
        assert_identical(one, other)
    assert list(path.parent.iterdir()) == [path]


def test_a_checkpoint_of_other_work_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(trainer, "CHECKPOINT_SECONDS", -1.0)
    path = tmp_path / "stack.pt"
    train_cell(cell(updates=2), (0, 1), checkpoint=path)
    with pytest.raises(
        CheckpointMismatchError, match=r"is for other seeds: \[0, 1\], not \[0, 2\]; delete it"
    ):
        train_cell(cell(updates=2), (0, 2), checkpoint=path)
    with pytest.raises(CheckpointMismatchError, match=r"is for other spec: .*'ah-ch\+bgn'.*'ah-ch'"):
        train_cell(cell("ah-ch", updates=2), (0, 1), checkpoint=path)


def test_a_failed_save_leaves_the_last_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "stack.pt"
    assert checkpoints.load(path) is None
    checkpoints.save(path, {"done": 1})

    def full(content, file):
        file.write(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(OSError, match="no space"):
        checkpoints.save(path, {"done": 2})
    assert checkpoints.load(path) == {"done": 1}


@pytest.mark.parametrize("updates", [1, 2, 7, 1000, 187_500])
def test_curve_points(updates):
    points = sorted(curve_points(updates))
    assert points[0] == 1
    assert points[-1] == updates
    assert len(points) <= CURVE_POINTS + 1
    if updates == 187_500:
        assert set(range(1, 6)) <= set(points)
        assert sum(p <= updates // 100 for p in points) > 50
        assert max(b - a for a, b in pairwise(points)) <= updates / 100
