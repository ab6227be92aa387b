"""Simulated episodes of a policy in the tables of a domain, many side by side."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from bgn.domains.domain import Domain
from bgn.domains.episode_opening import CLEAN, HIDDEN, EpisodeOpening
from bgn.errors import InputError
from bgn.simulation.policy import LanePolicy, Policy
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, Inputs, TableWorld

#: Two-sided 95 % quantile of the normal distribution.
Z95 = 1.959963984540054
#: Episodes simulated at once.
BATCH = 1000
#: Lanes whose episode is over are dropped when fewer than this share goes on.
LEAST_SHARE_GOING_ON = 0.9


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Statistics of simulated episodes."""

    episodes: int
    mean: float
    """Discounted return, the first counted reward undiscounted."""
    standard_deviation: float
    """Of single episodes."""
    success: float
    """Share of episodes whose undiscounted return is positive."""
    length: float
    """Mean counted steps."""

    @property
    def standard_error(self) -> float:
        """Of the mean return."""
        return self.standard_deviation / float(np.sqrt(self.episodes))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the mean return (normal approximation)."""
        return self.mean - Z95 * self.standard_error, self.mean + Z95 * self.standard_error


def evaluate(
    domain: Domain,
    policy: Policy,
    *,
    episodes: int,
    seed: int,
    convention: EpisodeOpening = CLEAN,
    limit: int | None = None,
    discount: float | None = None,
) -> Evaluation:
    """Simulate a policy, acting on exact beliefs if it wants them.

    An episode ends with the step that resets, or after ``limit`` counted steps (the domain's own if not
    given). ``discount`` weighs the reported return; the model's own if not given. The same seed gives the same
    episodes. A policy that acts in many lanes at once does so; of any other, every lane gets a copy.

    Raises
    ------
    InputError
        A count makes no sense, or the domain's episodes cannot open like that.
    """
    limit = domain.episode_limit if limit is None else limit
    if episodes < 2 or limit < 1:
        raise InputError(f"{episodes} episodes of at most {limit} steps; there must be 2 and 1 at least")
    if convention == HIDDEN and not domain.hidden_first_action:
        raise InputError(f"{domain.id} has no hidden first action: its episodes only open clean")
    weight = domain.model.joint.discount if discount is None else discount
    generator = torch.Generator().manual_seed(seed)
    limited = replace(domain, episode_limit=limit)
    batches, n_actions = [], domain.model.joint.n_actions
    for first in range(0, episodes, BATCH):
        n = min(BATCH, episodes - first)
        lanes = policy if isinstance(policy, LanePolicy) else _Copies(policy, n_actions, n, (seed, first))
        world = TableWorld(
            limited, n, hidden_first_action=convention == HIDDEN, track_beliefs=lanes.sees_beliefs
        )
        batches.append(_play(world, lanes, weight, generator))
    returns, totals, lengths = torch.cat(batches, 1).numpy()
    return Evaluation(
        episodes=episodes,
        mean=float(returns.mean()),
        standard_deviation=float(returns.std(ddof=1)),
        success=float((totals > 0).mean()),
        length=float(lengths.mean()),
    )


@torch.no_grad()
def _play(
    world: TableWorld, policy: LanePolicy | _Copies, discount: float, generator: torch.Generator
) -> Tensor:
    """Play an episode in every lane; returns (3, N): discounted return, undiscounted return, counted steps."""
    n = world.lanes
    results = torch.zeros(3, n, dtype=torch.float64)
    episode, going = torch.arange(n), torch.ones(n, dtype=torch.bool)
    world.reset(torch.rand(n, START_VARIATES, generator=generator))
    for t in range(world.domain.episode_limit):
        action = policy.act_in_lanes(world.inputs, generator)
        variates = torch.rand(world.lanes, STEP_VARIATES, generator=generator)
        outcome = world.step(action, variates, world.inputs)
        earned = outcome.reward.double() * going
        results.index_add_(1, episode, torch.stack((earned * discount**t, earned, going.double())))
        going = going & ~(outcome.ended | outcome.truncated)
        left = going.nonzero()[:, 0]
        if len(left) == 0:
            break
        if len(left) < LEAST_SHARE_GOING_ON * world.lanes:
            world.keep(left)
            episode, going = episode[left], going[left]
            if isinstance(policy, _Copies):
                policy.keep(left.tolist())
    return results


class _Copies:
    """A copy of a policy for every lane."""

    sees_beliefs = False

    def __init__(self, policy: Policy, n_actions: int, lanes: int, seed: tuple[int, int]) -> None:
        self._n_actions = n_actions
        self._policies = [copy.deepcopy(policy) for _ in range(lanes)]
        for lane, one in enumerate(self._policies):
            one.reset(np.random.default_rng((*seed, lane)))

    def act_in_lanes(self, inputs: Inputs, generator: torch.Generator) -> Tensor:
        """Let every copy act on its own lane."""
        seen = zip(self._policies, inputs.observation.tolist(), inputs.last_action.tolist(), strict=True)
        return torch.tensor([one.act(o, None if a == self._n_actions else a) for one, o, a in seen])

    def keep(self, lanes: list[int]) -> None:
        """Go on with the lanes of these indices only."""
        self._policies = [self._policies[lane] for lane in lanes]
