"""Runs computed once more: small ones, by the real trainer and planner."""

from __future__ import annotations

import dataclasses
import shutil
import uuid
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pytest

from benchmarks import registry
from benchmarks.adoption import under
from benchmarks.rerun import RerunError, rerun_and_compare
from benchmarks.retraining import fingerprint
from benchmarks.tasks import Work, train_cell
from bgn.results.store import Store, read_shard
from bgn.training.cell import CellSpec, RunResult
from tests.benchmarks import fakes

RUN, REFERENCE = "hallway/ab-cb/seed-1", "hallway/random/clean"


def train_briefly(spec: CellSpec, seeds: Sequence[int], **options: Any) -> list[RunResult]:
    return train_cell(dataclasses.replace(spec, env_steps=640, evaluation_episodes=5), seeds, **options)


def train_otherwise(spec: CellSpec, seeds: Sequence[int], **options: Any) -> list[RunResult]:
    settings = dataclasses.replace(spec.hyperparameters, learning_rate=2e-4)  # type: ignore[call-arg]
    return train_briefly(dataclasses.replace(spec, hyperparameters=settings), seeds, **options)


BRIEF, OTHER = Work(train_cell=train_briefly), Work(train_cell=train_otherwise)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    results = tmp_path_factory.mktemp("results")
    return fakes.fill(results, BRIEF, domain="hallway", agent="ab-cb", reference="random")


def test_a_run_computed_again_alone_is_the_same_bit_for_bit(store: Store) -> None:
    comparison = rerun_and_compare(store, RUN, BRIEF)
    assert comparison.identical
    assert comparison.then == comparison.now
    assert len({comparison.now.curve, comparison.now.metrics, comparison.now.policy}) == 3


def test_a_reference_row_computed_again_is_the_same(store: Store) -> None:
    comparison = rerun_and_compare(store, REFERENCE, BRIEF)
    assert comparison.identical
    assert comparison.then.metrics


def test_another_computation_is_told_apart(store: Store) -> None:
    comparison = rerun_and_compare(store, RUN, OTHER)
    assert set(comparison.differences) == {"curve", "metrics", "policy"}
    assert not comparison.identical


def test_times_do_not_count_and_every_other_bit_does(store: Store) -> None:
    spec = registry.load().cell("hallway", "ab-cb", budget="smoke", preset=registry.load().defaults.preset)
    (result,) = train_briefly(spec, [0], on_progress=lambda _: None)
    whole = fingerprint(result.curve, result.metrics, result.policy)
    slower = fingerprint(
        result.curve.assign(seconds=9.0), {**result.metrics, "wall_seconds": 9.0}, result.policy
    )
    assert slower == whole
    last = result.curve.index[-1]
    nudged = result.curve.copy()
    nudged.loc[last, "entropy"] *= 1 + 2**-52
    assert fingerprint(nudged, result.metrics, result.policy).differences(whole) == ("curve",)
    name = next(iter(result.policy))
    policy = {**result.policy, name: result.policy[name] + 1e-7}
    assert fingerprint(result.curve, result.metrics, policy).differences(whole) == ("policy",)
    metrics = {**result.metrics, "greedy_return": result.metrics["greedy_return"] + 1e-15}
    assert fingerprint(result.curve, metrics, result.policy).differences(whole) == ("metrics",)


def test_an_adopted_run_is_computed_again_too(store: Store) -> None:
    row = read_shard(store.shard("runs", RUN))
    adopted = under(row, store, taken_from="paper/calibrated")
    comparison = rerun_and_compare(_with_row(store, adopted), RUN, BRIEF)
    assert comparison.identical


def test_a_run_of_a_gpu_is_not_compared_bit_for_bit(store: Store) -> None:
    row = read_shard(store.shard("runs", RUN))
    at = row.schema.get_field_index("device")
    there = row.set_column(at, "device", pa.array(["cuda"]))
    with pytest.raises(RerunError, match="trained on a GPU"):
        rerun_and_compare(_with_row(store, there), RUN, BRIEF)


def _with_row(store: Store, row: pa.Table) -> Store:
    """Return a copy of a store whose run has another row."""
    copy = Store(store.root.parent / f"{store.root.name}-{uuid.uuid4().hex}")
    shutil.copytree(store.root, copy.root)
    copy.write("runs", RUN, row)
    return copy


def test_a_store_that_is_not_there_is_refused(store: Store) -> None:
    other = Store(store.root.parent / "calibratde")
    with pytest.raises(RerunError, match=f"nothing of smoke/calibratde; it holds .*smoke/{store.root.name}"):
        rerun_and_compare(other, RUN, BRIEF)


def test_an_unknown_run_is_refused(store: Store) -> None:
    with pytest.raises(RerunError, match="no finished 'hallway/ab-cb/seed-7'"):
        rerun_and_compare(store, "hallway/ab-cb/seed-7", BRIEF)
