"""Policies that need no search: reference rows of the tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bgn.errors import InputError
from bgn.planning.alpha_vectors import AlphaVectors
from bgn.planning.bounds import fast_informed, mdp_values
from bgn.planning.compiled import CompiledModel
from bgn.pomdp.model import POMDP, Floats


@dataclass(frozen=True)
class UniformRandom:
    """Takes every action with the same probability, whatever it sees."""


Policy = AlphaVectors | UniformRandom
"""Everything the benchmark plans with is one of these two; a fixed action is a single alpha vector."""


def always(model: POMDP, action: str) -> AlphaVectors:
    """Return the policy that only ever takes one action.

    Raises
    ------
    ValueError
        The model has no action of that name.
    """
    if action not in model.action_names:
        raise InputError(f"no action {action!r}; known: {', '.join(model.action_names)}")
    index = model.action_names.index(action)
    return AlphaVectors(vectors=np.zeros((1, model.n_states)), actions=np.array([index]))


def qmdp(model: POMDP, compiled: CompiledModel) -> AlphaVectors:
    """Return the policy that acts as if the state were seen from the next step on (Littman et al. 1995)."""
    return _one_each(model, compiled, mdp_values(compiled))


def informed(model: POMDP, compiled: CompiledModel) -> AlphaVectors:
    """Return the greedy policy of the fast informed bound (Hauskrecht 2000)."""
    return _one_each(model, compiled, fast_informed(compiled))


def _one_each(model: POMDP, compiled: CompiledModel, q: Floats) -> AlphaVectors:
    """Spread one vector an action, shape (A, L), over the original states; dropped ones are worth 0."""
    vectors = np.zeros((model.n_actions, model.n_states))
    vectors[:, compiled.states] = q
    return AlphaVectors(vectors=vectors, actions=np.arange(model.n_actions))
