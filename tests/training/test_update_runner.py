from __future__ import annotations

import pytest
import torch

from bgn.agents.hyperparameters import Hyperparameters
from bgn.training import update_runner
from bgn.training.learners.a2c import VARIATES, A2CLearner, entropy_weights
from bgn.training.update_runner import UpdateRunner
from tests.training._stacks import learner


def weights(updates, **settings):
    return entropy_weights(Hyperparameters(**settings), updates)


def test_entropy_weight_is_the_papers_over_fifteen_million_steps():
    """Table 1: 2 · 0.1^(t / 3 M) falls from 2 to 2e-5 in 15 M steps."""
    updates = 15_000_000 // 80
    ours = weights(updates, entropy_weight_start=2.0, entropy_weight_end=2e-5)
    steps = torch.arange(updates, dtype=torch.float64) * 80
    torch.testing.assert_close(ours.double(), 2 * 0.1 ** (steps / 3e6), rtol=1e-6, atol=0)
    assert ours[0] == 2
    assert ours[-1].item() == pytest.approx(2e-5, rel=1e-4)


def test_entropy_weight_follows_the_fraction_of_the_run():
    short = weights(10, entropy_weight_start=2.0, entropy_weight_end=2e-5)
    assert short[5].item() == pytest.approx(2 * 1e-5**0.5)
    assert weights(4, entropy_weight_start=0.01, entropy_weight_end=0.01).tolist() == pytest.approx(
        [0.01] * 4
    )


def test_updates_take_consecutive_numbers_whatever_comes_first(monkeypatch):
    """Update i gets the same variates and weight in order, from the middle, and across blocks."""
    seen = []

    def record(self, variates, weight):
        seen.append((variates.clone(), weight.item()))

    monkeypatch.setattr(A2CLearner, "update", record)
    monkeypatch.setattr(update_runner, "BLOCK", 4)
    stack = learner("ab-cb", "top-plate", (1, 2), lanes=2, rollout=3, entropy_weight_start=1.0)
    in_order = UpdateRunner(stack, 10)
    for i in range(10):
        in_order.update(i)
    assert len({v.sum().item() for v, _ in seen}) == 10
    resumed = UpdateRunner(stack, 10)
    for i in (6, 7, 8, 9):
        resumed.update(i)
    for early, late in zip(seen[6:10], seen[10:], strict=True):
        assert torch.equal(early[0], late[0])
        assert early[1] == late[1]
    assert seen[0][0].shape == (3, 4, VARIATES)
