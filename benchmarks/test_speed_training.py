"""Training speed of every cell, beside the machine's own speed and the plain learner's."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks import registry
from benchmarks.speed import machine
from benchmarks.speed.arithmetic import multiply_adds
from benchmarks.speed.suite import TrainingSpeed
from benchmarks.speed.timing import measure
from benchmarks.speed.workloads import Training
from bgn.agents.specs import AGENTS
from bgn.training.learners.plain_a2c import PlainA2CLearner

if TYPE_CHECKING:
    from pytest_benchmark.fixture import BenchmarkFixture

CELLS = [(domain, agent) for domain in registry.load().domains for agent in AGENTS]
ROUNDS = 10
#: Cells whose ratio to the plain learner is measured.
SIDE_BY_SIDE = [(d, a) for d in ("hallway", "rocksample-5-5") for a in ("ah-ch+bgn", "ab-cb")]
PLAIN_ROUNDS = 9


@pytest.mark.benchmark(group="training", timer=time.process_time)
@pytest.mark.parametrize(("domain_id", "agent_id"), CELLS)
def test_update(domain_id: str, agent_id: str, benchmark: BenchmarkFixture) -> None:
    """Updates of three stacked seeds after a warm-up."""
    training = Training.of_cell(domain_id, agent_id)
    peak = machine.peak_flops()
    rate = training.env_steps / float(np.median(measure(benchmark, training, rounds=ROUNDS)))
    needed = 2 * multiply_adds(training.spec, training.domain, training.settings)
    speed = TrainingSpeed(f"{domain_id}/{agent_id}", rate, rate * needed / 1e9, peak / 1e9)
    benchmark.extra_info.update(machine=machine.info(), speed=asdict(speed), roofline=speed.roofline)


@pytest.mark.benchmark(group="plain", timer=time.process_time)
@pytest.mark.parametrize(("domain_id", "agent_id"), SIDE_BY_SIDE)
def test_against_the_plain_learner(domain_id: str, agent_id: str, benchmark: BenchmarkFixture) -> None:
    """Updates of both by turns; the ratio is the median over neighbouring turns."""
    training = Training.of_cell(domain_id, agent_id)
    plain = Training(
        training.domain, agent_id, training.settings, seeds=(0,), warm_up=1, make=PlainA2CLearner
    )
    rates: list[float] = []

    def turn_of_the_plain_learner() -> None:
        start = time.process_time()
        plain()
        rates.append(plain.env_steps / (time.process_time() - start))

    seconds = measure(benchmark, training, rounds=PLAIN_ROUNDS, setup=turn_of_the_plain_learner)
    ours = training.env_steps / seconds
    ratio = float(np.median(ours / np.array(rates)))
    benchmark.extra_info.update(cell=f"{domain_id}/{agent_id}", ratio=ratio)
