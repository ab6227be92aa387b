"""A slow, plain simulator-checker: follows lanes of a table world with numpy and the model's own arrays."""

from __future__ import annotations

import numpy as np
import torch

from bgn.domains.domain import Domain
from bgn.pomdp.belief import update_hidden
from bgn.pomdp.model import MOMDP, POMDP, Floats
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, Inputs, TableWorld


def domain_of(
    model: POMDP,
    n_observed: int = 1,
    *,
    limit: int = 7,
    hidden_first_action: bool = False,
    prior: Floats | None = None,
    elimination: np.ndarray | None = None,
) -> Domain:
    """Make a domain of any model."""
    return Domain(
        id="random",
        title="Random",
        family="classic",
        model=MOMDP(model, n_observed),
        episode_limit=limit,
        training_discount=0.9,
        report_discount=0.9,
        hidden_first_action=hidden_first_action,
        prior=prior,
        elimination=elimination,
    )


class Checker:
    """Steps a world with given actions and checks everything it says against the model, lane by lane."""

    def __init__(self, world: TableWorld, seed: int, *, followed: int | None = None) -> None:
        self.world, self.domain, self.model = world, world.domain, world.domain.model
        self.followed = world.lanes if followed is None else followed
        self.generator = torch.Generator().manual_seed(seed)
        joint = self.model.joint
        self.T, self.O = joint.transitions, joint.observations
        if joint.n_states <= 100:  # faster to index
            self.T, self.O = ([m.toarray() for m in arrays] for arrays in (self.T, self.O))
        self.steps = np.zeros(world.lanes, dtype=int)
        self.beliefs = np.zeros((world.lanes, self.model.n_hidden))
        inputs = world.reset(self.uniform(START_VARIATES))
        for lane in range(self.followed):
            self.open(inputs, lane)

    def uniform(self, width: int) -> torch.Tensor:
        return torch.rand(self.world.lanes, width, generator=self.generator)

    def transition(self, a: int, s: int, s_next: int) -> float:
        return float(self.T[a][s, s_next])

    def observation(self, a: int, s_next: int, o: int) -> float:
        return float(self.O[a][s_next, o])

    def reward(self, a: int, s: int, s_next: int, o: int) -> float:
        R = self.model.joint.rewards
        a, s, s_next, o = (min(i, n - 1) for i, n in zip((a, s, s_next, o), R.shape, strict=True))
        return float(R[a, s, s_next, o])

    def open(self, inputs: Inputs, lane: int) -> None:
        """Check a first input and start the reference belief from it."""
        joint, Y = self.model.joint, self.model.n_hidden
        x, s, o, a = self.read(inputs, lane)
        assert inputs.fresh[lane]
        start = joint.start.reshape(-1, Y)
        prior = start if self.domain.prior is None else self.domain.prior
        if self.world.hidden_first_action:
            assert 0 <= a < joint.n_actions
            before = [i for i in np.flatnonzero(joint.start) if self.transition(a, int(i), s) > 0]
            assert before, "no start state leads here"
            assert self.observation(a, s, o) > 0
            belief = update_hidden(self.model, prior[0] / prior[0].sum(), a, o, x=0, x_next=0, ended=False)
        else:
            assert a == joint.n_actions
            assert joint.start[s] > 0
            if self.world.tables.sensing.of_observed is None:
                assert o == joint.n_observations
            else:
                assert all(self.observation(b, s, o) == 1 for b in range(joint.n_actions))
            belief = prior[x] / prior[x].sum()
        self.beliefs[lane], self.steps[lane] = belief, 0
        self.check_belief(inputs, lane)

    def read(self, inputs: Inputs, lane: int) -> tuple[int, int, int, int]:
        x, s, o, a = (
            int(column[lane])
            for column in (inputs.observed, inputs.state, inputs.observation, inputs.last_action)
        )
        assert x == s // self.model.n_hidden
        return x, s, o, a

    def check_belief(self, inputs: Inputs, lane: int) -> None:
        if self.world.track_beliefs:
            np.testing.assert_allclose(inputs.belief[lane].numpy(), self.beliefs[lane], atol=2e-6, rtol=1e-4)

    def step(self, actions: torch.Tensor) -> None:
        """Take the actions (N,) and check all that comes back."""
        before = self.world.inputs.clone()
        openings = self.world.openings(self.uniform(START_VARIATES))
        outcome = self.world.step(actions, self.uniform(STEP_VARIATES), openings)
        for lane in range(self.followed):
            x, s, _, _ = self.read(before, lane)
            x_next, s_next, o, a = self.read(outcome.arrival, lane)
            assert a == actions[lane]
            self.steps[lane] += 1
            ended = bool(self.model.joint.reset[a, s])
            assert outcome.ended[lane] == ended
            truncated = not ended and self.steps[lane] == self.domain.episode_limit
            assert outcome.truncated[lane] == truncated
            if ended:
                reward = self.model.joint.expected_rewards[a, s]
            else:
                assert self.transition(a, s, s_next) > 0
                assert self.observation(a, s_next, o) > 0
                reward = self.reward(a, s, s_next, o)
                self.beliefs[lane] = self.filtered(lane, a, o, x, x_next)
                self.check_belief(outcome.arrival, lane)
            assert outcome.reward[lane].item() == np.float32(reward)
            assert not outcome.arrival.fresh[lane]
            self.check_next(outcome.arrival, openings, lane, ended or truncated)

    def filtered(self, lane: int, a: int, o: int, x: int, x_next: int) -> Floats:
        if self.domain.elimination is not None:
            kept = self.beliefs[lane] * self.domain.elimination[x_next]
            return kept / kept.sum()
        return update_hidden(self.model, self.beliefs[lane], a, o, x=x, x_next=x_next, ended=False)

    def check_next(self, arrival: Inputs, openings: Inputs, lane: int, done: bool) -> None:
        shown = openings if done else arrival
        for name, column in vars(self.world.inputs).items():
            assert torch.equal(column[lane], getattr(shown, name)[lane]), name
        if done:
            self.open(self.world.inputs, lane)
