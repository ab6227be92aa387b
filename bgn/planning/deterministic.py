"""Exact optimum of mixed-observability models with deterministic moves and a hidden part that stays put.

There a belief is the start distribution restricted to a set of hidden parts, which every step either leaves
or splits by the next x (and by whether the episode ended). The reachable (x, set) pairs are enumerated once
and dynamic programming over that graph gives the value, and from it the policy's exact success and episode
lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bgn.planning.sarsop import PlanningError
from bgn.pomdp.model import MOMDP, POMDP, Floats

Ints = NDArray[np.int64]
Words = NDArray[np.uint64]

#: Values are iterated until none moves by more than this.
TOLERANCE = 1e-13
#: Actions closer than this in value tie; the first is taken.
TIE = 1e-11
#: More belief sets than this are not attempted (about 1 GB).
MAX_BELIEFS = 5_000_000


@dataclass(frozen=True, kw_only=True)
class Optimum:
    """The best that can be done, exactly."""

    value: float
    """V* at the start, discounted as the model says."""
    mean_return: float
    """Undiscounted return of the optimal policy: the success rate where success earns 1."""
    return_sd: float
    """Standard deviation of a single episode's undiscounted return."""
    mean_length: float
    """Steps an episode takes."""
    max_length: int
    beliefs: int
    """Reachable (x, set) pairs."""


class _Tables(NamedTuple):
    """The model by (x, a, y)."""

    x_next: Ints
    ends: NDArray[np.bool_]
    rewards: Floats
    weights: Floats  # (Y,) start probabilities up to a factor for each x
    discount: float


class _Graph(NamedTuple):
    """Reachable belief sets, breadth first."""

    x: Ints  # (N,)
    members: Words  # (N, words) bit y of the set
    weight: Floats  # (N,) total weight of the set
    rewards: Floats  # (N, A) expected
    ending: Floats  # (N, A) probability that the episode ends
    edge_first: Ints  # (N A + 1,)
    edge_child: Ints
    edge_p: Floats


def solve_deterministic(model: MOMDP) -> Optimum:
    """Return the optimum of a deterministic model.

    Raises
    ------
    PlanningError
        A move is random or changes the hidden part, the start does not factor, rewards come before the end,
        or there are too many beliefs.
    """
    tables = _tables(model)
    start = model.joint.start.reshape(model.n_observed, model.n_hidden)
    roots = np.flatnonzero(start.sum(axis=1) > 0)
    graph = _enumerate(tables, roots, start > 0)
    values = _values(graph, tables.discount)
    chosen = _greedy(graph, values, tables.discount)
    p = start[roots].sum(axis=1)  # the first nodes are the roots
    mean, square, length, longest = _follow(graph, tables, chosen, p)
    return Optimum(
        value=float(p @ values[: roots.size]),
        mean_return=mean,
        return_sd=float(np.sqrt(max(square - mean**2, 0.0))),
        mean_length=length,
        max_length=longest,
        beliefs=int(graph.x.size),
    )


def _tables(model: MOMDP) -> _Tables:
    """Read the model by (x, a, y) and check that it is of the kind this module solves."""
    joint, X, Y = model.joint, model.n_observed, model.n_hidden
    shape = (X, joint.n_actions, Y)
    x_next, ends, rewards = np.empty(shape, dtype=np.int64), np.empty(shape, dtype=np.bool_), np.empty(shape)
    for a in range(joint.n_actions):
        ends[:, a] = joint.reset[a].reshape(X, Y)
        rewards[:, a] = joint.expected_rewards[a].reshape(X, Y)
        x_next[:, a] = _successors(joint, a, Y).reshape(X, Y)
    if joint.discount >= 1:
        raise PlanningError("the exact optimum needs a discount below 1; this model's is 1")
    if (rewards[~ends] != 0).any():
        raise PlanningError("the exact optimum is for models that only reward the step that ends an episode")
    return _Tables(x_next, ends, rewards, _weights(joint.start.reshape(X, Y)), joint.discount)


