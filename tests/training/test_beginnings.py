from __future__ import annotations

from dataclasses import replace

import pytest

from bgn.agents.specs import AGENTS
from bgn.training import beginnings, trainer
from bgn.training import checkpoint as checkpoints
from bgn.training.beginnings import may_begin
from bgn.training.cell import Beginning
from bgn.training.trainer import train_cell
from tests.training.test_determinism import assert_identical
from tests.training.test_trainer import KilledError, cell, killer


def lead(spec, seeds, ahead, **options):
    return beginnings.train_cell(spec, seeds, beginnings=ahead, **options)


@pytest.fixture
def all_at_once(monkeypatch):
    """Report and save after every update."""
    monkeypatch.setattr(trainer, "PROGRESS_SECONDS", -1.0)
    monkeypatch.setattr(trainer, "CHECKPOINT_SECONDS", -1.0)


def assert_ends_as_alone(beginning):
    """Check that a beginning's checkpoint is at its end, and yields what training it alone does."""
    updates = -(-beginning.spec.env_steps // 20)
    assert checkpoints.load(beginning.checkpoint)["done"] == updates
    reports = []
    found = train_cell(
        beginning.spec, beginning.seeds, checkpoint=beginning.checkpoint, on_progress=reports.append
    )
    assert all(report.stage == "evaluate" for report in reports)
    for one, other in zip(found, train_cell(beginning.spec, beginning.seeds), strict=True):
        assert_identical(one, other)


@pytest.fixture
def few_points(monkeypatch):
    """Take fewer points of a curve than there are updates, so that two lengths have other points."""
    monkeypatch.setattr(trainer, "CURVE_POINTS", 8)


@pytest.mark.parametrize(
    ("agent_id", "domain_id", "seeds"),
    [
        *((agent_id, "two-bumps-1d", (8, 3)) for agent_id in AGENTS),
        ("ah-ch+bgn", "rocksample-4-4", (3, 5, 8)),
        ("ab-cb+bgn", "rocksample-4-4", (5,)),
    ],
    ids=str,
)
@pytest.mark.usefixtures("few_points")
def test_a_beginning_is_the_shorter_run_bit_for_bit(agent_id, domain_id, seeds, tmp_path):
    long = cell(agent_id, domain_id, updates=23, reward_scaling=True)
    short = replace(long, env_steps=20 * 14 - 7, evaluation_episodes=4)
    assert not trainer.curve_points(14) <= trainer.curve_points(23)
    assert may_begin(short, long)
    ahead = Beginning(spec=short, seeds=seeds, checkpoint=tmp_path / "deep" / "short")
    found = lead(long, (3, 5, 8), [ahead])
    assert_ends_as_alone(ahead)
    for one, other in zip(found, train_cell(long, (3, 5, 8)), strict=True):
        assert_identical(one, other)


def test_several_beginnings_come_along(tmp_path):
    long = cell(updates=12)
    ahead = [
        Beginning(
            spec=replace(long, env_steps=20 * updates), seeds=(1, 2), checkpoint=tmp_path / str(updates)
        )
        for updates in (3, 7)
    ]
    lead(long, (1, 2), ahead)
    for one in ahead:
        assert_ends_as_alone(one)


@pytest.mark.parametrize("kills", [[1], [5], [6], [2, 4], [3, 8]], ids=str)
def test_an_interrupted_stack_still_leaves_its_beginning(kills, tmp_path, all_at_once):
    long = cell(updates=8, shared_recurrence=False)
    ahead = Beginning(spec=replace(long, env_steps=20 * 5), seeds=(5,), checkpoint=tmp_path / "short")
    for kill in kills:
        with pytest.raises(KilledError):
            lead(long, (3, 5), [ahead], checkpoint=tmp_path / "long", on_progress=killer(kill))
    found = lead(long, (3, 5), [ahead], checkpoint=tmp_path / "long")
    assert_ends_as_alone(ahead)
    for one, other in zip(found, train_cell(long, (3, 5)), strict=True):
        assert_identical(one, other)


def test_a_beginning_that_was_saved_before_its_stack_waits_for_it(tmp_path, all_at_once):
    long = cell(updates=8)
    short = replace(long, env_steps=20 * 5)
    ahead = Beginning(spec=short, seeds=(3, 5), checkpoint=tmp_path / "short")
    with pytest.raises(KilledError):  # the shorter run alone gets further than the longer one
        train_cell(short, (3, 5), checkpoint=ahead.checkpoint, on_progress=killer(4))
    assert checkpoints.load(ahead.checkpoint)["done"] == 3
    lead(long, (3, 5), [ahead])
    assert_ends_as_alone(ahead)


def test_a_beginning_that_the_stack_has_passed_is_left_alone(tmp_path, all_at_once):
    long = cell(updates=8)
    ahead = Beginning(spec=replace(long, env_steps=20 * 5), seeds=(3, 5), checkpoint=tmp_path / "short")
    with pytest.raises(KilledError):
        train_cell(long, (3, 5), checkpoint=tmp_path / "long", on_progress=killer(3))
    lead(long, (3, 5), [ahead], checkpoint=tmp_path / "long")
    assert not ahead.checkpoint.exists()


def test_a_schedule_that_depends_on_the_length_leaves_nothing(tmp_path):
    long = cell(updates=8, entropy_weight_start=2.0)
    short = replace(long, env_steps=20 * 5)
    assert may_begin(short, long)
    lead(long, (3,), [Beginning(spec=short, seeds=(3,), checkpoint=tmp_path / "short")])
    assert not (tmp_path / "short").exists()


@pytest.mark.parametrize(
    "change", [{"env_steps": 160}, {"env_steps": 200}, {"agent": "ah-ch"}, {"variant": {"a": 1}}], ids=str
)
def test_other_settings_or_no_shorter_run_is_no_beginning(change):
    long = cell(updates=8)
    assert not may_begin(replace(long, **{"env_steps": 100} | change), long)
