from __future__ import annotations

import json

import numpy as np
import pytest
import safetensors.torch
import torch

from bgn import domains
from bgn.agents import specs
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import AGENTS, AgentSpec
from bgn.policies.saved import NetworkPolicy, PolicyFileError, describe, save_policy
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld
from tests.agents._acting import act

SETTINGS = Hyperparameters(belief_weight=0.25, shared_recurrence=False)


def networks_of(agent_id, domain, settings=SETTINGS):
    """Networks whose policy is far from uniform, so that equal actions mean something."""
    networks = AgentNetworks(AGENTS[agent_id], domain, settings, (5,), torch.device("cpu"))
    networks.initialise()
    networks.parameters["actor.head.weight"].mul_(300)
    return networks


def saved(path, agent_id, domain_id, *, settings=SETTINGS, **variant):
    networks = networks_of(agent_id, domains.get(domain_id, **variant), settings)
    kept = networks.actor_parameters()
    tensors = {n: t for n, t in networks.parameters.of_seed(0).items() if n in kept}
    save_policy(path, tensors, domain=domain_id, agent=agent_id, hyperparameters=settings, variant=variant)
    return networks


def replay(networks, policy, *, steps=40, seed=0, hidden_first_action=None):
    """Act at random in the table world; yield what networks and policy would do on each input."""
    domain = policy.domain
    world = TableWorld(domain, 1, hidden_first_action=hidden_first_action)
    generator = torch.Generator().manual_seed(seed)
    world.reset(torch.rand(1, START_VARIATES, generator=generator))
    networks.prepare()
    hidden = torch.zeros(1, 1, networks.hidden_width)
    n_actions = domain.model.joint.n_actions
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        inputs = world.inputs
        if inputs.fresh[0]:
            policy.reset()
        last = int(inputs.last_action)
        chosen = policy.act(int(inputs.observation), None if last == n_actions else last)
        hidden, logits = act(networks, inputs, hidden)
        yield inputs, logits[0, 0], chosen
        start, step = (torch.rand(1, n, generator=generator) for n in (START_VARIATES, STEP_VARIATES))
        action = int(rng.integers(n_actions))
        going_on = np.flatnonzero(~domain.model.joint.reset[:, int(inputs.state)])
        if len(going_on) and rng.random() < 0.9:  # most random actions would end a robot's episode at once
            action = int(rng.choice(going_on))
        world.step(torch.tensor([action]), step, world.openings(start))


#: Whoever can act on a history.
CASES = [(a, d, {}) for a in AGENTS if AGENTS[a].actor != "state" for d in ("hallway", "top-plate")]
CASES += [
    (a, d, {"variant": "authors"})
    for a in ("ah-ch+bgn", "ab-cb")
    for d in ("top-plate", "two-bumps-1d", "two-bumps-2d")
]
CASES += [("ab-cb", "two-bumps-2d", {}), ("ab-cb", "rocksample-4-4", {})]


@pytest.mark.parametrize(("agent_id", "domain_id", "variant"), CASES)
def test_a_loaded_policy_acts_as_the_networks_do(agent_id, domain_id, variant, tmp_path):
    networks = saved(tmp_path / "policy", agent_id, domain_id, **variant)
    policy = NetworkPolicy.load(tmp_path / "policy")
    assert policy.belief() is None
    seen = []
    for inputs, logits, chosen in replay(networks, policy):
        assert chosen == int(logits.argmax())
        seen.append(logits)
        if policy.spec.actor == "belief":
            np.testing.assert_allclose(policy._filter.belief, inputs.belief[0], atol=1e-5)
            assert policy._filter.x == int(inputs.observed)
        belief = policy.belief()
        if policy.spec.grounded:
            assert belief.shape == (policy.domain.model.n_hidden,)
            assert belief.sum() == pytest.approx(1, abs=1e-5)
        else:
            assert belief is None
    assert torch.stack(seen).std(0).max() > 1e-3, "a constant policy would pass"


@pytest.mark.parametrize("agent_id", ["ah-ch", "ab-cb"])
def test_clean_starts_have_no_first_action(agent_id, tmp_path):
    networks = saved(tmp_path / "policy", agent_id, "hallway")
    policy = NetworkPolicy.load(tmp_path / "policy")
    for _, logits, chosen in replay(networks, policy, hidden_first_action=False):
        assert chosen == int(logits.argmax())


def test_the_reconstructed_belief_is_the_grounded_heads(tmp_path):
    networks = saved(tmp_path / "policy", "ah-ch+bgn", "hallway")
    policy = NetworkPolicy.load(tmp_path / "policy")
    networks.prepare()
    hidden = torch.zeros(1, 1, 256)
    for inputs, _, _ in replay(networks, policy, steps=6):
        features, hidden = networks.actor_features(inputs, hidden)
        expected = networks.actor.grounding.forward(features)[0, 0].softmax(-1)
        np.testing.assert_allclose(policy.belief(), expected, atol=1e-6)


