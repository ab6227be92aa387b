from __future__ import annotations

import numpy as np
import pytest
import torch

from benchmarks import authors_evaluation, registry
from bgn import domains
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.training.evaluation import evaluate

SETTINGS = registry.load().presets["authors-code"].hyperparameters("hallway")


def networks() -> AgentNetworks:
    found = AgentNetworks(agent("ah-ch"), domains.get("hallway"), SETTINGS, (0,), torch.device("cpu"))
    found.initialise()
    return found


def test_a_hundred_episodes_the_same_each_time() -> None:
    domain = domains.get("hallway")
    first, again = (
        authors_evaluation.first_to_finish(networks(), domain, SETTINGS, np.random.default_rng(3))
        for _ in range(2)
    )
    assert len(first) == authors_evaluation.EPISODES
    assert first == again
    assert all(0 <= value <= 1 for value in first)


def test_it_favours_short_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """An untrained policy either gets there soon or never: the first to finish are the lucky ones."""
    domain = domains.get("hallway")
    monkeypatch.setattr(authors_evaluation, "EPISODES", 40)
    rng = np.random.default_rng(0)
    lucky = np.mean(
        [authors_evaluation.first_to_finish(networks(), domain, SETTINGS, rng) for _ in range(10)]
    )
    unbiased = evaluate(networks(), domain, SETTINGS, 1000, greedy=True)["return"]
    assert lucky > unbiased
