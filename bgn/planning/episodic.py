"""How an episode opens and ends, for planning: start beliefs, and resets as absorbing ends.

A planner must not read ``reset`` as a jump back to the start, which would make the task a continuing one with
other values: an episode is over once it resets. Two conventions for its opening are in use in the paper's
table; both only differ in the beliefs from which the policy begins to act, see :func:`start_beliefs`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bgn.domains.episode_opening import CLEAN, HIDDEN, EpisodeOpening
from bgn.errors import InputError
from bgn.pomdp.model import MOMDP, POMDP, Floats

#: Beliefs less likely than this are left out of the possible openings of an episode.
NEGLIGIBLE = 1e-15


class StartBelief(NamedTuple):
    """A belief from which a policy may have to begin."""

    weight: float
    """Probability of this opening."""
    belief: Floats
    """(S,) distribution over the joint states."""
    seen: int
    """What tells it from the others: action * |Ω| + observation of a hidden first action, else x."""


def start_beliefs(model: POMDP | MOMDP, convention: EpisodeOpening = CLEAN) -> tuple[StartBelief, ...]:
    """Return the beliefs a policy begins from, with their probabilities.

    ``clean``: the start distribution; in a mixed-observability model the first x is seen, so one belief for
    each x. ``hidden-first-action``: nature first takes a uniformly random action, whose observation is seen
    and whose reward and episode end are not (the authors' environment wrappers), so one belief for each
    (action, observation).

    Raises
    ------
    ValueError
        Unknown convention, or a hidden first action in a mixed-observability model.
    """
    if convention not in get_args(EpisodeOpening):
        raise InputError(f"unknown convention {convention!r}; known: {', '.join(get_args(EpisodeOpening))}")
    joint, n_observed = (model.joint, model.n_observed) if isinstance(model, MOMDP) else (model, 1)
    if convention == HIDDEN:
        if n_observed > 1:
            raise InputError("a mixed-observability model shows its start: it has no hidden first action")
        unnormalised = [
            (joint.start @ joint.transitions[a]) * column / joint.n_actions
            for a in range(joint.n_actions)
            for column in joint.observations[a].toarray().T
        ]
    else:
        unnormalised = list(_split_by_observed(joint.start, n_observed))
    weights = [float(belief.sum()) for belief in unnormalised]
    return tuple(
        StartBelief(weight, belief / weight, seen)
        for seen, (weight, belief) in enumerate(zip(weights, unnormalised, strict=True))
        if weight > NEGLIGIBLE
    )


def _split_by_observed(start: Floats, n_observed: int) -> Floats:
    """Return start restricted to each x, shape (X, S)."""
    parts = np.zeros((n_observed, n_observed, start.size // n_observed))
    diagonal = np.arange(n_observed)
    parts[diagonal, diagonal] = start.reshape(n_observed, -1)
    return parts.reshape(n_observed, -1)


def continuing_transitions(model: POMDP) -> tuple[sparse.csr_array, ...]:
    """Return T(s, a, s') without the rows that end the episode, one (S, S) array an action."""
    return tuple(
        sparse.csr_array(sparse.diags_array((~ends).astype(np.float64)) @ transition)
        for ends, transition in zip(model.reset, model.transitions, strict=True)
    )


def worthless_states(model: POMDP) -> NDArray[np.bool_]:
    """Return the states from which nothing can be earned or lost any more (an episode's ends), shape (S,)."""
    live: NDArray[np.bool_] = np.asarray((model.expected_rewards != 0).any(axis=0))
    moves = continuing_transitions(model)
    while True:
        grown = live | np.logical_or.reduce([(move @ live.astype(np.float64)) > 0 for move in moves])
        if (grown == live).all():
            return np.asarray(~live)
        live = grown


def without_resets(model: POMDP) -> POMDP:
    """Return an equivalent model in which episodes end in an absorbing state instead of a reset.

    Values of policies from the start are the same. Rewards become their expectations R(a, s). A state in
    which every action only resets becomes absorbing itself; if others reset too, a state and an observation
    ``end`` are added, which the reset leads to.
    """
    absorbing = model.reset.all(axis=0) & (model.expected_rewards == 0).all(axis=0)
    ending = model.reset & ~absorbing
    if ending.any():
        model, absorbing, ending = _with_end(model, absorbing, ending)
    S = model.n_states
    return replace(
        model,
        transitions=tuple(
            _redirected(model.transitions[a], absorbing, np.arange(S)) for a in range(model.n_actions)
        ),
        rewards=np.where(absorbing, 0.0, model.expected_rewards)[:, :, None, None],
        reset=np.zeros_like(model.reset),
    )


def _with_end(
    model: POMDP, absorbing: NDArray[np.bool_], ending: NDArray[np.bool_]
) -> tuple[POMDP, NDArray[np.bool_], NDArray[np.bool_]]:
    """Add the absorbing state ``end`` with an observation of its own, and lead the endings there."""
    S, A = model.n_states, model.n_actions
    one = sparse.csr_array(np.ones((1, 1)))
    transitions, observations = [], []
    for a in range(A):
        grown = sparse.csr_array(sparse.block_diag((model.transitions[a], one)))
        transitions.append(_redirected(grown, np.append(ending[a], False), np.full(S + 1, S)))
        observations.append(sparse.csr_array(sparse.block_diag((model.observations[a], one))))
    rewards = np.hstack([model.expected_rewards, np.zeros((A, 1))])
    grown_model = POMDP(
        transitions=tuple(transitions),
        observations=tuple(observations),
        rewards=rewards[:, :, None, None],
        start=np.append(model.start, 0.0),
        reset=np.zeros((A, S + 1), dtype=np.bool_),
        discount=model.discount,
        state_names=(*model.state_names, _free_name("end", model.state_names)),
        action_names=model.action_names,
        observation_names=(*model.observation_names, _free_name("end", model.observation_names)),
    )
    return grown_model, np.append(absorbing, False), np.zeros((A, S + 1), dtype=np.bool_)


def _redirected(
    transition: sparse.csr_array, rows: NDArray[np.bool_], target: NDArray[np.int64]
) -> sparse.csr_array:
    """Replace the given rows of a transition array by certain moves to ``target``."""
    S = transition.shape[0]
    certain = sparse.csr_array((np.ones(S), (np.arange(S), target)), shape=(S, S))
    keep, move = sparse.diags_array((~rows).astype(np.float64)), sparse.diags_array(rows.astype(np.float64))
    result = sparse.csr_array(keep @ transition + move @ certain)
    result.eliminate_zeros()
    return result


def _free_name(wanted: str, taken: tuple[str, ...]) -> str:
    while wanted in taken:
        wanted += "_"
    return wanted