def test_sampling_follows_the_policy_and_its_generator(tmp_path):
    networks = saved(tmp_path / "policy", "ah-ch", "hallway")
    networks.prepare()
    policy = NetworkPolicy.load(tmp_path / "policy", greedy=False)
    drawn = []
    for seed in range(400):
        policy.reset(np.random.default_rng(seed))
        drawn.append(policy.act(3, 1))
    inputs = TableWorld(policy.domain, 1).reset(torch.zeros(1, START_VARIATES))
    inputs.observation[:], inputs.last_action[:] = 3, 1
    law = act(networks, inputs, torch.zeros(1, 1, 256))[1][0, 0].softmax(-1).numpy()
    shares = np.bincount(drawn, minlength=5) / 400
    np.testing.assert_allclose(shares, law, atol=0.1)
    policy.reset(np.random.default_rng(7))
    assert policy.act(3, 1) == drawn[7]


def test_description(tmp_path):
    saved(tmp_path / "policy", "ah-ch", "top-plate", plates=3)
    description = describe(tmp_path / "policy")
    assert description["domain"] == "top-plate"
    assert description["agent"] == "ah-ch"
    assert description["variant"] == {"plates": 3}
    assert description["hyperparameters"]["belief_weight"] == 0.25
    assert NetworkPolicy.load(tmp_path / "policy").domain.model.n_hidden == 3


def rewritten(path, change=lambda description: description, tensors=None):
    """Overwrite a saved policy with a changed description or other tensors."""
    description = describe(path)
    tensors = safetensors.torch.load_file(path) if tensors is None else tensors
    safetensors.torch.save_file(tensors, path, metadata={"bgn": json.dumps(change(description))})


def test_bad_files_say_what_is_wrong(tmp_path):
    path = tmp_path / "policy"
    with pytest.raises(PolicyFileError, match="policy: no such policy file"):
        NetworkPolicy.load(path)
    with pytest.raises(PolicyFileError, match="no such policy file"):
        NetworkPolicy.load(tmp_path)
    path.write_text("not a policy")
    with pytest.raises(PolicyFileError, match="not a safetensors file"):
        NetworkPolicy.load(path)
    path.write_bytes(b"")
    with pytest.raises(PolicyFileError, match="not a safetensors file"):
        NetworkPolicy.load(path)
    for metadata in (None, {"bgn": "}"}, {"bgn": "[]"}, {"bgn": '{"format": "bgn-policy-0"}'}):
        safetensors.torch.save_file({"x": torch.zeros(1)}, path, metadata=metadata)
        with pytest.raises(PolicyFileError, match="not a policy of this project"):
            NetworkPolicy.load(path)


def without(key):
    return lambda description: {k: v for k, v in description.items() if k != key}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d | {"agent": "ah"}, "unknown agent 'ah'"),
        (lambda d: d | {"domain": "halway"}, "unknown domain 'halway'"),
        (lambda d: d | {"variant": {"size": 3}}, "size"),
        (lambda d: d | {"hyperparameters": {"lanes": 3}}, "lack recurrent_hidden_layers, shared_recurrence"),
        (lambda d: d | {"domain": "hallway-2"}, "shape"),
        (without("agent"), "agent"),
    ],
)
def test_bad_descriptions_say_what_is_wrong(change, message, tmp_path):
    saved(tmp_path / "policy", "ah-ch", "hallway")
    rewritten(tmp_path / "policy", change)
    with pytest.raises(PolicyFileError, match=message):
        NetworkPolicy.load(tmp_path / "policy")


def test_missing_and_misshapen_parameters_are_named(tmp_path):
    path = tmp_path / "policy"
    saved(path, "ah-ch+bgn", "hallway")
    tensors = safetensors.torch.load_file(path)
    del tensors["actor.belief.bias"], tensors["actor.gru.recurrent.weight"]
    rewritten(path, tensors=tensors)
    with pytest.raises(PolicyFileError, match=r"lacks the parameters actor.belief.bias, actor.gru.recurrent"):
        NetworkPolicy.load(path)
    saved(path, "ah-ch", "hallway")
    tensors = safetensors.torch.load_file(path)
    tensors["actor.head.bias"] = torch.zeros(6)
    rewritten(path, tensors=tensors)
    with pytest.raises(PolicyFileError, match=r"actor.head.bias.*\(6,\): expected \(5,\)"):
        NetworkPolicy.load(path)


def test_who_acts_on_the_state_cannot_act_on_a_history(tmp_path, monkeypatch):
    seer = AgentSpec(id="as-cs", title="As-Cs", actor="state", critic="state")
    monkeypatch.setattr(specs, "AGENTS", {**AGENTS, "as-cs": seer})
    networks = AgentNetworks(seer, domains.get("hallway"), Hyperparameters(), (5,), torch.device("cpu"))
    tensors = {name: networks.parameters[name][0] for name in networks.actor_parameters()}
    with pytest.raises(PolicyFileError, match="as-cs acts on the state, which no history shows"):
        NetworkPolicy(tensors, domains.get("hallway"), "as-cs", Hyperparameters())
