"""Tabular decision processes under partial observability, as sparse arrays.

Shapes use the paper's letters (Section 2): S states, A actions, Ω observations; a mixed-observability
model (Appendix E) factors S = X x Y into an observed part x and a hidden part y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bgn.errors import BgnError

Floats = NDArray[np.float64]

#: How far a probability distribution's sum may be from one (the file format prints few decimals).
SUM_TOLERANCE = 1e-5


class ModelError(BgnError, ValueError):
    """A model whose arrays contradict each other; the message says which and how."""


@dataclass(frozen=True, eq=False, kw_only=True)
class POMDP:
    """A finite POMDP (S, A, T, R, Ω, O) with a start distribution and episode ends.

    ``transitions[a]`` is T(s, a, s'), a sparse (S, S) array; ``observations[a]`` is O(s', a, o), a sparse
    (S, Ω) array. ``rewards`` is R(a, s, s', o), stored as a 4-D array in which an axis that does not matter
    has length one, so that it broadcasts to (A, S, S', Ω).
    """

    transitions: tuple[sparse.csr_array, ...]
    observations: tuple[sparse.csr_array, ...]
    rewards: Floats
    start: Floats  # (S,) probabilities
    # (A, S): taking a in s ends the episode. T then leads to the start distribution or, where that row
    # would be too wide to store in every such state (robot domains), stays in s: nothing may follow T
    # there.
    reset: NDArray[np.bool_]
    discount: float
    state_names: tuple[str, ...]
    action_names: tuple[str, ...]
    observation_names: tuple[str, ...]

    @property
    def n_states(self) -> int:
        """|S|."""
        return len(self.state_names)

    @property
    def n_actions(self) -> int:
        """|A|."""
        return len(self.action_names)

    @property
    def n_observations(self) -> int:
        """|Ω|."""
        return len(self.observation_names)

    def __post_init__(self) -> None:
        S, A, O = self.n_states, self.n_actions, self.n_observations
        _require(len(self.transitions) == A, f"{len(self.transitions)} transition arrays for {A} actions")
        _require(len(self.observations) == A, f"{len(self.observations)} observation arrays for {A} actions")
        for a, name in enumerate(self.action_names):
            _check_rows(self.transitions[a], (S, S), f"T[{name}]")
            _check_rows(self.observations[a], (S, O), f"O[{name}]")
        full = (A, S, S, O)
        R = self.rewards
        fits = R.ndim == 4 and all(n in (1, m) for n, m in zip(R.shape, full, strict=True))
        _require(fits, f"rewards of shape {self.rewards.shape} do not broadcast to (A, S, S', Ω) = {full}")
        _require(bool(np.isfinite(self.rewards).all()), "rewards must be finite")
        _require(self.start.shape == (S,), f"start has shape {self.start.shape}, not ({S},)")
        _require(bool((self.start >= 0).all()), "start has a negative probability")
        _require(abs(self.start.sum() - 1) <= SUM_TOLERANCE, f"start sums to {self.start.sum():.6g}, not 1")
        _require(self.reset.shape == (A, S), f"reset has shape {self.reset.shape}, not {(A, S)}")
        _require(0 <= self.discount <= 1, f"discount {self.discount} is not in [0, 1]")

    def dense(self) -> tuple[Floats, Floats, Floats]:
        """Return (T[a, s, s'], O[a, s', o], R[a, s, s', o]); R is a read-only broadcast view."""
        T = np.stack([t.toarray() for t in self.transitions])
        O = np.stack([o.toarray() for o in self.observations])
        R = np.broadcast_to(self.rewards, (self.n_actions, self.n_states, self.n_states, self.n_observations))
        return T, O, R

    @cached_property
    def expected_rewards(self) -> Floats:
        """R(a, s) = Σ_s' T(s, a, s') Σ_o O(s', a, o) R(a, s, s', o), shape (A, S)."""
        return np.stack([_expected_reward(self, a) for a in range(self.n_actions)])


@dataclass(frozen=True, eq=False)
class MOMDP:
    """A POMDP whose state factors as s = (x, y) with x fully observed (paper, Appendix E).

    The joint state index is ``x * n_hidden + y``. A plain POMDP is the case of a single x.
    """

    joint: POMDP
    n_observed: int = 1
    n_hidden: int = field(init=False)

    def __post_init__(self) -> None:
        _require(
            self.n_observed >= 1 and self.joint.n_states % self.n_observed == 0,
            f"{self.joint.n_states} states do not factor into {self.n_observed} observed parts",
        )
        object.__setattr__(self, "n_hidden", self.joint.n_states // self.n_observed)


def sparse_rows(rows: Sequence[Mapping[int, float]], n_columns: int) -> sparse.csr_array:
    """Return the (len(rows), n_columns) array whose row i holds the values ``{column: value}`` of rows[i]."""
    array = sparse.csr_array(
        (
            np.fromiter((value for row in rows for value in row.values()), dtype=np.float64),
            np.fromiter((column for row in rows for column in row), dtype=np.int32),
            np.cumsum([0, *map(len, rows)], dtype=np.int32),
        ),
        shape=(len(rows), n_columns),
    )
    array.eliminate_zeros()
    array.sort_indices()
    return array


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ModelError(message)


def _check_rows(array: sparse.csr_array, shape: tuple[int, int], name: str) -> None:
    _require(array.shape == shape, f"{name} has shape {array.shape}, not {shape}")
    _require(bool((array.data >= 0).all()), f"{name} has a negative (or NaN) probability")
    sums = np.asarray(array.sum(axis=1)).ravel()
    worst = int(np.abs(sums - 1).argmax())
    _require(abs(sums[worst] - 1) <= SUM_TOLERANCE, f"{name} row {worst} sums to {sums[worst]:.6g}, not 1")


def _expected_reward(model: POMDP, a: int) -> Floats:
    """Sum R(a, ., ., .) over the successors and observations of each state; shape (S,)."""
    R = model.rewards[min(a, model.rewards.shape[0] - 1)]  # (S or 1, S' or 1, Ω or 1)
    S = model.n_states
    if R.shape[1] == R.shape[2] == 1:
        return np.broadcast_to(R[:, 0, 0], (S,)).copy()
    T = model.transitions[a].tocoo()
    s, s_next = T.coords
    values = R[np.minimum(s, R.shape[0] - 1), np.minimum(s_next, R.shape[1] - 1)]  # (nonzeros, Ω or 1)
    if R.shape[2] == 1:
        per_transition = values[:, 0]
    else:
        seen = model.observations[a].toarray()[s_next]  # (nonzeros, Ω)
        per_transition = (seen * values).sum(axis=1)
    return np.bincount(s, weights=T.data * per_transition, minlength=S).astype(np.float64)
