from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks, RolloutInputs
from bgn.agents.specs import AGENTS, agent
from bgn.errors import InputError
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld
from tests.agents._acting import act

CPU = torch.device("cpu")
PRESETS = {
    "authors-code": Hyperparameters(shared_recurrence=True, recurrent_hidden_layers=2),
    "paper-text": Hyperparameters(shared_recurrence=False, recurrent_hidden_layers=1),
}
#: A and Y; widths of history, belief and state inputs; look-up rows of embedded ones (paper, Tables 3 to 6).
SIZES = {
    "hallway": {"A": 5, "Y": 60, "history": 2 * 128, "belief": 60, "state": 128},
    "two-bumps-1d": {"A": 4, "Y": 39, "history": 2 + 1, "belief": 2 + 39, "state": 2 + 2},
}
HALLWAY_ROWS = {"observation": 21 + 1, "action": 5 + 1, "state": 60}  # with "none yet", where there is one


def built(agent_id, domain_id, preset, seeds=(0,)):
    networks = AgentNetworks(agent(agent_id), domains.get(domain_id), PRESETS[preset], seeds, CPU)
    networks.initialise()
    return networks


def dense(name, n_in, n_out):
    return {f"{name}.weight": (n_in, n_out), f"{name}.bias": (n_out,)}


def recurrence(name, domain_id):
    shapes = dense(f"{name}.gru.input", SIZES[domain_id]["history"], 3 * 256)
    shapes |= dense(f"{name}.gru.recurrent", 256, 3 * 256)
    if domain_id == "hallway":
        shapes |= {f"{name}.{what}": (HALLWAY_ROWS[what], 128) for what in ("observation", "action")}
    return shapes


def expected_shapes(agent_id, domain_id, preset):
    """Appendix B, Tables 2 and 3."""
    spec, size = AGENTS[agent_id], SIZES[domain_id]
    shared = preset == "authors-code" and agent_id in ("ah-ch", "ah-ch+bgn")
    shapes = {}
    for name, kind, outputs in (("actor", spec.actor, size["A"]), ("critic", spec.critic, 1)):
        if kind == "history":
            shapes |= recurrence("shared" if shared else name, domain_id)
            shapes |= dense(f"{name}.body.0", 256, 256)
        else:
            shapes |= dense(f"{name}.body.0", size[kind], 256)
        if kind != "history" or preset == "authors-code":
            shapes |= dense(f"{name}.body.1", 256, 256)
        if kind == "state" and domain_id == "hallway":
            shapes[f"{name}.state"] = (HALLWAY_ROWS["state"], 128)
        shapes |= dense(f"{name}.head", 256, outputs)
        if agent_id.endswith("+bgn"):
            shapes |= dense(f"{name}.belief", 256, size["Y"])
    return shapes


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", SIZES)
@pytest.mark.parametrize("preset", PRESETS)
def test_layers_are_those_of_appendix_b(agent_id, domain_id, preset):
    networks = AgentNetworks(agent(agent_id), domains.get(domain_id), PRESETS[preset], (0,), CPU)
    assert dict(networks.parameters.shapes) == expected_shapes(agent_id, domain_id, preset)
    own = {n for n in networks.parameters.shapes if n.startswith(("actor.", "shared."))}
    assert networks.actor_parameters() == own
    assert networks.hidden_width == (256 if agent_id.startswith("ah") else 0)


def is_orthogonal(weight, gain):
    W = weight / gain
    gram = W @ W.T if W.shape[0] <= W.shape[1] else W.T @ W
    return torch.allclose(gram, torch.eye(len(gram)), atol=1e-4)


@pytest.mark.parametrize("domain_id", SIZES)
def test_initial_values(domain_id):
    seeds = (3, 8)
    for agent_id in ("ah-ch+bgn", "ah-cs"):
        parameters = built(agent_id, domain_id, "authors-code", seeds).parameters
        for name in parameters.shapes:
            for value in parameters[name]:
                if ".belief." in name:
                    assert value.abs().max() <= 1 / 16
                    assert value.abs().max() > 0.05
                elif name.endswith(".bias"):
                    assert not value.any()
                elif name.endswith(".weight"):
                    gain = 1.0 if ".gru." in name else 0.01 if name == "actor.head.weight" else math.sqrt(2)
                    assert is_orthogonal(value, gain), name
                else:  # an embedding, N(0, 1)
                    spread = 4 / math.sqrt(value.numel())
                    assert abs(value.mean()) < spread
                    assert abs(value.std() - 1) < spread
            assert name.endswith(".bias") or not torch.equal(*parameters[name]), name


def test_initial_values_do_not_depend_on_the_stack():
    alone = built("ah-ch+bgn", "hallway", "paper-text", (8,)).parameters
    stack = built("ah-ch+bgn", "hallway", "paper-text", (3, 8)).parameters
    assert all(torch.equal(alone[name][0], stack[name][1]) for name in alone.shapes)


FEATURE_LAYERS = {  # layer: how many features it reads (TwoBumps-1D: cell, bin, last action; x; x and y)
    "ah-ch+bgn": {"actor.gru.input": 3, "critic.gru.input": 3},
    "ah-cs": {"actor.gru.input": 3, "critic.body.0": 4},
    "ab-cb": {"actor.body.0": 2, "critic.body.0": 2},
}


