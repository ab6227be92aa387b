from __future__ import annotations

import numpy as np
import pytest
import torch

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.policies.every_start import every_start
from bgn.policies.saved import NetworkPolicy, save_policy

SETTINGS = Hyperparameters(shared_recurrence=False)


def networks_of(agent_id: str, domain_id: str, **variant: str) -> AgentNetworks:
    """Return networks whose policy is far from uniform, so that they do something."""
    domain = domains.get(domain_id, **variant)
    networks = AgentNetworks(agent(agent_id), domain, SETTINGS, (3,), torch.device("cpu"))
    networks.initialise()
    networks.parameters["actor.head.weight"].mul_(300)
    return networks


@pytest.mark.parametrize("agent_id", ["ah-ch+bgn", "ab-cb"])
@pytest.mark.parametrize("domain_id", ["top-plate", "two-bumps-1d"])
def test_as_the_saved_policy_acts_one_episode_at_a_time(agent_id, domain_id, tmp_path) -> None:
    domain, networks = domains.get(domain_id), networks_of(agent_id, domain_id)
    kept = networks.actor_parameters()
    tensors = {n: t for n, t in networks.parameters.of_seed(0).items() if n in kept}
    save_policy(tmp_path / "p", tensors, domain=domain_id, agent=agent_id, hyperparameters=SETTINGS)
    policy = NetworkPolicy.load(tmp_path / "p")
    paths = every_start(networks, domain)
    model, hidden = domain.model.joint, domain.model.n_hidden
    assert [path.states[0] for path in paths] == np.flatnonzero(model.start).tolist()
    for path in paths[:: max(1, len(paths) // 12)]:
        policy.reset()
        state, last = int(path.states[0]), None
        for t, action in enumerate(path.actions):
            seen = model.observations[0][[state]].indices[0]  # what is felt follows from the state
            last = policy.act(int(seen), last)
            assert last == action
            assert path.rewards[t] == model.rewards[action, state, 0, 0]
            ended = model.reset[action, state]
            state = int(model.transitions[action][[state]].indices[0])
            assert path.states[t + 1] == state
            assert ended == (t == len(path.actions) - 1) or t + 1 == domain.episode_limit
        assert state % hidden == path.states[0] % hidden


def test_an_unseen_first_action_leaves_no_known_start() -> None:
    with pytest.raises(ValueError, match="unseen random action"):
        every_start(networks_of("ah-ch", "hallway"), domains.get("hallway"))
