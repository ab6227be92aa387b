"""A model laid out for planning kernels: live states only, grouped into classes that beliefs never straddle.

Two reductions, both exact:

- States from which nothing more can be earned are dropped. Their value is zero under every policy, so the
  probability of being there is left out of every belief; transitions then sum to at most one.
- States fall into *classes* such that every reachable belief lives inside one class: the finest partition
that
  contains each start belief's support and is closed under (action, observation). In RockSample a class is a
  cell of the map (the rover's position is always known), in a mixed-observability model a value of x; Hallway
  is a single class. Alpha vectors and beliefs then only need the entries of one class (the idea of MOMDP
  planning, Ong et al. 2010, found in the tables instead of declared).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from bgn.planning.episodic import StartBelief, continuing_transitions, worthless_states
from bgn.pomdp.model import POMDP, Floats

Ints = NDArray[np.int64]


class CompiledModel(NamedTuple):
    """Arrays for the kernels. L live states, C classes, A actions; live states are sorted by class."""

    discount: float
    n_actions: int
    states: Ints
    """(L,) index of each live state in the original model."""
    class_first: Ints
    """(C + 1,) class c holds the live states class_first[c] to class_first[c + 1] - 1."""
    class_of: Ints
    """(L,)"""
    t_first: Ints
    """(A, L + 1) where each row of each action's transitions begins in t_to and t_p."""
    t_to: Ints
    t_p: Floats
    rewards: Floats
    """(A, L) expected rewards R(a, s)."""
    branch_first: Ints
    """(C A + 1,) the outcomes of action a in class c begin at branch_first[c A + a]; one for each observation
    and class that may follow."""
    branch_observation: Ints
    branch_class: Ints
    branch_at: Ints
    """Where the branch's column of observation probabilities, one a state of its class, begins in o_p."""
    o_p: Floats
    successor_first: Ints
    """(C A + 1,) the classes that action a may lead to from class c begin at successor_first[c A + a]."""
    successor: Ints

    @property
    def n_live(self) -> int:
        """L."""
        return int(self.states.size)

    @property
    def n_classes(self) -> int:
        """C."""
        return int(self.class_first.size) - 1


def compile_model(model: POMDP, starts: tuple[StartBelief, ...]) -> CompiledModel:
    """Lay out what is reachable from the start beliefs."""
    live = _reachable_live(model, starts)
    moves = [_within(move, live) for move in continuing_transitions(model)]
    emissions = [sparse.csr_array(model.observations[a][live]) for a in range(model.n_actions)]
    labels = _classes(moves, emissions, [start.belief[live] > 0 for start in starts])
    order = np.argsort(labels, kind="stable")
    moves = [sparse.csr_array(move[order][:, order]) for move in moves]
    emissions = [sparse.csr_array(emission[order]) for emission in emissions]
    labels = labels[order]
    n_classes = int(labels[-1]) + 1 if labels.size else 0
    first = np.searchsorted(labels, np.arange(n_classes + 1)).astype(np.int64)
    nonzeros = np.cumsum([0] + [move.nnz for move in moves])
    return CompiledModel(
        float(model.discount),
        model.n_actions,
        live[order].astype(np.int64),
        first,
        labels,
        np.stack([move.indptr.astype(np.int64) + at for move, at in zip(moves, nonzeros[:-1], strict=True)]),
        np.concatenate([move.indices for move in moves]).astype(np.int64),
        np.concatenate([move.data for move in moves]).astype(np.float64),
        np.ascontiguousarray(model.expected_rewards[:, live[order]]),
        *_branches(moves, emissions, labels, first),
    )


def restrict(compiled: CompiledModel, belief: Floats) -> tuple[int, Floats, float]:
    """Return (class, probabilities of its states, mass) of a belief over the original states.

    The probabilities are normalised over the live states; ``mass`` is their sum before. A belief without live
    mass has class -1.
    """
    live = belief[compiled.states]
    mass = float(live.sum())
    if mass <= 0:
        return -1, np.zeros(0), 0.0
    c = int(compiled.class_of[int(live.argmax())])
    inside = live[compiled.class_first[c] : compiled.class_first[c + 1]]
    return c, inside / inside.sum(), mass


