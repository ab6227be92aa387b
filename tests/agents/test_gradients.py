"""The hand-written backward passes against automatic differentiation of the plainly written losses."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.layers import tanh_of_half
from bgn.agents.networks import Branch
from bgn.agents.specs import AGENTS
from bgn.training.learners import a2c
from bgn.training.learners.a2c import VARIATES, A2CLearner
from bgn.training.random_streams import Purpose, RandomStreams

SEEDS = (3, 8)
STEPS, LANES = 3, 4
BETA = 0.05

Named = dict[str, Tensor]


def _gru(p: Named, name: str, x: Tensor, h: Tensor) -> Tensor:
    """One GRU step as the textbook writes it, on gates stored in the documented order."""
    width = h.shape[-1]
    i_n, i_r, i_z = (x @ p[f"{name}.input.weight"] + p[f"{name}.input.bias"]).split(width, -1)
    h_r, h_z, h_n = (h @ p[f"{name}.recurrent.weight"] + p[f"{name}.recurrent.bias"]).split(width, -1)
    r, z = torch.sigmoid(i_r + h_r), torch.sigmoid(i_z + h_z)
    return (1 - z) * torch.tanh(i_n + r * h_n) + z * h


def _inputs(learner: A2CLearner, branch: Branch, p: Named, row: int, hidden: Named) -> Tensor:
    """What enters a branch's hidden layers: (T, L, width)."""
    rollout, layout = learner.inputs, learner.networks.layout
    if branch.kind == "belief":
        return rollout.belief_input[row, :STEPS].double()
    if branch.kind == "state":
        table = p[f"{branch.name}.state"] if layout.state is None else layout.state.double()
        return table[rollout.state[row, :STEPS]]
    assert branch.recurrence is not None
    gru = branch.recurrence
    seen = p[gru.observations.name] if layout.observation is None else layout.observation.double()
    done = p[gru.actions.name] if layout.action is None else layout.action.double()
    h, features = hidden[gru.name][row].double(), []
    for t in range(STEPS):
        x = torch.cat((seen[rollout.observation[row, t]], done[rollout.last_action[row, t]]), -1)
        h = _gru(p, gru.name, x, h * ~rollout.fresh[row, t, :, None])
        features.append(h)
    return torch.stack(features)


def _loss(learner: A2CLearner, p: Named, row: int, hidden: Named, advantages: Tensor) -> Tensor:
    """Eq. 2 and Eq. 5 as they stand, with the returns R_t held fixed."""
    settings, rollout = learner.settings, learner.inputs
    outputs, total = {}, torch.zeros((), dtype=torch.float64)
    for branch in (learner.networks.actor, learner.networks.critic):
        x = _inputs(learner, branch, p, row, hidden)
        for i in range(len(branch.body.layers)):
            x = torch.tanh(x @ p[f"{branch.name}.body.{i}.weight"] + p[f"{branch.name}.body.{i}.bias"])
        outputs[branch.name] = x @ p[f"{branch.name}.head.weight"] + p[f"{branch.name}.head.bias"]
        if branch.grounding is not None:
            logits = x @ p[f"{branch.name}.belief.weight"] + p[f"{branch.name}.belief.bias"]
            cross_entropy = -(rollout.belief[row, :STEPS] * torch.log_softmax(logits, -1)).sum(-1).mean()
            total = total + settings.belief_weight * cross_entropy
    log_policy, values = torch.log_softmax(outputs["actor"], -1), outputs["critic"][..., 0]
    chosen = log_policy.gather(-1, learner.actions[row][..., None])[..., 0]
    entropy = -(log_policy.exp() * log_policy).sum(-1)
    returns = advantages + values.detach()
    total = total - (chosen * advantages).mean() - BETA * entropy.mean()
    return total + settings.critic_weight * ((returns - values) ** 2).mean()


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", ["hallway", "two-bumps-1d"])
@pytest.mark.parametrize("shared", [True, False])
def test_gradients_equal_automatic_differentiation(
    agent_id: str, domain_id: str, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Hyperparameters(
        lanes=LANES,
        rollout=STEPS,
        shared_recurrence=shared,
        recurrent_hidden_layers=2 if shared else 1,
        belief_weight=0.7,
    )
    learner = A2CLearner(AGENTS[agent_id], domains.get(domain_id), settings, SEEDS, torch.device("cpu"))
    streams = RandomStreams(SEEDS, Purpose.TRAINING, torch.device("cpu"))
    for i in range(6):  # real updates first, so that memories, episode starts and policies are generic
        learner.update(streams.block(i, STEPS, LANES, VARIATES), torch.tensor(BETA))
    hidden = {r.name: r.hidden.clone() for r in learner.networks.recurrences}
    seen: dict[str, Any] = {}

    def spy(*args: Tensor) -> object:
        seen["advantages"] = args[2].view(len(SEEDS), STEPS, LANES).double()
        return real(*args)

    real = a2c.policy_loss  # type: ignore[attr-defined]
    monkeypatch.setattr(a2c, "policy_loss", spy)
    monkeypatch.setattr(learner.optimiser, "step", lambda norm: None)
    learner.update(streams.block(6, STEPS, LANES, VARIATES), torch.tensor(BETA))

    parameters = learner.networks.parameters
    for row in range(len(SEEDS)):
        p = {name: parameters[name][row].double().requires_grad_() for name in parameters.shapes}
        loss = _loss(learner, p, row, hidden, seen["advantages"][row])
        for name, expected in zip(p, torch.autograd.grad(loss, list(p.values())), strict=True):
            ours = parameters.gradient(name)[row].double()
            torch.testing.assert_close(ours, expected, rtol=1e-4, atol=1e-6)


def test_tanh_is_exact_to_a_rounding():
    x = torch.cat((torch.linspace(-12, 12, 4001), torch.tensor([0.0, 1e-4, -1e-4, 60.0, -60.0])))
    assert torch.allclose(tanh_of_half(2 * x), torch.tanh(x), rtol=0, atol=2e-7)
