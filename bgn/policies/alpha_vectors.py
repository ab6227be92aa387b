"""A policy and a lower bound in one: alpha vectors, each with the action it begins with; and how they act."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.policies.belief_tracker import BeliefTracker
from bgn.pomdp.model import Floats
from bgn.simulation.table_world import Inputs

#: Sizes of the products in which the best vectors of many beliefs are found (measured: half the time of one product).
VECTORS_AT_ONCE, BELIEFS_AT_ONCE = 1024, 250


@dataclass(frozen=True, eq=False, kw_only=True)
class AlphaVectors:
    """V(b) = max_i α_i · b; the policy takes the action of the vector that attains it.

    Raises
    ------
    InputError
        There is no vector, an entry is not finite, or the arrays do not match.
    """

    vectors: Floats  # (n, S)
    actions: NDArray[np.int64]  # (n,)

    def __post_init__(self) -> None:
        if self.vectors.ndim != 2 or self.vectors.size == 0:
            raise InputError(f"alpha vectors of shape {self.vectors.shape}; there must be one at least")
        if self.actions.shape != self.vectors.shape[:1]:
            raise InputError(f"{self.actions.size} actions for {len(self.vectors)} alpha vectors")
        if not np.isfinite(self.vectors).all():
            raise InputError("alpha vectors must be finite")
        if self.actions.min() < 0:
            raise InputError(f"an alpha vector has action {self.actions.min()}")

    def __len__(self) -> int:
        return len(self.vectors)


@dataclass(frozen=True, eq=False)
class _Block:
    """The vectors that may be the best where x is seen, cut to its states."""

    values: Floats  # (m, Y)
    actions: NDArray[np.int64]  # (m,)
    columns: tuple[Tensor, ...]  # (Y, m) float32 in pieces, for many beliefs at once
    actions_tensor: Tensor  # (m,)


class AlphaVectorPolicy:
    """Acts on the exact belief, which it tracks from what it sees.

    Parameters
    ----------
    alpha
        Vectors over the joint states of the domain's model.
    domain
        Where it acts.

    Raises
    ------
    InputError
        The vectors are for another number of states or actions.
    """

    def __init__(self, alpha: AlphaVectors, domain: Domain) -> None:
        model = domain.model
        _check_fits(alpha, domain)
        self.alpha, self.domain = alpha, domain
        parts = alpha.vectors.reshape(len(alpha), model.n_observed, model.n_hidden)
        self._blocks = [_block(parts[:, x], alpha.actions) for x in range(model.n_observed)]
        self.sees_beliefs = bool((alpha.actions != alpha.actions[0]).any())  # else there is nothing to choose
        self._tracker = BeliefTracker(domain)
        self.reset()

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Begin anew; nothing is drawn."""
        self._fresh = True

    def act(self, observation: int, last_action: int | None) -> int:
        """Return the action of the best vector at the belief after ``last_action`` led to ``observation``."""
        none_yet = self.domain.model.joint.n_actions  # how environments show that there was no action
        before = None if last_action == none_yet else last_action
        self._tracker.see(observation, before, fresh=self._fresh)
        self._fresh = False
        block = self._blocks[self._tracker.x]
        return int(block.actions[(block.values @ self._tracker.belief).argmax()])

    def act_in_lanes(self, inputs: Inputs, generator: torch.Generator) -> Tensor:
        """Return the action of the best vector at every lane's belief."""
        if not self.sees_beliefs:
            return torch.full_like(inputs.state, int(self.alpha.actions[0]))
        if len(self._blocks) == 1:
            return _choose(self._blocks[0], inputs.belief)
        action = torch.empty_like(inputs.observed)
        for x in sorted(set(inputs.observed.tolist())):
            lanes = (inputs.observed == x).nonzero()[:, 0]
            action[lanes] = _choose(self._blocks[x], inputs.belief[lanes])
        return action


def _block(values: Floats, actions: NDArray[np.int64]) -> _Block:
    """Leave out vectors that a constant below another vector dominates, and repeated ones."""
    floor = values.min(axis=1)
    kept = np.flatnonzero((values.max(axis=1) > floor.max()) | (np.arange(len(values)) == floor.argmax()))
    _, first = np.unique(values[kept], axis=0, return_index=True)
    kept = kept[np.sort(first)]
    return _Block(
        values=np.ascontiguousarray(values[kept]),
        actions=actions[kept],
        columns=tuple(
            torch.from_numpy(np.ascontiguousarray(values[piece].T, dtype=np.float32))
            for piece in (kept[i : i + VECTORS_AT_ONCE] for i in range(0, kept.size, VECTORS_AT_ONCE))
        ),
        actions_tensor=torch.from_numpy(actions[kept]),
    )


def _choose(block: _Block, beliefs: Tensor) -> Tensor:
    """Return the action of the best vector at each belief, piece by piece: products that fit the cache."""
    chosen = []
    for start in range(0, len(beliefs), BELIEFS_AT_ONCE):
        few = beliefs[start : start + BELIEFS_AT_ONCE]
        best, at = (few @ block.columns[0]).max(1)
        first = block.columns[0].shape[1]
        for columns in block.columns[1:]:
            value, index = (few @ columns).max(1)
            better = value > best
            best, at = torch.where(better, value, best), torch.where(better, index + first, at)
            first += columns.shape[1]
        chosen.append(at)
    return block.actions_tensor[torch.cat(chosen)]


def _check_fits(alpha: AlphaVectors, domain: Domain) -> None:
    model, n_states = domain.model.joint, alpha.vectors.shape[1]
    if n_states != model.n_states:
        raise InputError(f"the policy is for {n_states} states, {domain.id} has {model.n_states}")
    if alpha.actions.max() >= model.n_actions:
        raise InputError(f"the policy takes action {alpha.actions.max()}; {domain.id} has {model.n_actions}")