@pytest.mark.parametrize("agent_id", FEATURE_LAYERS)
def test_ridges_cross_the_cube_of_the_features(agent_id):
    steepness = 10.0
    settings = replace(PRESETS["paper-text"], feature_steepness=steepness)
    started = AgentNetworks(agent(agent_id), domains.get("two-bumps-1d"), settings, (3, 8), CPU)
    started.initialise()
    p, before = started.parameters, built(agent_id, "two-bumps-1d", "paper-text", (3, 8)).parameters
    for layer, features in FEATURE_LAYERS[agent_id].items():
        slopes, bias = p[f"{layer}.weight"][:, :features], p[f"{layer}.bias"]
        assert abs(slopes.mean()) < 4 * steepness / math.sqrt(slopes.numel())
        assert abs(slopes.std() / steepness - 1) < 4 / math.sqrt(2 * slopes.numel())
        assert torch.all(slopes.clamp(max=0).sum(1) + bias <= 1e-4)  # the least value in the cube
        assert torch.all(slopes.clamp(min=0).sum(1) + bias >= -1e-4)  # the greatest
        assert torch.equal(p[f"{layer}.weight"][:, features:], before[f"{layer}.weight"][:, features:])
        assert not torch.equal(slopes[0], slopes[1])
    others = set(p.shapes) - {f"{x}.{y}" for x in FEATURE_LAYERS[agent_id] for y in ("weight", "bias")}
    assert all(torch.equal(p[name], before[name]) for name in others)


def test_ridges_do_not_depend_on_the_stack_and_leave_embedded_domains_alone():
    settings = replace(PRESETS["paper-text"], feature_steepness=10.0)

    def start(domain_id, seeds):
        networks = AgentNetworks(agent("ah-ch+bgn"), domains.get(domain_id), settings, seeds, CPU)
        networks.initialise()
        return networks.parameters

    alone, stack = start("two-bumps-1d", (8,)), start("two-bumps-1d", (3, 8))
    assert all(torch.equal(alone[name][0], stack[name][1]) for name in alone.shapes)
    assert torch.equal(
        start("hallway", (8,)).values, built("ah-ch+bgn", "hallway", "paper-text", (8,)).parameters.values
    )


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", SIZES)
def test_inferring_equals_the_rollout(agent_id, domain_id):
    """Acting while training, slot by slot or all at once, and acting in evaluation are one function."""
    S, L, slots = 2, 3, 5
    domain = domains.get(domain_id)
    networks = built(agent_id, domain_id, "paper-text", (1, 2))
    networks.allocate(slots, L)
    networks.prepare()
    rollout = RolloutInputs(networks.layout, S, slots, L, networks.spec.needs_beliefs, CPU)
    world, generator = TableWorld(domain, S * L), torch.Generator().manual_seed(0)
    world.reset(torch.rand(S * L, START_VARIATES, generator=generator))
    hidden, critic_hidden = torch.zeros(S, L, networks.hidden_width), torch.zeros(S, L, 256)
    values = []
    for t in range(slots):
        inputs = world.inputs
        if t == 2:  # an episode's start in the middle of a rollout forgets the memory
            inputs.fresh[1] = True
        rollout.write(t, inputs)
        for recurrence_ in networks.recurrences:
            recurrence_.step(t, rollout.observation[:, t], rollout.last_action[:, t], rollout.fresh[:, t])
        hidden, logits = act(networks, inputs, hidden)
        torch.testing.assert_close(networks.actor.step(t, rollout), logits, rtol=1e-4, atol=1e-6)
        critic = networks.critic
        if critic.recurrence is not None:
            indices = (inputs.observation, inputs.last_action, inputs.fresh)
            critic_hidden = critic.recurrence.infer(critic_hidden, *(i.view(S, L) for i in indices))
        values.append(critic.infer(critic.infer_inputs(inputs, critic_hidden)))
        actions = torch.randint(world.tables.n_actions, (S * L,), generator=generator)
        start, step = (torch.rand(S * L, n, generator=generator) for n in (START_VARIATES, STEP_VARIATES))
        world.step(actions, step, world.openings(start))
    together = networks.critic.all_slots(rollout)
    torch.testing.assert_close(together, torch.stack(values, 1), rtol=1e-4, atol=1e-6)
    assert together.std() > 1e-3


def test_parameters_refuse_what_does_not_fit():
    parameters = built("ab-cb", "hallway", "paper-text").parameters
    with pytest.raises(ValueError, match="declared twice"):
        parameters.declare("actor.head.bias", (5,), torch.zeros)
    with pytest.raises(ValueError, match=r"'actor.head.bias' of shape \(4,\): expected \(5,\)"):
        parameters.load(0, {"actor.head.bias": torch.zeros(4)})
    with pytest.raises(ValueError, match=r"'nose' of shape .*: expected no such parameter"):
        parameters.load(0, {"nose": torch.zeros(4)})


def test_unknown_agents_list_the_known_ones():
    with pytest.raises(InputError, match=r"unknown agent 'ah'; known: ah-ch, ah-ch\+bgn, ah-cs"):
        agent("ah")