def _successors(joint: POMDP, a: int, n_hidden: int) -> Ints:
    """Return each state's next x, shape (S,); its own where the episode ends."""
    moves, s = joint.transitions[a], np.arange(joint.n_states)
    goes_on = ~joint.reset[a]
    if (np.diff(moves.indptr)[goes_on] != 1).any():
        raise PlanningError(f"action {joint.action_names[a]!r} has random outcomes: no exact optimum")
    target = s.copy()
    target[goes_on] = moves.indices[moves.indptr[:-1][goes_on]]
    if (target % n_hidden != s % n_hidden)[goes_on].any():
        raise PlanningError(f"action {joint.action_names[a]!r} changes the hidden part: no exact optimum")
    return np.asarray(target // n_hidden)


def _weights(start: Floats) -> Floats:
    """Factor the start into c(x) w(y) on its support; return w, shape (Y,)."""
    w = start.max(axis=0)
    ratios = np.divide(start, w, out=np.zeros_like(start), where=w > 0)
    scale = ratios.max(axis=1, keepdims=True)
    if not np.allclose(np.where(start > 0, ratios, scale), scale, rtol=1e-9, atol=0):
        raise PlanningError("the start distribution of y given x depends on x beyond its support")
    return np.asarray(w)


def _enumerate(tables: _Tables, roots: Ints, supports: NDArray[np.bool_]) -> _Graph:
    """List every (x, set) that some policy may reach, and how actions lead from one to the others."""
    n_words = -(-tables.weights.size // 64)
    n_actions = tables.x_next.shape[1]
    capacity, edge_capacity = 1 << 14, 1 << 17
    while True:
        members = np.zeros((capacity, n_words), dtype=np.uint64)
        x = np.zeros(capacity, dtype=np.int64)
        x[: roots.size] = roots
        for row, root in enumerate(roots):
            for y in np.flatnonzero(supports[root]):
                members[row, y // 64] |= np.uint64(1) << np.uint64(y % 64)
        edge_first = np.zeros(capacity * n_actions + 1, dtype=np.int64)
        edge_child, edge_p = np.zeros(edge_capacity, dtype=np.int64), np.zeros(edge_capacity)
        rewards, ending = np.zeros((capacity, n_actions)), np.zeros((capacity, n_actions))
        weight = np.zeros(capacity)
        graph = _Graph(x, members, weight, rewards, ending, edge_first, edge_child, edge_p)
        n, edges = _grow(tables, graph, roots.size)
        if n < capacity and edges < edge_capacity:
            return _Graph(
                x[:n],
                members[:n],
                weight[:n],
                rewards[:n],
                ending[:n],
                edge_first[: n * n_actions + 1],
                edge_child[:edges],
                edge_p[:edges],
            )
        if capacity > MAX_BELIEFS:
            raise PlanningError(f"more than {MAX_BELIEFS:,} reachable beliefs: no exact optimum")
        capacity, edge_capacity = capacity * 4, edge_capacity * 4


@njit(cache=True, error_model="numpy")
def _grow(tables: _Tables, graph: _Graph, n_roots: int) -> tuple[int, int]:
    """Fill in the graph from its roots; returns (nodes, edges), at the capacity if it was too small."""
    capacity, n_words = graph.members.shape
    n_actions, n_hidden = tables.x_next.shape[1], tables.weights.size
    table = np.full(4 * capacity, -1, dtype=np.int64)  # open addressing: four places a node keep probes short
    n, edges, i = n_roots, 0, 0
    branch_x, branch_set = np.empty(n_hidden, dtype=np.int64), np.empty((n_hidden, n_words), dtype=np.uint64)
    branch_w, inside = np.empty(n_hidden), np.empty(n_hidden, dtype=np.int64)
    for i in range(n_roots):
        table[_find(graph, table, graph.x[i], graph.members[i], i)] = i
    # Breadth first: node i is spread out while its children are appended behind node n - 1.
    i = 0
    while i < n:
        # A belief is its support: what of the hidden part is still possible, each as likely as at the start.
        total, size = 0.0, 0
        for y in range(n_hidden):
            if graph.members[i, y >> 6] >> np.uint64(y & 63) & np.uint64(1):
                total += tables.weights[y]
                inside[size] = y
                size += 1
        graph.weight[i] = total
        for a in range(n_actions):
            # An action splits the support by the x that it shows next; where it ends the episode nothing follows.
            branches = 0
            for y in inside[:size]:
                p = tables.weights[y] / total
                if tables.ends[graph.x[i], a, y]:
                    graph.rewards[i, a] += p * tables.rewards[graph.x[i], a, y]
                    graph.ending[i, a] += p
                    continue
                x_next, k = tables.x_next[graph.x[i], a, y], 0
                while k < branches and branch_x[k] != x_next:
                    k += 1
                if k == branches:
                    branch_x[k], branch_w[k], branch_set[k] = x_next, 0.0, np.uint64(0)
                    branches += 1
                branch_w[k] += p
                branch_set[k, y >> 6] |= np.uint64(1) << np.uint64(y & 63)
            # Compiled code cannot enlarge the arrays: the caller does, and begins anew.
            if n + branches >= capacity or edges + branches >= graph.edge_child.size:
                return capacity, graph.edge_child.size
            for k in range(branches):
                place = _find(graph, table, branch_x[k], branch_set[k], n)
                if table[place] < 0:
                    table[place], graph.x[n] = n, branch_x[k]
                    graph.members[n] = branch_set[k]
                    n += 1
                graph.edge_child[edges], graph.edge_p[edges] = table[place], branch_w[k]
                edges += 1
            graph.edge_first[i * n_actions + a + 1] = edges
        i += 1
    return n, edges


@njit(cache=True, error_model="numpy")
def _find(graph: _Graph, table: Ints, x: int, members: Words, n: int) -> int:
    """Return where (x, set) is, or belongs, in the hash table."""
    key = np.uint64(x) + np.uint64(0x9E3779B97F4A7C15)
    for word in members:
        key = (key ^ word) * np.uint64(0xBF58476D1CE4E5B9)
        key ^= key >> np.uint64(29)
    place = np.int64((key ^ (key >> np.uint64(32))) % np.uint64(table.size))
    while table[place] >= 0:
        i = table[place]
        same = graph.x[i] == x
        for word in range(members.size):
            same = same and graph.members[i, word] == members[word]
        if same:
            break
        place = (place + 1) % table.size
    return int(place)


@njit(cache=True, error_model="numpy")
def _action_value(graph: _Graph, v: Floats, discount: float, i: int, a: int) -> float:
    value = 0.0
    at = i * graph.rewards.shape[1] + a
    for e in range(graph.edge_first[at], graph.edge_first[at + 1]):
        value += graph.edge_p[e] * v[graph.edge_child[e]]
    return float(graph.rewards[i, a] + discount * value)


@njit(cache=True, error_model="numpy")
def _values(graph: _Graph, discount: float) -> Floats:
    """Iterate V(x, set) up from below zero rewards, later beliefs first, until it stands still."""
    n, n_actions = graph.rewards.shape
    lowest = min(0.0, graph.rewards.min() / (1 - discount))
    v = np.full(n, lowest)
    moved = 1.0
    while moved > TOLERANCE:
        moved = 0.0
        for i in range(n - 1, -1, -1):
            best = -np.inf
            for a in range(n_actions):
                best = max(best, _action_value(graph, v, discount, i, a))
            moved = max(moved, abs(best - v[i]))
            v[i] = best
    return v


@njit(cache=True, error_model="numpy")
def _greedy(graph: _Graph, v: Floats, discount: float) -> Ints:
    """Return the first action of each belief whose value is the best up to rounding."""
    chosen = np.zeros(graph.x.size, dtype=np.int64)
    for i in range(chosen.size):
        while _action_value(graph, v, discount, i, chosen[i]) < v[i] - TIE:
            chosen[i] += 1
    return chosen


def _follow(graph: _Graph, tables: _Tables, chosen: Ints, p: Floats) -> tuple[float, float, float, int]:
    """Follow the policy; return E[return], E[return²], E[length] and the longest episode."""
    N, A = graph.rewards.shape
    reached = np.zeros(N)
    reached[: p.size] = p
    mean = square = length = 0.0
    for step in range(1, N + 2):
        at = np.flatnonzero(reached)
        a = chosen[at]
        mean += float(reached[at] @ graph.rewards[at, a])
        square += float(reached[at] @ _end_squares(graph, tables, at, a))
        length += step * float(reached[at] @ graph.ending[at, a])
        first, last = graph.edge_first[at * A + a], graph.edge_first[at * A + a + 1]
        counts = last - first
        edges = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        mass = np.repeat(reached[at], counts) * graph.edge_p[edges]
        reached = np.asarray(np.bincount(graph.edge_child[edges], weights=mass, minlength=N))
        if not reached.any():
            return mean, square, length, step
    raise PlanningError("the optimal policy never ends an episode")


def _end_squares(graph: _Graph, tables: _Tables, at: Ints, a: Ints) -> Floats:
    """E[reward²] of action a at each of some beliefs."""
    x, n_hidden = graph.x[at], tables.weights.size
    bits = np.unpackbits(graph.members[at].view(np.uint8), axis=1, bitorder="little")[:, :n_hidden]
    p = bits * tables.weights / graph.weight[at, None]
    return np.asarray((p * np.where(tables.ends[x, a], tables.rewards[x, a], 0.0) ** 2).sum(axis=1))
