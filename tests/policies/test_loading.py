import gymnasium
import numpy as np
import pytest
import torch

import bgn.environments  # noqa: F401  (registers them)
from bgn import domains, policies
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.errors import InputError
from bgn.planning.heuristics import qmdp
from bgn.policies import alpha_file
from bgn.policies.alpha_vectors import AlphaVectorPolicy
from bgn.policies.saved import NetworkPolicy, PolicyFileError, save_policy


def saved_networks(path, domain_id, agent_id):
    settings = Hyperparameters()
    networks = AgentNetworks(agent(agent_id), domains.get(domain_id), settings, (0,), torch.device("cpu"))
    names = networks.actor_parameters()
    tensors = {name: t for name, t in networks.parameters.of_seed(0).items() if name in names}
    save_policy(path, tensors, domain=domain_id, agent=agent_id, hyperparameters=settings)
    return path


@pytest.mark.parametrize("kind", ["ah-ch", "ab-cb", "alpha vectors"])
@pytest.mark.parametrize(
    ("domain_id", "environment_id"), [("hallway", "bgn/Hallway-v0"), ("top-plate", "bgn/TopPlate-v0")]
)
def test_whatever_was_saved_acts_in_a_plain_loop(tmp_path, kind, domain_id, environment_id):
    path = tmp_path / "saved"
    if kind == "alpha vectors":
        alpha_file.save(qmdp(domains.get(domain_id).model), path, model=domain_id)
    else:
        saved_networks(path, domain_id, kind)
    policy = policies.load(path)
    assert policy.domain.id == domain_id
    env = gymnasium.make(environment_id)
    observation, info = env.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    action, steps, over = info["last_action"], 0, False
    while not over:
        action = policy.act(observation, action)
        observation, _, ended, truncated, _ = env.step(action)
        steps, over = steps + 1, ended or truncated
    env.close()
    assert 1 <= steps <= policy.domain.episode_limit


def test_the_file_tells_what_it_holds(tmp_path):
    alpha_file.save(qmdp(domains.get("hallway").model), tmp_path / "a", model="hallway")
    assert isinstance(policies.load(tmp_path / "a"), AlphaVectorPolicy)
    assert isinstance(policies.load(saved_networks(tmp_path / "b", "hallway", "ah-ch")), NetworkPolicy)


def test_what_does_not_fit_is_refused(tmp_path):
    with pytest.raises(PolicyFileError, match="no such policy file"):
        policies.load(tmp_path / "nothing")
    saved_networks(tmp_path / "networks", "hallway", "ah-ch")
    with pytest.raises(InputError, match="is a policy of hallway, not of hallway-2"):
        policies.load(tmp_path / "networks", "hallway-2")
    alpha_file.save(qmdp(domains.get("hallway").model), tmp_path / "alpha", model="my.pomdp")
    with pytest.raises(InputError, match=r"is for the model 'my\.pomdp', not for a known domain"):
        policies.load(tmp_path / "alpha")
    assert policies.load(tmp_path / "alpha", "hallway").domain.id == "hallway"
    with pytest.raises(InputError, match="for 60 states, hallway-2 has 92"):
        policies.load(tmp_path / "alpha", "hallway-2")
