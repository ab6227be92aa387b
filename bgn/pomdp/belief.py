"""Exact belief updates, one belief at a time: the slow reference that fast simulators are tested against.

Paper, Equation 1 (POMDP) and Appendix E (MOMDP). Where a model's episodes can end, T mixes two events: going
on, and starting over (``reset``). A filter that is told which of the two happened conditions on it through
``ended``.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bgn.errors import BgnError
from bgn.pomdp.model import MOMDP, POMDP, Floats


class ImpossibleObservationError(BgnError, ValueError):
    """The model gives what was observed probability zero under the belief; there is no posterior."""


def update(
    model: POMDP, belief: Floats, action: int, observation: int, *, ended: bool | None = None
) -> Floats:
    """Return b'(s') ∝ O(s', a, o) Σ_s T(s, a, s') b(s), shape (S,) (paper, Eq. 1).

    ``belief`` is b(s), shape (S,); it need not be normalised. ``ended`` says whether this step ended the
    episode, where the filter may know: False rules out the states in which the action ends it, True makes the
    arrival a new start, None (Eq. 1 to the letter) leaves both to T.

    Raises
    ------
    ImpossibleObservationError
        P(o | a, b) is zero.
    ValueError
        A belief of another shape, or an action or observation that the model does not have.
    """
    _check_belief(belief, model.n_states, "belief")
    _check_index(action, model.n_actions, "action")
    _check_index(observation, model.n_observations, "observation")
    if ended:
        arrival = model.start * (belief @ model.reset[action])  # (S',)
    else:
        arrival = (belief * _possible(model, action, ended)) @ model.transitions[action]
    return _posterior(model, model.observations[action], arrival, action, observation)


def update_hidden(
    model: MOMDP,
    belief: Floats,
    action: int,
    observation: int,
    *,
    x: int,
    x_next: int,
    ended: bool | None = None,
) -> Floats:
    """Return b'_Y(y') ∝ O(x', y', a, o) Σ_y P(x', y' | x, y, a) b_Y(y), shape (Y,) (paper, Appendix E).

    ``belief`` is b_Y, shape (Y,); ``x`` and ``x_next`` are the observed parts before and after the action.
    The rest is as in :func:`update`; an ``x_next`` that cannot follow is an impossible observation too.
    """
    joint, Y = model.joint, model.n_hidden
    _check_belief(belief, Y, "hidden belief")
    _check_index(action, joint.n_actions, "action")
    _check_index(observation, joint.n_observations, "observation")
    _check_index(x, model.n_observed, "x")
    _check_index(x_next, model.n_observed, "x_next")
    here, there = slice(x * Y, (x + 1) * Y), slice(x_next * Y, (x_next + 1) * Y)
    if ended:
        arrival = joint.start[there] * (belief @ joint.reset[action, here])  # (Y',)
    else:
        T = joint.transitions[action][here, there]  # (Y, Y')
        arrival = (belief * _possible(joint, action, ended)[here]) @ T
    return _posterior(joint, joint.observations[action][there], arrival, action, observation)


def _possible(model: POMDP, action: int, ended: bool | None) -> Floats:
    """Return 1 for the states that what is known about the episode's end leaves possible; shape (S,)."""
    if ended is None:
        return np.ones(model.n_states)
    return np.where(model.reset[action], 0.0, 1.0)


def _posterior(model: POMDP, O: sparse.csr_array, arrival: Floats, action: int, observation: int) -> Floats:
    seen = np.zeros(model.n_observations)
    seen[observation] = 1.0
    unnormalised: Floats = (O @ seen) * arrival
    total = unnormalised.sum()
    if not total > 0:
        raise ImpossibleObservationError(
            f"observation {model.observation_names[observation]!r} is impossible after action "
            f"{model.action_names[action]!r} under this belief"
        )
    posterior: Floats = unnormalised / total
    return posterior


def _check_belief(belief: Floats, size: int, what: str) -> None:
    if belief.shape != (size,):
        raise ValueError(f"{what} has shape {belief.shape}, not ({size},)")


def _check_index(index: int, size: int, what: str) -> None:
    if not 0 <= index < size:
        raise ValueError(f"{what} {index} is not in 0..{size - 1}")
