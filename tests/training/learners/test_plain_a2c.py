"""The baseline computes what the learner computes: worlds, reward scaling, losses, gradients, whole steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmarks.baseline import Baseline, Environment, RewardScaler, Rollout, Seen, Tables
from bgn import domains
from bgn.agents import a2c
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.pomdp import belief as reference
from bgn.training import learner as learner_module
from bgn.training.learner import VARIATES, Learner
from bgn.training.random_streams import Purpose, RandomStreams

BETA = 0.05
CPU = torch.device("cpu")
# The learner keeps the input weights' gates in the order n, r, z; torch in the order r, z, n.
ROTATED = torch.arange(768).roll(-256)


def copied(learner: Learner, name: str, tensor: Tensor) -> dict[str, Tensor]:
    """A learner's tensor under the baseline's name, in torch's layout."""
    head, _, tail = name.partition(".")
    if head in ("actor", "critic", "shared") and tail.split(".")[0] in ("observation", "action", "gru"):
        gru_of = [r.name for r in learner.networks.recurrences].index(f"{head}.gru")
        prefix = f"histories.{gru_of}"
        if tail in ("observation", "action"):
            return {f"{prefix}.{tail}.weight": tensor}
        _, part, kind = tail.split(".")
        end = {"input": "ih", "recurrent": "hh"}[part]
        columns = tensor[..., ROTATED] if part == "input" else tensor
        return {f"{prefix}.gru.{kind}_{end}_l0": turned(columns)}
    if tail == "state":
        return {"critic.state.weight": tensor}
    parts = tail.split(".")
    if parts[0] == "body":  # every other module of the sequence is a tanh
        tail = f"body.{2 * int(parts[1])}.{parts[2]}"
    return {f"{head}.{tail}": turned(tensor)}


def turned(tensor: Tensor) -> Tensor:
    """Torch keeps weights as (out, in)."""
    return tensor.T if tensor.ndim == 2 else tensor


def all_copied(learner: Learner, buffer: Any) -> dict[str, Tensor]:
    named: dict[str, Tensor] = {}
    for name in learner.networks.parameters.shapes:
        named |= copied(learner, name, buffer(name).clone())
    return named


def views(learner: Learner, flat: Tensor) -> dict[str, Tensor]:
    """One-seed views into a buffer of the learner's layout."""
    (vectors,) = learner.networks.parameters.by_seed(flat)
    shapes = learner.networks.parameters.shapes
    return {name: v.view(shape) for (name, shape), v in zip(shapes.items(), vectors, strict=True)}


