"""Speed of what lies below training: files, tables, beliefs and physics."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks.speed.timing import measure
from benchmarks.speed.workloads import POMDP_FILES, Filtering, compiling, loading, repeated
from bgn import domains
from bgn.physics.compile import compile_hidden
from bgn.physics.top_plate import TopPlateScene
from bgn.physics.two_bumps_1d import TwoBumps1DScene
from bgn.physics.two_bumps_2d import TwoBumps2DScene
from bgn.pomdp.belief import update

if TYPE_CHECKING:
    from pytest_benchmark.fixture import BenchmarkFixture

pytestmark = pytest.mark.benchmark(timer=time.process_time)
CLASSIC = ("hallway", "hallway-2", "rocksample-4-4", "rocksample-5-5")
ROBOT = ("top-plate", "two-bumps-1d", "two-bumps-2d")
REPEATS = 20


@pytest.mark.parametrize("track_beliefs", [True, False], ids=["with-beliefs", "without"])
@pytest.mark.parametrize("domain_id", [*CLASSIC, *ROBOT])
def test_world_step(domain_id: str, track_beliefs: bool, benchmark: BenchmarkFixture) -> None:
    """Steps of 48 lanes; the difference between the two is the belief update."""
    world = Filtering(domain_id, track_beliefs=track_beliefs)
    seconds = measure(benchmark, repeated(world, REPEATS), rounds=7, warm_up=1)
    each = float(np.median(seconds)) / REPEATS / world.env_steps
    benchmark.extra_info["lane_step_microseconds"] = each * 1e6


@pytest.mark.parametrize("domain_id", CLASSIC)
def test_reference_belief_update(domain_id: str, benchmark: BenchmarkFixture) -> None:
    """Updates of one belief by the slow reference, for comparison with a lane's."""
    model = domains.get(domain_id).model.joint
    seen = int(np.argmax(model.start @ model.transitions[0] @ model.observations[0]))
    work = repeated(partial(update, model, model.start, 0, seen), REPEATS)
    seconds = measure(benchmark, work, rounds=10, warm_up=1)
    benchmark.extra_info["lane_step_microseconds"] = float(np.median(seconds)) / REPEATS * 1e6


@pytest.mark.parametrize("domain_id", [*CLASSIC, *ROBOT])
def test_compile_tables(domain_id: str, benchmark: BenchmarkFixture) -> None:
    """From the sparse model to the tables that the batched simulator reads."""
    measure(benchmark, compiling(domain_id), rounds=3, warm_up=1)


@pytest.mark.parametrize("name", [path.name for path in sorted(POMDP_FILES.glob("*.pomdp"))])
def test_load_pomdp(name: str, benchmark: BenchmarkFixture) -> None:
    """From text to a checked model."""
    measure(benchmark, loading(name), rounds=2)


@pytest.mark.parametrize("scene_type", [TopPlateScene, TwoBumps1DScene, TwoBumps2DScene])
def test_physics_step(
    scene_type: type[TopPlateScene | TwoBumps1DScene | TwoBumps2DScene], benchmark: BenchmarkFixture
) -> None:
    """Random moves of one episode's scene in MuJoCo."""
    scene = scene_type()
    hidden = scene.hidden_parts()[0]
    scene.reset(hidden, scene.starts(hidden)[0])
    actions = iter(np.random.default_rng(0).integers(scene.actions, size=10_000).tolist())
    measure(benchmark, lambda: scene.act(next(actions)), rounds=30, warm_up=2)


def test_compile_physics(benchmark: BenchmarkFixture) -> None:
    """One hidden part of TopPlate, from physics to its column of the table."""
    scene = TopPlateScene()
    measure(benchmark, partial(compile_hidden, scene, scene.hidden_parts()[0]), rounds=2)
