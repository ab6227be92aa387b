"""Bounds that need no search: the MDP and fast informed upper bounds, and blind policies below.

Iterations start on the safe side of their fixed point, so that stopping them early leaves a valid bound.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import sparse

from bgn.planning.compiled import CompiledModel, Ints
from bgn.pomdp.model import Floats

#: Iterations stop when no value moves by more than this share of the value scale.
RELATIVE_TOLERANCE = 1e-10
#: Enough sweeps for a discount of 0.999.
MAX_SWEEPS = 20_000


def transition_array(compiled: CompiledModel, a: int) -> sparse.csr_array:
    """T(s, a, s') among the live states as a sparse (L, L) array; rows sum to at most one."""
    L, rows = compiled.n_live, compiled.t_first[a]
    inside = slice(rows[0], rows[-1])
    return sparse.csr_array((compiled.t_p[inside], compiled.t_to[inside], rows - rows[0]), shape=(L, L))


def value_scale(compiled: CompiledModel) -> float:
    """Return max |R| / (1 - γ), beyond which no value lies (at least a tiny positive number)."""
    largest = float(np.abs(compiled.rewards).max(initial=0.0))
    return max(largest / (1 - compiled.discount), 1e-12)


def mdp_values(compiled: CompiledModel) -> Floats:
    """Q(a, s) of the underlying MDP, an upper bound that pretends to see the state; shape (A, L)."""
    moves = sparse.csr_array(
        sparse.vstack([transition_array(compiled, a) for a in range(compiled.n_actions)])
    )
    scale = value_scale(compiled)
    v = np.full(compiled.n_live, max(0.0, float(compiled.rewards.max(initial=0.0)) / (1 - compiled.discount)))
    q = np.zeros_like(compiled.rewards)
    for _ in range(MAX_SWEEPS):
        q = compiled.rewards + compiled.discount * (moves @ v).reshape(q.shape)
        v_next = q.max(axis=0)
        if np.abs(v_next - v).max(initial=0.0) <= RELATIVE_TOLERANCE * scale:
            break
        v = v_next
    return q


def fast_informed(compiled: CompiledModel) -> Floats:
    """Alpha vectors of the fast informed bound (Hauskrecht 2000), one for each action; shape (A, L).

    Tighter than the MDP's: it pretends to see the state only after the next observation.
    """
    return _fast_informed(compiled, mdp_values(compiled), RELATIVE_TOLERANCE * value_scale(compiled))


def blind_policies(compiled: CompiledModel) -> Floats:
    """Values of always taking one action, lower bounds; shape (A, L)."""
    values = np.empty_like(compiled.rewards)
    lowest = min(0.0, float(compiled.rewards.min(initial=0.0)) / (1 - compiled.discount))
    for a in range(compiled.n_actions):
        move, v = compiled.discount * transition_array(compiled, a), np.full(compiled.n_live, lowest)
        for _ in range(MAX_SWEEPS):
            v_next = compiled.rewards[a] + move @ v
            moved = np.abs(v_next - v).max(initial=0.0)
            v = np.maximum(v, v_next)
            if moved <= RELATIVE_TOLERANCE * value_scale(compiled):
                break
        values[a] = v
    return values


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _fast_informed(compiled: CompiledModel, q: Floats, tolerance: float) -> Floats:
    """Iterate α(a, s) = R(a, s) + γ Σ_o max_a' Σ_s' T(s, a, s') O(s', a, o) α(a', s') from above."""
    A = compiled.n_actions
    totals = np.empty(A)
    for _ in range(20_000):
        q_next = np.empty_like(q)
        moved = 0.0
        for s in range(compiled.class_of.size):
            c = compiled.class_of[s]
            for a in range(A):
                pair, value = c * A + a, 0.0
                for k in range(compiled.branch_first[pair], compiled.branch_first[pair + 1]):
                    d = compiled.branch_class[k]
                    offset = compiled.branch_at[k] - compiled.class_first[d]
                    totals[:] = 0.0
                    for e in range(compiled.t_first[a, s], compiled.t_first[a, s + 1]):
                        s_next = compiled.t_to[e]
                        if compiled.class_of[s_next] == d:
                            p = compiled.t_p[e] * compiled.o_p[offset + s_next]
                            for a_next in range(A):
                                totals[a_next] += p * q[a_next, s_next]
                    value += totals.max()
                q_next[a, s] = min(q[a, s], compiled.rewards[a, s] + compiled.discount * value)
                moved = max(moved, q[a, s] - q_next[a, s])
        q = q_next
        if moved <= tolerance:
            break
    return q


__all__ = ["Ints", "blind_policies", "fast_informed", "mdp_values", "transition_array", "value_scale"]
