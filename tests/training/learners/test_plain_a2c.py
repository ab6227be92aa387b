"""The fast learner does what the plain one does: the same runs, from the same start and random numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from bgn import domains
from bgn.agents import a2c
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.errors import InputError
from bgn.pomdp import belief as reference
from bgn.training.learners.a2c import A2CLearner
from bgn.training.learners.plain_a2c import Environment, PlainA2CLearner, RewardScaler, Tables
from bgn.training.update_runner import UpdateRunner

CPU = torch.device("cpu")
UPDATES = 9


@pytest.mark.parametrize(("domain_id", "shared"), [("hallway", True), ("rocksample-4-4", False)])
@pytest.mark.parametrize("agent_id", AGENTS)
def test_runs_are_the_same(agent_id: str, domain_id: str, shared: bool) -> None:
    """Actions and rewards are equal, losses, parameters and mean squares but for rounding."""
    settings = Hyperparameters(
        lanes=12,
        rollout=3,
        shared_recurrence=shared,
        recurrent_hidden_layers=2 if shared else 1,
        belief_weight=0.7,
        entropy_weight_start=0.5,
    )
    domain = replace(domains.get(domain_id), episode_limit=7)  # so that the third update cuts episodes
    fast = A2CLearner(AGENTS[agent_id], domain, settings, (5, 2), CPU)
    plain = PlainA2CLearner(AGENTS[agent_id], domain, settings, (5, 2), CPU)
    runners = [UpdateRunner(learner, 2 * UPDATES) for learner in (fast, plain)]
    cut = 0
    for i in range(UPDATES):
        for runner in runners:
            runner.update(i)
        cut += int(fast.truncated.sum())
        ours, theirs = fast.recorder.state(), plain.recorder.state()
        for name in ("running", "weights", "episodes"):
            torch.testing.assert_close(theirs[name], ours[name], rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(theirs["losses"], ours["losses"], equal_nan=True, rtol=1e-4, atol=1e-5)
        for state in (ours, theirs):
            state[
                "losses"
            ].zero_()  # each update by itself: sums of either sign may come back to nearly nothing
    assert cut > 0
    parameters = fast.networks.parameters
    for row, run in enumerate(plain.runs):
        networks, squares = fast.networks_of(row), fast.networks_of(row)
        for name, values in zip(
            parameters.shapes, parameters.by_seed(parameters.mean_squares)[row], strict=True
        ):
            squares.parameters[name].copy_(values.view_as(squares.parameters[name]))
        for theirs, ours in run.agent.pairs(networks):
            torch.testing.assert_close(theirs, ours, rtol=1e-3, atol=1e-5)
        for theirs, ours in run.agent.pairs(squares, lambda p, run=run: run.optimiser.state[p]["square_avg"]):
            torch.testing.assert_close(theirs, ours, rtol=1e-3, atol=1e-8)
        for name, values in plain.networks_of(row).parameters.of_seed(0).items():
            torch.testing.assert_close(values, networks.parameters[name][0], rtol=1e-3, atol=1e-5)


def test_all_parameters_have_a_partner() -> None:
    for agent_id in AGENTS:
        learner = PlainA2CLearner(
            AGENTS[agent_id], domains.get("hallway"), Hyperparameters(lanes=2), (1,), CPU
        )
        networks = learner.networks_of(0)
        paired = sum(theirs.numel() for theirs, _ in learner.runs[0].agent.pairs(networks))
        assert paired == sum(tensor.numel() for tensor in networks.parameters.of_seed(0).values())


@pytest.mark.parametrize("agent_id", ["ah-ch+bgn", "ab-cb"])
def test_a_loaded_learner_goes_on_bit_for_bit(agent_id: str) -> None:
    def fresh() -> UpdateRunner:
        settings = Hyperparameters(lanes=4, rollout=3)
        return UpdateRunner(PlainA2CLearner(AGENTS[agent_id], domains.get("hallway"), settings, (1,), CPU), 8)

    straight, first, second = fresh(), fresh(), fresh()
    for i in range(8):
        straight.update(i)
        (first if i < 4 else second).update(i)
        if i == 3:
            second.learner.load_state(first.learner.state())
    ours, theirs = straight.learner.state(), second.learner.state()
    assert ours.keys() == theirs.keys()
    columns = slice(0, 100)  # the recorder's last column takes what is not an episode's end
    for name, tensor in ours.items():
        one, other = (t[..., columns] if "window" in name else t for t in (tensor, theirs[name]))
        torch.testing.assert_close(one, other, rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("domain_id", ["hallway", "rocksample-4-4"])
def test_environment_follows_the_model(domain_id: str) -> None:
    domain = domains.get(domain_id)
    model, rng = domain.model.joint, np.random.default_rng(1)
    lane = Environment(Tables(domain), rng.random(4), hidden_first_action=True, track_belief=True)
    ends = 0
    for _ in range(300):
        before, state, action = lane.belief, lane.state, int(rng.integers(model.n_actions))
        reward, ended, truncated = lane.step(action, rng.random(2), rng.random(4))
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


def test_it_learns_what_the_belief_is() -> None:
    settings = Hyperparameters(belief_weight=0.267)
    learner = PlainA2CLearner(AGENTS["ah-ch+bgn"], domains.get("hallway"), settings, (0,), CPU)
    runner = UpdateRunner(learner, 40)
    cross_entropies = []
    for i in range(40):
        runner.update(i)
        cross_entropies.append(learner.recorder.read().losses["belief_cross_entropy"][0])
    # From ln 60 = 4.1 nats; the belief of a lost robot has about 3.
    assert cross_entropies[-1] < cross_entropies[0] - 0.3


def test_it_rejects_what_it_does_not_know() -> None:
    spec, hallway = AGENTS["ab-cb"], domains.get("hallway")
    with pytest.raises(InputError, match="classic domains on the CPU only, not 'top-plate' on cpu"):
        PlainA2CLearner(spec, domains.get("top-plate"), Hyperparameters(), (0,), CPU)
    with pytest.raises(InputError, match="zero-advantage"):
        PlainA2CLearner(spec, hallway, Hyperparameters(time_limit="bootstrap"), (0,), CPU)
