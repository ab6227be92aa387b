"""One batched simulator for every tabular domain: all lanes of all seeds step at once, beliefs included.

Nothing in :meth:`TableWorld.step` waits for the device or depends on the data in its shapes, so that a whole
training update can be captured as one CUDA graph.

Episode semantics (paper, Appendix C; authors' code for what the paper leaves open):

- Classic episodes open with one unseen, uniformly random action: the agent's first input is the observation
  it gave and that action; its reward is dropped. ``hidden_first_action=False`` starts clean instead.
- Taking a in s with ``reset[a, s]`` ends the episode, after earning that pair's reward.
- A step that reaches the episode limit without ending cuts the episode (``truncated``).
- A lane whose episode is over shows the next episode's first input after the same step.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bgn.domains.domain import Domain
from bgn.simulation.compiled_tables import WorldTables, compile_tables

#: Uniform variates a lane consumes per step: successor, observation, and four for a possible new episode.
STEP_VARIATES = 2
START_VARIATES = 4


@dataclass
class Inputs:
    """What agents may look at, per lane; N lanes. Indices beyond the last name stand for "none yet"."""

    observation: Tensor  # (N,) int64; Ω before the first observation
    last_action: Tensor  # (N,) int64; A before the first action
    observed: Tensor  # (N,) int64 x
    state: Tensor  # (N,) int64 s
    belief: Tensor  # (N, Y) float32 b_Y; left alone unless the world tracks beliefs
    fresh: Tensor  # (N,) bool: this input opens an episode

    def split(self, parts: int) -> list[Inputs]:
        """View the lanes as that many equal parts."""
        return [Inputs(*views) for views in zip(*(v.chunk(parts) for v in vars(self).values()), strict=True)]

    def clone(self) -> Inputs:
        """Copy all tensors."""
        return Inputs(*(v.clone() for v in vars(self).values()))

    def copy_(self, other: Inputs) -> None:
        """Overwrite all tensors in place."""
        for mine, theirs in zip(vars(self).values(), vars(other).values(), strict=True):
            mine.copy_(theirs)

    def select(self, keep: Tensor, other: Inputs) -> Inputs:
        """Take lanes where ``keep`` is true from self, the rest from ``other``."""
        return Inputs(
            torch.where(keep, self.observation, other.observation),
            torch.where(keep, self.last_action, other.last_action),
            torch.where(keep, self.observed, other.observed),
            torch.where(keep, self.state, other.state),
            torch.where(keep[:, None], self.belief, other.belief),
            torch.where(keep, self.fresh, other.fresh),
        )


@dataclass(frozen=True)
class StepResult:
    """What one step of every lane did."""

    reward: Tensor  # (N,) float32
    ended: Tensor  # (N,) bool: the task ended the episode
    truncated: Tensor  # (N,) bool: the episode limit cut it
    arrival: Inputs  # where the step led, before lanes that are done moved on to their next episode


class TableWorld:
    """N independent lanes of one domain.

    Parameters
    ----------
    domain
        What to simulate.
    lanes
        N.
    device
        Where all tensors live.
    hidden_first_action
        Open episodes with an unseen random action; by default as the domain says.
    track_beliefs
        Filter the exact belief along (Eq. 1; Appendix E). Costs time; history and state agents need none.
    """

    def __init__(
        self,
        domain: Domain,
        lanes: int,
        *,
        device: torch.device | str = "cpu",
        hidden_first_action: bool | None = None,
        track_beliefs: bool = True,
    ) -> None:
        wanted = domain.hidden_first_action if hidden_first_action is None else hidden_first_action
        self.domain = domain
        self.lanes = lanes
        self.device = torch.device(device)
        self.hidden_first_action = wanted and domain.hidden_first_action
        self.track_beliefs = track_beliefs
        self.tables: WorldTables = compile_tables(domain, self.device, self.hidden_first_action)
        self.steps = torch.zeros(lanes, dtype=torch.int64, device=self.device)
        self.inputs = self._blank_inputs()

    def reset(self, variates: Tensor) -> Inputs:
        """Open a new episode in every lane; ``variates`` (N, 4) are uniform on [0, 1)."""
        self.steps.zero_()
        self.inputs = self.openings(variates)
        return self.inputs

    def openings(self, variates: Tensor) -> Inputs:
        """Draw first inputs of new episodes from ``variates`` (M, 4), without touching the lanes."""
        opening = self.tables.opening
        pick = torch.searchsorted(opening.cumulative, variates[:, 0].contiguous(), right=True)
        state = opening.states.index_select(0, pick)
        A, W = self.tables.n_actions, self.tables.n_observations
        if not self.hidden_first_action:
            observed = self._observed(state)
            action = torch.full_like(state, A)
            function = self.tables.sensing.of_observed
            observation = torch.full_like(state, W) if function is None else function[observed]
            belief = (
                opening.prior.index_select(0, observed) if self.track_beliefs else self._no_belief(len(state))
            )
        else:
            action = (variates[:, 1] * A).long().clamp_(max=A - 1)
            _, state = self._move(state * A + action, variates[:, 2])
            observed = self._observed(state)
            observation = self._observe(state, observed, action, variates[:, 3])
            assert opening.after_action is not None
            row = action * W + observation
            belief = (
                opening.after_action.index_select(0, row)
                if self.track_beliefs
                else self._no_belief(len(state))
            )
        fresh = torch.ones_like(state, dtype=torch.bool)
        return Inputs(observation, action, observed, state, belief, fresh)

    def step(self, action: Tensor, variates: Tensor, openings: Inputs) -> StepResult:
        """Take ``action`` (N,) in every lane; ``variates`` (N, 2); done lanes take ``openings``."""
        dynamics, now = self.tables.dynamics, self.inputs
        pair = now.state * self.tables.n_actions + action
        u_state, u_observation = variates.unbind(1)
        entry, state = self._move(pair, u_state)
        observed = self._observed(state)
        observation = self._observe(state, observed, action, u_observation)
        if dynamics.reward_width > 1:
            entry = entry * dynamics.reward_width + observation
        reward = dynamics.reward.index_select(0, entry)
        ended = dynamics.ends.index_select(0, pair)
        self.steps += 1
        truncated = (self.steps >= self.domain.episode_limit) > ended
        done = ended | truncated
        belief = self._filter(now, action, observed, observation) if self.track_beliefs else now.belief
        arrival = Inputs(observation, action, observed, state, belief, torch.zeros_like(done))
        self.steps.masked_fill_(done, 0)
        self.inputs = openings.select(done, arrival)
        return StepResult(reward, ended, truncated, arrival)

    def keep(self, lanes: Tensor) -> None:
        """Go on with the lanes of these indices only."""
        self.lanes = len(lanes)
        self.steps = self.steps[lanes]
        self.inputs = Inputs(*(v[lanes] for v in vars(self.inputs).values()))

    def _move(self, pair: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Draw successors of s * A + a; return their index into the flat successor list, and the states."""
        dynamics = self.tables.dynamics
        if dynamics.width > 1:
            pick = (u.unsqueeze(1) >= dynamics.cumulative.index_select(0, pair)).sum(1)
            pair = pair * dynamics.width + pick
        return pair, dynamics.successor.index_select(0, pair)

    def _observed(self, state: Tensor) -> Tensor:
        if self.tables.n_observed == 1:
            return torch.zeros_like(state)
        return state // self.tables.n_hidden

    def _observe(self, state: Tensor, observed: Tensor, action: Tensor, u: Tensor) -> Tensor:
        sensing = self.tables.sensing
        if sensing.of_observed is not None:
            return sensing.of_observed.index_select(0, observed)
        assert sensing.cumulative is not None
        row = action * self.tables.n_states + state
        return (u.unsqueeze(1) >= sensing.cumulative.index_select(0, row)).sum(1)

    def _filter(self, now: Inputs, action: Tensor, observed: Tensor, observation: Tensor) -> Tensor:
        """Condition the belief on x', o and the episode going on (Eq. 1; Appendix E)."""
        tables, rule = self.tables, self.tables.filter
        if rule.keep is not None:
            belief = now.belief * rule.keep[observed]
        else:
            belief = self._predict(now, action, observed, observation)
            if tables.sensing.likelihood is not None and not rule.of_observation:
                row = (action * tables.n_observed + observed) * tables.n_observations + observation
                belief *= tables.sensing.likelihood.index_select(0, row)
        # A lane whose episode just ended may hold an impossible belief; it is replaced, so only avoid 0/0.
        return belief.div_(belief.sum(1, keepdim=True).clamp_min_(torch.finfo(torch.float32).tiny))

    def _predict(self, now: Inputs, action: Tensor, observed: Tensor, observation: Tensor) -> Tensor:
        rule, Y = self.tables.filter, self.tables.n_hidden
        row = action if self.tables.n_observed == 1 else now.observed * self.tables.n_actions + action
        weighed = action * self.tables.n_observations + observation if rule.of_observation else row
        mass = now.belief if rule.source is None else now.belief.gather(1, rule.source.index_select(0, row))
        mass = mass * rule.weight.index_select(0, weighed)
        if rule.arrives is not None:
            mass *= rule.arrives.index_select(0, row) == observed[:, None]
        if rule.listed > 1:
            mass = mass.view(-1, rule.listed, Y).sum(1)
        if rule.hubs is not None and rule.hub_weight is not None:
            mass[:, rule.hubs] = torch.bmm(rule.hub_weight.index_select(0, weighed), now.belief[:, :, None])[
                :, :, 0
            ]
        return mass

    def _no_belief(self, n: int) -> Tensor:
        return torch.zeros(n, 1, device=self.device)

    def _blank_inputs(self) -> Inputs:
        zeros = torch.zeros(self.lanes, dtype=torch.int64, device=self.device)
        width = self.tables.n_hidden if self.track_beliefs else 1
        belief = torch.zeros(self.lanes, width, device=self.device)
        fresh = torch.ones(self.lanes, dtype=torch.bool, device=self.device)
        return Inputs(zeros, zeros, zeros, zeros, belief, fresh)
