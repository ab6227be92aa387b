"""What the three force-feedback domains share: actions become table rows, readings become features.

A finger reading is (cell, angle bin). The domains' tables say which reading follows each (x, a, y); here they
are assembled into the exact sparse model of Appendix E, with the joint state index x * |Y| + y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bgn.errors import InputError
from bgn.pomdp.model import MOMDP, POMDP

TRAINING_DISCOUNT: Final = 0.99  # paper, Table 5
REPORT_DISCOUNT: Final = 1.0  # the reported return is the success rate

Variant = Literal["paper", "authors"]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Rules:
    """The complete behaviour of a domain, as arrays over (x, a, y)."""

    successor: Integers  # (X, A, Y) next x; -1 where (x, y) cannot occur
    ends: Booleans  # (X, A, Y) whether the action ends the episode
    reward: Floats  # (X, A, Y)
    start: Floats  # (X, Y) joint probabilities
    observation: Integers  # (X,) the observation index an agent sees at x


@dataclass(frozen=True, eq=False, kw_only=True)
class Names:
    """Names of everything a domain's tables index."""

    observed: Sequence[str]  # (X,)
    hidden: Sequence[str]  # (Y,)
    actions: Sequence[str]  # (A,)
    readings: Sequence[str]  # (Ω,)


def check_variant(variant: str) -> None:
    """Raise ``ValueError`` unless ``variant`` is one of the two all robot domains have."""
    if variant not in get_args(Variant):
        raise InputError(f"unknown variant {variant!r}; known: {', '.join(get_args(Variant))}")


def assemble(rules: Rules, names: Names) -> MOMDP:
    """Build the exact mixed-observability model of a set of rules.

    Where an action ends the episode, and in joint states that cannot occur, T is a self loop instead of the
    start distribution: that row would hold thousands of entries in each of thousands of states, and a
    simulator never follows T on a ``reset`` pair.
    """
    X, A, Y = rules.successor.shape
    S = X * Y
    stays = rules.ends | (rules.successor < 0)
    x_next = np.where(stays, np.arange(X)[:, None, None], rules.successor)  # (X, A, Y)
    s_next = np.swapaxes(x_next * Y + np.arange(Y), 0, 1).reshape(A, S)
    seen = _one_hot(np.repeat(rules.observation, Y), len(names.readings))
    joint = POMDP(
        transitions=tuple(_one_hot(s_next[a], S) for a in range(A)),
        observations=(seen,) * A,
        rewards=np.swapaxes(rules.reward, 0, 1).reshape(A, S, 1, 1).copy(),
        start=rules.start.reshape(S),
        reset=np.swapaxes(rules.ends, 0, 1).reshape(A, S).copy(),
        discount=TRAINING_DISCOUNT,
        state_names=tuple(f"{x}|{y}" for x in names.observed for y in names.hidden),
        action_names=tuple(names.actions),
        observation_names=tuple(names.readings),
    )
    return MOMDP(joint, n_observed=X)


def join_features(observed: NDArray[np.float32], hidden: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (X * Y, f + g) features of all joint states from (X, f) and (Y, g)."""
    X, Y = len(observed), len(hidden)
    return np.hstack([np.repeat(observed, Y, axis=0), np.tile(hidden, (X, 1))])


def _one_hot(columns: Integers, width: int) -> sparse.csr_array:
    """Return the sparse (len(columns), width) array with a single 1 per row."""
    n = len(columns)
    return sparse.csr_array((np.ones(n), columns, np.arange(n + 1)), shape=(n, width))
