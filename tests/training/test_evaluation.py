from __future__ import annotations

import numpy as np
import pytest
import torch

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import AGENTS
from bgn.training.evaluation import evaluate
from tests.training._stacks import CPU


def networks_of(agent_id, domain_id, seed=0, **settings):
    networks = AgentNetworks(
        AGENTS[agent_id], domains.get(domain_id), Hyperparameters(**settings), (seed,), CPU
    )
    networks.initialise()
    return networks


def uniform(agent_id, domain_id):
    networks = networks_of(agent_id, domain_id)
    networks.parameters["actor.head.weight"].zero_()
    return networks


def exact(domain, hidden_first_action):
    """Discounted return, undiscounted return and length of the uniformly random policy, by recursion."""
    joint = domain.model.joint
    A, going_on = joint.n_actions, ~joint.reset
    values = []
    for rewards, discount in (
        (joint.expected_rewards, domain.report_discount),
        (joint.expected_rewards, 1.0),
        (np.ones_like(joint.expected_rewards), 1.0),
    ):
        V = np.zeros(joint.n_states)
        for _ in range(domain.episode_limit):
            following = np.stack([T @ V for T in joint.transitions])  # (A, S)
            V = (rewards + discount * going_on * following).mean(0)
        start = sum(joint.start @ T for T in joint.transitions) / A if hidden_first_action else joint.start
        values.append(float(start @ V))
    return values


@pytest.mark.parametrize(
    ("agent_id", "domain_id", "hidden_first_action", "known", "deviation"),
    [
        ("ab-cb", "hallway", True, 0.0407, 0.147),
        ("ah-ch", "rocksample-4-4", True, -63.71, 38.75),
        ("ah-ch", "rocksample-4-4", False, -82.75, 19.8),
    ],
)
def test_a_random_policy_earns_its_exact_value(agent_id, domain_id, hidden_first_action, known, deviation):
    domain = domains.get(domain_id)
    discounted, total, length = exact(domain, hidden_first_action)
    assert discounted == pytest.approx(known, rel=0.002)
    settings = Hyperparameters(hidden_first_action=hidden_first_action)
    summary = evaluate(uniform(agent_id, domain_id), domain, settings, 1100, greedy=False)
    assert summary["return"] == pytest.approx(known, abs=4 * summary["return_se"])
    assert summary["return_se"] == pytest.approx(summary["return_sd"] / np.sqrt(1100), rel=1e-3)
    assert summary["return_sd"] == pytest.approx(deviation, rel=0.15)
    assert summary["length"] == pytest.approx(length, rel=0.1)
    if domain_id == "hallway":  # its only reward is the goal's, so its sum is a success
        assert summary["success"] == pytest.approx(total, abs=4 * summary["success_se"])


def test_success_rates_of_robot_domains():
    """TopPlate's uniform policy: what it earns, undiscounted, is its success rate."""
    domain = domains.get("top-plate")
    _, total, length = exact(domain, False)
    summary = evaluate(uniform("ah-ch", "top-plate"), domain, Hyperparameters(), 1000, greedy=False)
    assert summary["success"] == pytest.approx(total, abs=4 * summary["success_se"])
    assert summary["return"] == summary["success"]
    assert summary["length"] == pytest.approx(length, rel=0.1)


def test_evaluations_are_functions_of_the_seed():
    domain, settings = domains.get("top-plate"), Hyperparameters()
    one, same = (
        evaluate(networks_of("ah-ch", "top-plate"), domain, settings, 300, greedy=False) for _ in "ab"
    )
    assert one == same
    other = evaluate(networks_of("ah-ch", "top-plate", 1), domain, settings, 300, greedy=False)
    assert one != other


def test_greedy_takes_the_likeliest_action():
    """East is RockSample's third... action 1; always driving east ends with the exit's reward."""
    domain = domains.get("rocksample-4-4")
    networks = uniform("ah-ch", "rocksample-4-4")
    networks.parameters["actor.head.bias"][:, domain.model.joint.action_names.index("east")] = 1e-3
    settings = Hyperparameters(hidden_first_action=False)
    summary = evaluate(networks, domain, settings, 20, greedy=True)
    # Four moves cross the east edge; the fifth step is the terminal state's.
    assert summary["return"] == pytest.approx(10 * 0.95**3, rel=1e-6)
    assert summary["length"] == 5
    assert summary["return_sd"] == 0


def test_one_episode_has_no_standard_error():
    summary = evaluate(
        uniform("ah-ch", "top-plate"), domains.get("top-plate"), Hyperparameters(), 1, greedy=True
    )
    assert np.isnan(summary["return_se"])
    assert torch.tensor(summary["return_sd"]) == 0


def test_the_divergence_of_a_uniform_reconstruction_is_what_the_belief_knows():
    """b̂ = 1/Y: KL(b ‖ b̂) = ln Y - H(b). TopPlate's finger that grasps at once never learns anything: b is uniform."""
    domain = domains.get("top-plate")
    networks = uniform("ah-ch+bgn", "top-plate")
    for part in ("weight", "bias"):
        networks.parameters[f"actor.belief.{part}"].zero_()
    summary = evaluate(networks, domain, Hyperparameters(), 200, greedy=False)
    assert 0.1 < summary["belief_kl"] < np.log(10)  # it moves, and learns something
    networks.parameters["actor.head.bias"][:, domain.model.joint.action_names.index("grasp")] = 50.0
    at_once = evaluate(networks, domain, Hyperparameters(), 200, greedy=False)
    assert at_once["length"] == 1
    assert at_once["belief_kl"] == pytest.approx(0.0, abs=1e-6)
    networks.parameters["actor.belief.bias"][:, 0] = np.log(2.0)  # b̂ = (2, 1, ..., 1) / 11
    tilted = evaluate(networks, domain, Hyperparameters(), 200, greedy=False)
    assert tilted["belief_kl"] == pytest.approx(np.log(11 / 10) - np.log(2) / 10, abs=1e-6)
    assert "belief_kl" not in evaluate(
        uniform("ah-ch", "top-plate"), domain, Hyperparameters(), 2, greedy=True
    )
