"""A run's numbers are its own: bit for bit whichever seeds share its stack, and whatever the threads."""

from __future__ import annotations

import pandas as pd
import pytest
import torch

from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.training.cell import CellSpec
from bgn.training.trainer import train_cell
from tests.training._stacks import trained

TIMINGS = {"wall_seconds", "cpu_seconds", "env_steps_per_second"}


def run(agent_id, domain_id, seeds, *, threads=1):
    """The run of seed 7, trained among ``seeds``."""
    settings = Hyperparameters(belief_weight=0.3)
    spec = CellSpec(
        domain=domain_id, agent=agent_id, hyperparameters=settings, env_steps=320, evaluation_episodes=7
    )
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        (result,) = (r for r in train_cell(spec, seeds) if r.seed == 7)
        assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    return result


def assert_identical(one, other):
    pd.testing.assert_frame_equal(
        one.curve.drop(columns="seconds"), other.curve.drop(columns="seconds"), check_exact=True
    )
    assert one.policy.keys() == other.policy.keys()
    for name, value in one.policy.items():
        assert torch.equal(value, other.policy[name]), name
    kept = [{k: v for k, v in r.metrics.items() if k not in TIMINGS} for r in (one, other)]
    assert kept[0] == kept[1]


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", ["hallway", "top-plate"])
def test_a_run_does_not_depend_on_its_stack(agent_id, domain_id):
    alone = run(agent_id, domain_id, (7,))
    assert_identical(alone, run(agent_id, domain_id, (2, 7)))


@pytest.mark.parametrize("domain_id", ["rocksample-4-4", "two-bumps-1d"])
def test_a_run_does_not_depend_on_its_place(domain_id):
    alone = run("ah-ch+bgn", domain_id, (7,))
    for seeds in ((1, 2, 7, 3, 4), (1, 2, 3, 4, 7)):
        assert_identical(alone, run("ah-ch+bgn", domain_id, seeds))


@pytest.mark.parametrize("seeds", [(7,), (2, 7)])
def test_a_run_does_not_depend_on_threads(seeds):
    assert_identical(run("ah-ch+bgn", "hallway", (7,)), run("ah-ch+bgn", "hallway", seeds, threads=2))


@pytest.mark.parametrize("shared", [True, False])
def test_everything_trained_does_not_depend_on_the_stack(shared):
    """Gradients, critic and optimiser too, which a finished run does not show.

    It takes lanes in multiples of 16: then all slices of all seeds begin on cache lines, as MKL's sums need.
    """
    options = {"lanes": 16, "rollout": 2, "shared_recurrence": shared}
    alone = trained("ah-ch+bgn", "hallway", (7,), 6, **options).networks.parameters
    stack = trained("ah-ch+bgn", "hallway", (1, 7, 2), 6, **options).networks.parameters
    for buffer in ("values", "gradients", "mean_squares"):
        ours, theirs = (p.by_seed(getattr(p, buffer)) for p in (alone, stack))
        for name, one, other in zip(alone.shapes, ours[0], theirs[1], strict=True):
            assert torch.equal(one, other), (buffer, name)


def test_seeds_differ():
    one, other = train_cell(
        CellSpec(
            domain="top-plate",
            agent="ah-ch",
            hyperparameters=Hyperparameters(lanes=4),
            env_steps=40,
            evaluation_episodes=4,
        ),
        (1, 2),
    )
    assert not torch.equal(one.policy["actor.head.weight"], other.policy["actor.head.weight"])
    assert not one.curve.equals(other.curve)
