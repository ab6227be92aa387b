"""Policies that need no search: reference rows of the tables."""

from __future__ import annotations

import numpy as np

from bgn.domains.episode_opening import CLEAN, EpisodeOpening
from bgn.errors import InputError
from bgn.planning.bounds import fast_informed, mdp_values
from bgn.planning.compiled import CompiledModel, compile_model
from bgn.planning.episodic import start_beliefs
from bgn.policies.alpha_vectors import AlphaVectors
from bgn.pomdp.model import MOMDP, POMDP, Floats


def always(model: POMDP, action: str) -> AlphaVectors:
    """Return the policy that only ever takes one action.

    Raises
    ------
    InputError
        The model has no action of that name.
    """
    if action not in model.action_names:
        raise InputError(f"no action {action!r}; known: {', '.join(model.action_names)}")
    index = model.action_names.index(action)
    return AlphaVectors(vectors=np.zeros((1, model.n_states)), actions=np.array([index]))


def qmdp(model: MOMDP, convention: EpisodeOpening = CLEAN) -> AlphaVectors:
    """Return the policy that acts as if the state were seen from the next step on (Littman et al. 1995)."""
    compiled = compile_model(model.joint, start_beliefs(model, convention))
    return _vector_per_action(model.joint, compiled, mdp_values(compiled))


def informed(model: MOMDP, convention: EpisodeOpening = CLEAN) -> AlphaVectors:
    """Return the greedy policy of the fast informed bound (Hauskrecht 2000)."""
    compiled = compile_model(model.joint, start_beliefs(model, convention))
    return _vector_per_action(model.joint, compiled, fast_informed(compiled))


def _vector_per_action(model: POMDP, compiled: CompiledModel, q: Floats) -> AlphaVectors:
    """Spread a vector per action, shape (A, L), over the original states; dropped ones are worth 0."""
    vectors = np.zeros((model.n_actions, model.n_states))
    vectors[:, compiled.states] = q
    return AlphaVectors(vectors=vectors, actions=np.arange(model.n_actions))