def _reachable_live(model: POMDP, starts: tuple[StartBelief, ...]) -> Ints:
    """Return the indices of the states that are reachable before the episode is over."""
    worthless = worthless_states(model)
    reached = np.any([start.belief > 0 for start in starts], axis=0) & ~worthless
    moves = continuing_transitions(model)
    while True:
        weights = reached.astype(np.float64)
        grown = reached | (np.any([weights @ move > 0 for move in moves], axis=0) & ~worthless)
        if (grown == reached).all():
            return np.flatnonzero(reached)
        reached = grown


def _within(move: sparse.csr_array, live: Ints) -> sparse.csr_array:
    """Cut transitions to the live states."""
    block = sparse.csr_array(move[live][:, live])
    block.eliminate_zeros()
    block.sort_indices()
    return block


def _classes(
    moves: list[sparse.csr_array], emissions: list[sparse.csr_array], supports: list[NDArray[np.bool_]]
) -> Ints:
    """Return the class of each live state: the finest partition closed under action and observation."""
    n_live = moves[0].shape[0]
    steps = [_emitted_steps(move, emission) for move, emission in zip(moves, emissions, strict=True)]
    n_observations = emissions[0].shape[1]
    labels = np.arange(n_live, dtype=np.int64)
    groups = [np.flatnonzero(support) for support in supports]
    ties = [np.stack([g[:-1], g[1:]]) for g in groups if g.size > 1]
    while True:
        # Everything that one (class, action, observation) leads to shares a class: tie it to the first such
        # state.
        for source, target, seen in steps:
            key = labels[source] * n_observations + seen
            _, representative, inverse = np.unique(key, return_index=True, return_inverse=True)
            ties.append(np.stack([target, target[representative][inverse]]))
        i, j = np.hstack([np.zeros((2, 0), dtype=np.int64), *ties])
        graph = sparse.csr_array((np.ones(i.size), (i, j)), shape=(n_live, n_live))
        n_classes, merged = csgraph.connected_components(graph, directed=False)
        if n_classes == np.unique(labels).size:
            return merged.astype(np.int64)
        labels = merged.astype(np.int64)
        ties = [np.stack([np.arange(n_live), np.unique(labels, return_index=True)[1][labels]])]


def _emitted_steps(move: sparse.csr_array, emission: sparse.csr_array) -> tuple[Ints, Ints, Ints]:
    """Return (s, s', o) of every possible step under one action."""
    coo = move.tocoo()
    source, target = coo.coords
    per_state = np.diff(emission.indptr)
    repeats = per_state[target]
    flat = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    seen = emission.indices[np.repeat(emission.indptr[target], repeats) + flat]
    return (
        np.repeat(source, repeats).astype(np.int64),
        np.repeat(target, repeats).astype(np.int64),
        seen.astype(np.int64),
    )


def _branches(
    moves: list[sparse.csr_array], emissions: list[sparse.csr_array], labels: Ints, first: Ints
) -> tuple[Ints, Ints, Ints, Ints, Floats, Ints, Ints]:
    """List, for each (class, action), what may follow: the fields from ``branch_first`` to ``successor``."""
    n_classes, n_actions = first.size - 1, len(moves)
    found = []
    for a, (move, emission) in enumerate(zip(moves, emissions, strict=True)):
        source, target, seen = _emitted_steps(move, emission)
        found.append(np.stack([labels[source] * n_actions + a, labels[target], seen]))
    table = np.unique(np.hstack(found), axis=1)  # (3, branches), sorted by (class, action)
    pairs, successors = table[0], np.unique(table[:2], axis=1)
    sizes = np.diff(first)[table[1]]
    dense = [emission.toarray() for emission in emissions]
    columns = [dense[key % n_actions][first[d] : first[d + 1], o] for key, d, o in table.T]
    bounds = np.arange(n_classes * n_actions + 1)
    return (
        np.searchsorted(pairs, bounds).astype(np.int64),
        table[2].copy(),
        table[1].copy(),
        (np.cumsum(sizes) - sizes).astype(np.int64),
        np.concatenate([np.zeros(0), *columns]),
        np.searchsorted(successors[0], bounds).astype(np.int64),
        successors[1].copy(),
    )
