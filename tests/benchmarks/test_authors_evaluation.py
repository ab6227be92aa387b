from __future__ import annotations

import pathlib

import numpy as np
import pandas as pd
import pytest
import torch

from benchmarks import authors_evaluation, evidence, registry
from benchmarks.__main__ import main
from bgn import domains
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.results.store import Store
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


def test_measured_from_stored_policies_and_read_back(tmp_path: pathlib.Path) -> None:
    options = ["--results", str(tmp_path), "--budget", "smoke"]
    assert (
        main(["run", *options, "--domain", "hallway", "--agent", "ab-cb", "--seeds", "0", "--jobs", "1"]) == 0
    )
    assert main(["measure", *options]) == 0
    found = evidence.load(tmp_path, budget="smoke")
    (measured,) = found.runs["first_100_return"]
    policy = found.store.policy("hallway/ab-cb/seed-0")
    assert measured == authors_evaluation.measure_policy(policy, seed=0)["first_100_return"]
    (cell,) = found.cells.to_dict("records")
    assert (cell["authors_metric"], cell["authors_runs"]) == ("first_100_return", 1)
    assert cell["authors_mean"] == measured
    assert authors_evaluation.measure(Store(found.store.root), ["hallway"]) == 0  # nothing is left to measure
    assert pd.notna(found.cells["mean"]).all()