@pytest.mark.parametrize(("domain_id", "shared"), [("hallway", True), ("rocksample-4-4", False)])
@pytest.mark.parametrize("agent_id", AGENTS)
def test_losses_gradients_and_step_equal_the_learners(
    agent_id: str, domain_id: str, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Hyperparameters(
        lanes=12,
        rollout=3,
        shared_recurrence=shared,
        recurrent_hidden_layers=2 if shared else 1,
        belief_weight=0.7,
    )
    domain = replace(domains.get(domain_id), episode_limit=7)  # so that the tenth update cuts episodes
    learner = Learner(AGENTS[agent_id], domain, settings, (5,), CPU)
    streams = RandomStreams((5,), Purpose.TRAINING, CPU)
    for i in range(9):  # real updates first, so that memories, policies and the optimiser are generic
        learner.update(streams.block(i, 3, 12, VARIATES), torch.tensor(BETA))
    baseline = Baseline(AGENTS[agent_id], domain, settings, seed=0)
    parameters = learner.networks.parameters
    baseline.agent.load_state_dict(all_copied(learner, lambda name: parameters[name][0]))
    squares = views(learner, parameters.mean_squares.clone())
    squares_by_name = all_copied(learner, squares.__getitem__)
    for name, p in baseline.agent.named_parameters():
        baseline.optimiser.state[p] = {"step": torch.tensor(9.0), "square_avg": squares_by_name[name]}
    memories = [r.hidden[0].clone() for r in learner.networks.recurrences]

    captured: dict[str, Any] = {}
    real = learner_module.generalized_advantages

    def spy(rewards: Tensor, values: Tensor, *rest: Tensor, **options: Any) -> Tensor:
        captured.update(rewards=rewards[0].clone(), values=values[0].clone())
        return real(rewards, values, *rest, **options)

    monkeypatch.setattr(learner_module, "generalized_advantages", spy)
    learner.recorder.losses.zero_()
    learner.update(streams.block(9, 3, 12, VARIATES), torch.tensor(BETA))

    assert learner.truncated.any()
    memory = learner.memory
    belief = memory.belief[0] if AGENTS[agent_id].needs_beliefs else torch.zeros(4, 12, domain.model.n_hidden)
    seen = Seen(
        memory.observation[0], memory.last_action[0], memory.state[0], belief.clone(), memory.fresh[0]
    )
    rollout = Rollout(
        seen,
        memories,
        learner.actions[0],
        captured["rewards"],
        learner.ended[0],
        learner.truncated[0],
        captured["values"],
    )
    losses = baseline.losses(rollout, BETA)
    parts = (losses.entropy, losses.policy, losses.critic, losses.cross_entropy)
    expected = torch.stack([torch.tensor(torch.nan) if part is None else part.detach() for part in parts])
    torch.testing.assert_close(learner.recorder.losses[0], expected, equal_nan=True, rtol=1e-4, atol=1e-6)
    baseline.learn(losses)
    ours = all_copied(learner, lambda name: parameters[name][0])
    for name, p in baseline.agent.named_parameters():
        torch.testing.assert_close(ours[name], p.detach(), rtol=1e-4, atol=1e-6)
    # learn() has clipped the baseline's gradients in place.
    norm = torch.linalg.vector_norm(parameters.gradients)
    factor = (settings.max_gradient_norm / (norm + 1e-6)).clamp(max=1.0)
    gradients = all_copied(learner, lambda name: parameters.gradient(name)[0] * factor)
    for name, p in baseline.agent.named_parameters():
        assert p.grad is not None
        torch.testing.assert_close(gradients[name], p.grad, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("domain_id", ["hallway", "rocksample-4-4"])
def test_environment_follows_the_model(domain_id: str) -> None:
    domain = domains.get(domain_id)
    model, rng = domain.model.joint, np.random.default_rng(1)
    lane = Environment(Tables(domain), rng, hidden_first_action=True, track_belief=True)
    ends = 0
    for _ in range(300):
        before, state, action = lane.belief, lane.state, int(rng.integers(model.n_actions))
        reward, ended, truncated = lane.step(action)
        assert lane.belief.sum() == pytest.approx(1)
        assert lane.belief[lane.state] > 0
        assert ended == model.reset[action, state]
        ends += ended or truncated
        assert lane.fresh == (ended or truncated)
        if lane.fresh:
            assert lane.steps == 0
            continue
        expected = reference.update(model, before, action, lane.observation, ended=False)
        np.testing.assert_allclose(lane.belief, expected, atol=1e-12)
        assert model.transitions[action][state, lane.state] > 0
        assert lane.last_action == action
        seen = model.observations[action][lane.state, lane.observation]
        assert seen > 0
        R = np.broadcast_to(model.rewards, (model.n_actions, model.n_states, model.n_states, 10**6))
        assert reward == R[action, state, lane.state, lane.observation]
    assert ends > 0


def test_reward_scalers_agree() -> None:
    rng = np.random.default_rng(0)
    ours, theirs = a2c.RewardScaler(1, 4, CPU), RewardScaler(4)
    for _ in range(5):
        rewards, done = rng.normal(size=(3, 4)), rng.random((3, 4)) < 0.2
        scaled = ours.scale(torch.from_numpy(rewards).float()[None], torch.from_numpy(done)[None])
        expected = np.stack([theirs.scale(r, d) for r, d in zip(rewards, done, strict=True)])
        np.testing.assert_allclose(scaled[0].numpy(), expected, rtol=1e-4)


def test_collected_rollouts_train() -> None:
    """On its own, the baseline's losses are finite and its critic learns what random play is worth."""
    settings = Hyperparameters(belief_weight=0.267)
    baseline = Baseline(AGENTS["ah-ch+bgn"], domains.get("hallway"), settings, seed=0)
    losses = [baseline.update(0.01) for _ in range(40)]
    assert all(torch.isfinite(step.total) for step in losses)
    early, late = losses[0].cross_entropy, losses[-1].cross_entropy
    assert early is not None
    assert late is not None
    assert late < early - 0.3  # from ln 60 = 4.1 nats; the belief of a lost robot has about 3


def test_baseline_rejects_what_it_does_not_know() -> None:
    spec, hallway = AGENTS["ab-cb"], domains.get("hallway")
    with pytest.raises(ValueError, match="classic domains only, not 'top-plate'"):
        Baseline(spec, domains.get("top-plate"), Hyperparameters(), seed=0)
    with pytest.raises(ValueError, match="zero-advantage"):
        Baseline(spec, hallway, Hyperparameters(time_limit="bootstrap"), seed=0)
