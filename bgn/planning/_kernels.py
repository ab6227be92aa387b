"""The inner loops of SARSOP, compiled by numba and cached on disk.

Every belief of the search is a *node*, dense over its class (:mod:`bgn.planning.compiled`); equal beliefs
share a node. A node becomes *sampled* when it is first backed up: then its belief is kept and it gets a slot
for its actions. The beliefs of the many nodes that are only somebody's children are worked out again whenever
their bounds are refreshed, which is cheaper than the memory they would take. An action's children are only
made when the search first needs their bounds. Alpha vectors and upper-bound points are append-only lists,
linked class by class from the newest to the oldest, and every node remembers the newest it has seen, so that
none is looked at twice for the same belief.

All kernels that call each other are in this one file because numba's cache only notices changes in the file
of the function that is called from Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bgn.planning.compiled import CompiledModel

F = TypeVar("F", bound=Callable[..., Any])
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Records = Any
"""A structured array; numba reads its fields as attributes of its elements."""

#: An improvement of a bound smaller than this share of the value scale is not worth a vector or a point.
RELATIVE_IMPROVEMENT = 1e-9
#: Observations less likely than this are left out.
NEGLIGIBLE = 1e-13
#: Beliefs whose probabilities round to the same multiples of this are one node.
RESOLUTION = 2.0**-38
#: Cells a side of the grids over (initial upper bound, entropy) on which values of similar beliefs are
#: averaged.
BINS = (5, 25)

NODE = np.dtype(
    [
        ("belief_class", "i4"),
        ("slot", "i4"),  # -1 until sampled
        ("alpha", "i4"),  # the best alpha vector
        ("seen_alpha", "i4"),  # the newest it was compared with
        ("point", "i4"),  # its last upper-bound point, -1: none
        ("seen_point", "i4"),  # the newest it was compared with
        ("at", "i8"),  # where its belief begins in `beliefs`, -1 until sampled
        ("hash", "u8"),
        ("corner", "f8"),  # Σ b(s) corner(s)
        ("start_upper", "f8"),  # the bound that needs no search
        ("upper", "f8"),
        ("lower", "f8"),
    ],
    align=True,
)
SLOT = np.dtype(
    [
        ("node", "i4"),
        ("alive", "b1"),  # reachable through actions that may be optimal
        ("support_at", "i8"),  # where its support begins in the lists of supports, -1 before it has a point
        ("support_size", "i4"),
        ("coarse", "i4"),  # the cells where its value is averaged
        ("fine", "i4"),
        ("binned", "f8"),  # the value it has contributed there; NaN: none
        ("trial", "i8"),  # the last that passed here
    ],
    align=True,
)
EDGE = np.dtype([("child", "i4"), ("p", "f8")], align=True)
ALPHA = np.dtype(
    [
        ("belief_class", "i4"),
        ("action", "i4"),
        ("previous", "i4"),
        ("alive", "b1"),
        ("at", "i8"),
        ("next_at", "i8"),  # where the vectors it goes on with begin, one a branch; -1: it repeats itself
    ],
    align=True,
)
POINT = np.dtype(
    # drop: how far the point lies below the plane through the corners
    [
        ("node", "i4"),
        ("previous", "i4"),
        ("support_at", "i8"),  # where its states begin in the lists of supports
        ("support_size", "i4"),
        ("alive", "b1"),
        ("drop", "f8"),
    ],
    align=True,
)

(*(NODES, BELIEFS, SLOTS, EDGES, ALPHAS, ALPHA_ENTRIES, ALPHA_NEXT, POINTS, SUPPORTS, BACKUPS, TRIALS),) = (
    range(11)
)


class Search(NamedTuple):
    """Everything the search knows; arrays are longer than used, ``counts`` says how much is in use."""

    counts: Ints
    scale: float  # largest |value|, for tolerances
    nodes: Records
    beliefs: Floats
    table: NDArray[np.int32]  # hash table of nodes, open addressing
    slots: Records
    q_upper: Floats  # (slots, A)
    edge_first: Ints  # (slots, A), -1 until the action is expanded
    edges: Records
    alphas: Records
    alpha_entries: Floats
    alpha_next: NDArray[np.int32]
    alpha_newest: Ints  # (C,)
    default_alpha: Ints  # (C,) for observations that are impossible at the belief of a backup
    corner: Floats  # (L,) upper bounds of certain beliefs
    informed: Floats  # (A, L) fast informed bound
    points: Records
    point_newest: Ints  # (C,)
    support_state: NDArray[np.int32]
    support_inverse: Floats  # 1 / b(s)
    bin_sums: Floats  # (2, cells, 3): sum, count, squared errors of predictions
    path: Ints  # (longest path,) the nodes of the last trial
    predicted: Floats  # (L,) scratch: the belief after an action, before its observation
    backward: Floats  # (L,) scratch
    conditioned: Floats  # (largest class,) scratch: the belief after the observation


def kernel(function: F) -> F:
    """Compile for the machine; numba keeps the result beside the source."""
    return cast("F", njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})(function))


@kernel
def dot(a: Floats, b: Floats) -> float:
    """Inner product of two contiguous arrays."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@kernel
def belief_of(model: CompiledModel, search: Search, i: int) -> Floats:
    """Return a view of the belief of a sampled node."""
    c, at = search.nodes[i].belief_class, search.nodes[i].at
    return search.beliefs[at : at + model.class_first[c + 1] - model.class_first[c]]


@kernel
def predict_states(model: CompiledModel, search: Search, c: int, b: Floats, a: int) -> None:
    """Write the (unnormalised) belief after action a into ``predicted``, in the classes it may lead to."""
    pair, first, w = c * model.n_actions + a, model.class_first[c], search.predicted
    for k in range(model.successor_first[pair], model.successor_first[pair + 1]):
        d = model.successor[k]
        for j in range(model.class_first[d], model.class_first[d + 1]):
            w[j] = 0.0
    for j in range(b.size):
        if b[j] > 0.0:
            for e in range(model.t_first[a, first + j], model.t_first[a, first + j + 1]):
                w[model.t_to[e]] += b[j] * model.t_p[e]


@kernel
def condition(model: CompiledModel, search: Search, k: int) -> float:
    """Condition ``predicted`` on branch k; returns its probability, the belief is in ``conditioned``."""
    d, at = model.branch_class[k], model.branch_at[k]
    predicted = search.predicted[model.class_first[d] : model.class_first[d + 1]]
    n = predicted.size
    seen, b = model.o_p[at : at + n], search.conditioned[:n]
    p = 0.0
    for j in range(n):
        b[j] = predicted[j] * seen[j]
        p += b[j]
    inverse = 1.0 / p if p > NEGLIGIBLE else 0.0
    for j in range(n):
        b[j] *= inverse
    return p


@kernel
def hash_of(c: int, b: Floats) -> np.uint64:
    """Hash a belief over class c, rounded so that rounding errors of its history do not matter."""
    key = np.uint64(c) + np.uint64(0x9E3779B97F4A7C15)
    for j in range(b.size):
        key ^= np.uint64(np.int64(b[j] * (1.0 / RESOLUTION) + 0.5))
        key *= np.uint64(0xBF58476D1CE4E5B9)
        key ^= key >> np.uint64(29)
    return key ^ (key >> np.uint64(32))


@kernel
def find_or_add(model: CompiledModel, search: Search, c: int, b: Floats) -> int:
    """Return the node of a belief over class c; add it if it is new."""
    key, mask = hash_of(c, b), np.uint64(search.table.size - 1)
    place = key & mask
    while search.table[place] >= 0:
        i = search.table[place]
        if search.nodes[i].hash == key:
            return int(i)
        place = (place + np.uint64(1)) & mask
    i = search.counts[NODES]
    search.counts[NODES] += 1
    search.table[place] = i
    first = model.class_first[c]
    node = search.nodes[i]
    node.belief_class, node.hash, node.at = c, key, -1
    node.corner = dot(b, search.corner[first : first + b.size])
    informed = -np.inf
    for a in range(model.n_actions):
        informed = max(informed, dot(b, search.informed[a, first : first + b.size]))
    node.upper = node.start_upper = min(node.corner, informed)
    node.lower = -np.inf
    node.slot = node.point = node.alpha = node.seen_alpha = node.seen_point = -1
    return int(i)


@kernel
def rehash(search: Search, table: NDArray[np.int32]) -> None:
    """Enter all nodes into a larger hash table."""
    mask = np.uint64(table.size - 1)
    for i in range(search.counts[NODES]):
        place = search.nodes[i].hash & mask
        while table[place] >= 0:
            place = (place + np.uint64(1)) & mask
        table[place] = i


@kernel
def add_sampled(model: CompiledModel, search: Search, c: int, b: Floats) -> int:
    """Return the node of a belief over class c, with room for its actions and its belief kept."""
    i = find_or_add(model, search, c, b)
    node = search.nodes[i]
    if node.slot < 0:
        s = search.counts[SLOTS]
        search.counts[SLOTS] += 1
        node.slot, node.at = s, search.counts[BELIEFS]
        search.counts[BELIEFS] += b.size
        for j in range(b.size):
            search.beliefs[node.at + j] = b[j]
        slot = search.slots[s]
        slot.node, slot.alive, slot.support_at, slot.binned, slot.trial = i, True, -1, np.nan, 0
        first = model.class_first[c]
        for a in range(model.n_actions):
            search.q_upper[s, a] = dot(b, search.informed[a, first : first + b.size])
            search.edge_first[s, a] = -1
    return i


@kernel
def refresh_lower(search: Search, i: int, b: Floats) -> None:
    """Bring node i's lower bound up to date with the alpha vectors added since."""
    node = search.nodes[i]
    k, seen = search.alpha_newest[node.belief_class], node.seen_alpha
    node.seen_alpha = max(seen, k)
    while k > seen:
        at = search.alphas[k].at
        value = dot(b, search.alpha_entries[at : at + b.size])
        if value > node.lower:
            node.lower, node.alpha = value, k
        k = search.alphas[k].previous


@kernel
def sawtooth(search: Search, i: int, b: Floats, best: float, after: int) -> float:
    """Lower ``best`` by the other nodes' points newer than ``after``; each spans a tooth with the corners."""
    plane = search.nodes[i].corner
    k = search.point_newest[search.nodes[i].belief_class]
    while k > after:
        point = search.points[k]
        needed = (plane - best) / point.drop
        if needed < 1.0 and point.alive and point.node != i:
            at, n = point.support_at, point.support_size
            states, inverses = search.support_state[at : at + n], search.support_inverse[at : at + n]
            ratio = 1.0
            for m in range(n):
                ratio = min(ratio, b[states[m]] * inverses[m])
                if ratio <= needed:
                    break
            if ratio > needed:
                best = plane - ratio * point.drop
        k = point.previous
    return best


@kernel
def refresh_upper(search: Search, i: int, b: Floats) -> None:
    """Bring node i's upper bound up to date with the points added since."""
    node = search.nodes[i]
    newest = search.point_newest[node.belief_class]
    if newest > node.seen_point:
        node.upper = sawtooth(search, i, b, node.upper, node.seen_point)
        node.seen_point = newest


@kernel
def edges_of(model: CompiledModel, search: Search, i: int, a: int) -> tuple[int, int]:
    """Return the range of edges of an expanded action."""
    pair, first = (
        search.nodes[i].belief_class * model.n_actions + a,
        search.edge_first[search.nodes[i].slot, a],
    )
    return first, first + model.branch_first[pair + 1] - model.branch_first[pair]


@kernel
def expand(model: CompiledModel, search: Search, i: int, a: int) -> None:
    """Make the children of a sampled node under action a if they are not there."""
    node = search.nodes[i]
    if search.edge_first[node.slot, a] >= 0:
        return
    c = node.belief_class
    pair = c * model.n_actions + a
    predict_states(model, search, c, belief_of(model, search, i), a)
    search.edge_first[node.slot, a] = search.counts[EDGES]
    for k in range(model.branch_first[pair], model.branch_first[pair + 1]):
        edge = search.edges[search.counts[EDGES]]
        search.counts[EDGES] += 1
        d = model.branch_class[k]
        n = model.class_first[d + 1] - model.class_first[d]
        edge.p, edge.child = condition(model, search, k), -1
        if edge.p > NEGLIGIBLE:
            edge.child = find_or_add(model, search, d, search.conditioned[:n])


@kernel
def refresh_children(model: CompiledModel, search: Search, i: int, a: int, upper: bool) -> None:
    """Bring the upper or the lower bounds of node i's children under a (made if need be) up to date."""
    expand(model, search, i, a)
    c, predicted = search.nodes[i].belief_class, False
    first, last = edges_of(model, search, i, a)
    branch = model.branch_first[c * model.n_actions + a]
    for e in range(first, last):
        j = search.edges[e].child
        if j >= 0:
            child = search.nodes[j]
            d = child.belief_class
            fresh = child.seen_alpha >= search.alpha_newest[d]
            if upper:
                fresh = child.seen_point >= search.point_newest[d]
            if not fresh:
                b = search.conditioned[: model.class_first[d + 1] - model.class_first[d]]
                if child.at >= 0:
                    b = belief_of(model, search, j)
                else:
                    if not predicted:
                        predict_states(model, search, c, belief_of(model, search, i), a)
                        predicted = True
                    condition(model, search, branch + e - first)
                if upper:
                    refresh_upper(search, j, b)
                else:
                    refresh_lower(search, j, b)


@kernel
def look_ahead(model: CompiledModel, search: Search, i: int, a: int, upper: bool) -> float:
    """Bound node i's value one step ahead of action a: R(b, a) + γ Σ_o p(o) bound(child)."""
    refresh_children(model, search, i, a, upper)
    first, last = edges_of(model, search, i, a)
    value = 0.0
    for e in range(first, last):
        edge = search.edges[e]
        if edge.child >= 0:
            value += edge.p * (search.nodes[edge.child].upper if upper else search.nodes[edge.child].lower)
    return reward_at(model, search, i, a) + model.discount * value


@kernel
def reward_at(model: CompiledModel, search: Search, i: int, a: int) -> float:
    """Return the expected reward of action a at node i."""
    b, first = belief_of(model, search, i), model.class_first[search.nodes[i].belief_class]
    return dot(b, model.rewards[a, first : first + b.size])


@kernel
def update_upper(model: CompiledModel, search: Search, i: int) -> int:
    """Back up node i's upper bound; return its best action by that bound.

    Bounds only fall, so an action's old bound suffices unless it is the largest.
    """
    node = search.nodes[i]
    fresh = np.zeros(model.n_actions, dtype=np.bool_)
    q = search.q_upper[node.slot]
    best = int(np.argmax(q))
    while not fresh[best]:
        q[best] = min(q[best], look_ahead(model, search, i, best, True))
        fresh[best] = True
        best = int(np.argmax(q))
    refresh_upper(search, i, belief_of(model, search, i))
    node.upper = min(node.upper, q[best])
    return best


@kernel
def update_lower(model: CompiledModel, search: Search, i: int) -> tuple[int, float]:
    """Return the action with the best lower bound one step ahead of node i, and that bound.

    The action is -1 if none beats the alpha vectors. Those that cannot by their upper bound are passed over.
    """
    node = search.nodes[i]
    refresh_lower(search, i, belief_of(model, search, i))
    best, best_a = node.lower + RELATIVE_IMPROVEMENT * search.scale, -1
    for a in range(model.n_actions):
        if search.q_upper[node.slot, a] > best:
            value = look_ahead(model, search, i, a, False)
            if value > best:
                best, best_a = value, a
    return best_a, best if best_a >= 0 else node.lower


@kernel
def append_alpha(model: CompiledModel, search: Search, c: int, action: int) -> Floats:
    """Add an alpha vector to class c; return a view of its entries, to be filled in."""
    k, n = search.counts[ALPHAS], model.class_first[c + 1] - model.class_first[c]
    search.counts[ALPHAS] += 1
    alpha = search.alphas[k]
    alpha.belief_class, alpha.action, alpha.alive, alpha.next_at = c, action, True, -1
    alpha.at, alpha.previous = search.counts[ALPHA_ENTRIES], search.alpha_newest[c]
    search.counts[ALPHA_ENTRIES] += n
    search.alpha_newest[c] = k
    return search.alpha_entries[alpha.at : alpha.at + n]


@kernel
def add_blind_policies(model: CompiledModel, search: Search, blind: Floats) -> None:
    """Begin the alpha vectors with the values of always taking one action, shape (A, L), class by class."""
    for c in range(model.class_first.size - 1):
        first, last, best = model.class_first[c], model.class_first[c + 1], -np.inf
        for a in range(model.n_actions):
            total, new = 0.0, append_alpha(model, search, c, a)
            for j in range(last - first):
                new[j] = blind[a, first + j]
                total += new[j]
            if total > best:
                best, search.default_alpha[c] = total, search.counts[ALPHAS] - 1


@kernel
def build_alpha(model: CompiledModel, search: Search, i: int, a: int) -> None:
    """Add the alpha vector of taking a at node i and then following the children's best vectors."""
    c = search.nodes[i].belief_class
    pair, first, w = c * model.n_actions + a, model.class_first[c], search.backward
    for k in range(model.successor_first[pair], model.successor_first[pair + 1]):
        d = model.successor[k]
        for j in range(model.class_first[d], model.class_first[d + 1]):
            w[j] = 0.0
    edge = search.edge_first[search.nodes[i].slot, a] - model.branch_first[pair]
    next_at = search.counts[ALPHA_NEXT]
    for k in range(model.branch_first[pair], model.branch_first[pair + 1]):
        d, child = model.branch_class[k], search.edges[edge + k].child
        chosen = search.nodes[child].alpha if child >= 0 else search.default_alpha[d]
        search.alpha_next[search.counts[ALPHA_NEXT]] = chosen
        search.counts[ALPHA_NEXT] += 1
        into = w[model.class_first[d] : model.class_first[d + 1]]
        seen = model.o_p[model.branch_at[k] : model.branch_at[k] + into.size]
        at = search.alphas[chosen].at
        alpha = search.alpha_entries[at : at + into.size]
        for j in range(into.size):
            into[j] += seen[j] * alpha[j]
    new = append_alpha(model, search, c, a)
    search.alphas[search.counts[ALPHAS] - 1].next_at = next_at
    for j in range(new.size):
        total = 0.0
        for e in range(model.t_first[a, first + j], model.t_first[a, first + j + 1]):
            total += model.t_p[e] * w[model.t_to[e]]
        new[j] = model.rewards[a, first + j] + model.discount * total


@kernel
def log_point(model: CompiledModel, search: Search, i: int) -> None:
    """Let node i's upper bound stand as a point of the sawtooth, in place of its older one."""
    k, node = search.counts[POINTS], search.nodes[i]
    slot = search.slots[node.slot]
    if slot.support_at < 0:
        b, at = belief_of(model, search, i), search.counts[SUPPORTS]
        n = 0
        for j in range(b.size):
            if b[j] > 0.0:
                # The most probable state first: there another belief's ratio tends to fail.
                m = at + n
                while m > at and search.support_inverse[m - 1] * b[j] > 1.0:
                    search.support_state[m] = search.support_state[m - 1]
                    search.support_inverse[m] = search.support_inverse[m - 1]
                    m -= 1
                search.support_state[m], search.support_inverse[m] = j, 1.0 / b[j]
                n += 1
        slot.support_at, slot.support_size = at, n
        search.counts[SUPPORTS] += n
    if node.point >= 0:
        search.points[node.point].alive = False
    search.counts[POINTS] += 1
    point = search.points[k]
    point.node, point.alive, point.drop = i, True, node.corner - node.upper
    point.support_at, point.support_size = slot.support_at, slot.support_size
    point.previous = search.point_newest[node.belief_class]
    search.point_newest[node.belief_class] = k
    node.point = k


@kernel
def backup(model: CompiledModel, search: Search, i: int) -> None:
    """Back up both bounds of a sampled node and pass on what improved."""
    update_upper(model, search, i)
    node = search.nodes[i]
    tolerance = RELATIVE_IMPROVEMENT * search.scale
    standing = node.corner - search.points[node.point].drop if node.point >= 0 else node.start_upper
    if node.upper < standing - tolerance and node.corner - node.upper > tolerance:
        log_point(model, search, i)
    a, _ = update_lower(model, search, i)
    if a >= 0:
        build_alpha(model, search, i, a)
        refresh_lower(search, i, belief_of(model, search, i))
    search.counts[BACKUPS] += 1
    enter_bins(model, search, i)


@kernel
def bin_of(search: Search, i: int, b: Floats, bins: int) -> int:
    """Return the cell of (initial upper bound, entropy) that a belief falls into on a grid of bins x bins."""
    entropy = 0.0
    for j in range(b.size):
        if b[j] > 0.0:
            entropy -= b[j] * np.log(b[j])
    spread = entropy / max(np.log(float(b.size)), 1e-9)
    height = 0.5 + 0.5 * search.nodes[i].start_upper / search.scale
    row = min(max(int(height * bins), 0), bins - 1)
    return row * bins + min(max(int(spread * bins), 0), bins - 1)


@kernel
def enter_bins(model: CompiledModel, search: Search, i: int) -> None:
    """Keep the averages of similar beliefs' lower bounds up to date with node i's."""
    slot, value = search.slots[search.nodes[i].slot], search.nodes[i].lower
    if np.isnan(slot.binned):
        b = belief_of(model, search, i)
        slot.coarse, slot.fine = bin_of(search, i, b, BINS[0]), bin_of(search, i, b, BINS[1])
        for level, cell in ((0, slot.coarse), (1, slot.fine)):
            sums = search.bin_sums[level, cell]
            if sums[1] > 0:
                sums[2] += (value - sums[0] / sums[1]) ** 2
            sums[1] += 1
            sums[0] += value
    else:
        search.bin_sums[0, slot.coarse, 0] += value - slot.binned
        search.bin_sums[1, slot.fine, 0] += value - slot.binned
    slot.binned = value


@kernel
def predict_value(model: CompiledModel, search: Search, i: int) -> float:
    """Guess a sampled node's optimal value: the average of similar beliefs, else its upper bound."""
    b = belief_of(model, search, i)
    coarse = search.bin_sums[0, bin_of(search, i, b, BINS[0])]
    fine = search.bin_sums[1, bin_of(search, i, b, BINS[1])]
    if coarse[1] == 0:
        return float(search.nodes[i].upper)
    if fine[1] > 0 and fine[2] / fine[1] <= coarse[2] / coarse[1]:
        return float(fine[0] / fine[1])
    return float(coarse[0] / coarse[1])


@kernel
def trial(
    model: CompiledModel,
    search: Search,
    root: int,
    lower_target: float,
    upper_target: float,
    epsilon: float,
    spread: bool,
) -> int:
    """Sample one path from a root towards beliefs that matter, then back it up; return its length.

    Kurniawati, Hsu, Lee (2008), Algorithm 3: a path ends where neither the predicted value would raise the
    root's lower bound nor the upper bound keeps the root's gap above the target. The next belief is the child
    whose gap exceeds its target the most; with ``spread``, one that the path has not passed before if any
    exceeds it.
    """
    i, depth, slack = root, 0, epsilon
    search.counts[TRIALS] += 1
    while depth < search.path.size:
        search.path[depth] = i
        search.slots[search.nodes[i].slot].trial = search.counts[TRIALS]
        depth += 1
        a = update_upper(model, search, i)
        _, lower = update_lower(model, search, i)
        upper = search.nodes[i].upper
        if upper - lower <= RELATIVE_IMPROVEMENT * search.scale:
            break
        predicted = max(predict_value(model, search, i), lower)
        if predicted <= lower_target and upper <= max(upper_target, lower + slack):
            break
        lower_target, upper_target = max(lower_target, lower), max(upper_target, lower + slack)
        slack /= model.discount
        refresh_children(model, search, i, a, True)
        refresh_children(model, search, i, a, False)
        first, last = edges_of(model, search, i, a)
        below, above, chosen, widest, passed, widest_passed = 0.0, 0.0, -1, 0.0, -1, 0.0
        for e in range(first, last):
            edge = search.edges[e]
            if edge.child >= 0:
                child = search.nodes[edge.child]
                below += edge.p * child.lower
                above += edge.p * child.upper
                excess = edge.p * (child.upper - child.lower - slack)
                if spread and child.slot >= 0 and search.slots[child.slot].trial == search.counts[TRIALS]:
                    if excess > widest_passed:
                        passed, widest_passed = e, excess
                elif excess > widest:
                    chosen, widest = e, excess
        if chosen < 0:
            chosen = passed
        if chosen < 0:
            break
        edge = search.edges[chosen]
        child, reward = search.nodes[edge.child], reward_at(model, search, i, a)
        lower_target = ((lower_target - reward) / model.discount - below) / edge.p + child.lower
        upper_target = ((upper_target - reward) / model.discount - above) / edge.p + child.upper
        c = search.nodes[i].belief_class
        predict_states(model, search, c, belief_of(model, search, i), a)
        condition(model, search, model.branch_first[c * model.n_actions + a] + chosen - first)
        d = child.belief_class
        i = add_sampled(
            model, search, d, search.conditioned[: model.class_first[d + 1] - model.class_first[d]]
        )
    for step in range(depth - 1, -1, -1):
        backup(model, search, search.path[step])
    return depth


@kernel
def mark_alive(model: CompiledModel, search: Search, roots: Ints) -> None:
    """Find the sampled nodes that are still reachable through actions that may be optimal."""
    slots = search.slots[: search.counts[SLOTS]]
    for s in range(slots.size):
        slots[s].alive = False
    stack, depth = np.empty(slots.size, dtype=np.int64), 0
    tolerance = (
        RELATIVE_IMPROVEMENT * search.scale
    )  # where the bounds meet, rounding must not cut the best action
    for root in roots:
        if not slots[search.nodes[root].slot].alive:
            slots[search.nodes[root].slot].alive = True
            stack[depth] = root
            depth += 1
    while depth > 0:
        depth -= 1
        i = stack[depth]
        s = search.nodes[i].slot
        for a in range(model.n_actions):
            if search.edge_first[s, a] >= 0 and search.q_upper[s, a] >= search.nodes[i].lower - tolerance:
                first, last = edges_of(model, search, i, a)
                for e in range(first, last):
                    child = search.edges[e].child
                    if (
                        child >= 0
                        and search.nodes[child].slot >= 0
                        and not slots[search.nodes[child].slot].alive
                    ):
                        slots[search.nodes[child].slot].alive = True
                        stack[depth] = child
                        depth += 1


@kernel
def may_matter(model: CompiledModel, search: Search, k: int, witnesses: Ints, delta: float) -> bool:
    """Tell whether alpha vector k comes within ``delta`` of being the best somewhere around a sampled belief.

    The distance is that from the belief to where k crosses the belief's best vector.
    """
    at = search.alphas[k].at
    for i in witnesses:
        b, node = belief_of(model, search, i), search.nodes[i]
        alpha = search.alpha_entries[at : at + b.size]
        best_at = search.alphas[node.alpha].at
        best = search.alpha_entries[best_at : best_at + b.size]
        gap, squares = node.lower - dot(b, alpha), 0.0
        for j in range(b.size):
            squares += (best[j] - alpha[j]) ** 2
        if gap * gap < delta * delta * squares:
            return True
    return False


@kernel
def prune_alphas(model: CompiledModel, search: Search, delta: float) -> None:
    """Drop the alpha vectors that are dominated around all sampled beliefs still alive."""
    n_slots = search.counts[SLOTS]
    first = np.zeros(model.class_first.size, dtype=np.int64)
    for s in range(n_slots):
        if search.slots[s].alive:
            i = search.slots[s].node
            refresh_lower(search, i, belief_of(model, search, i))
            first[search.nodes[i].belief_class + 1] += 1
    for c in range(1, first.size):
        first[c] += first[c - 1]
    witnesses, fill = np.empty(first[-1], dtype=np.int64), first[:-1].copy()
    best = np.zeros(search.counts[ALPHAS], dtype=np.bool_)
    for s in range(n_slots):
        if search.slots[s].alive:
            i = search.slots[s].node
            c = search.nodes[i].belief_class
            witnesses[fill[c]] = i
            fill[c] += 1
            best[search.nodes[i].alpha] = True
    for c in range(search.alpha_newest.size):
        search.alpha_newest[c] = -1
    for k in range(search.counts[ALPHAS]):
        alpha = search.alphas[k]
        c = alpha.belief_class
        if best[k]:
            alpha.alive = True
        elif alpha.alive:
            alpha.alive = may_matter(model, search, k, witnesses[first[c] : first[c + 1]], delta)
        if alpha.alive:
            alpha.previous = search.alpha_newest[c]
            search.alpha_newest[c] = k


@kernel
def prune_points(model: CompiledModel, search: Search) -> None:
    """Drop the upper-bound points that the others imply."""
    tolerance = RELATIVE_IMPROVEMENT * search.scale
    for k in range(search.counts[POINTS]):
        point = search.points[k]
        if point.alive:
            node = search.nodes[point.node]
            enough = node.corner - point.drop + tolerance
            others = sawtooth(search, point.node, belief_of(model, search, point.node), enough, -1)
            point.alive = others >= enough
    for c in range(search.point_newest.size):
        search.point_newest[c] = -1
    for k in range(search.counts[POINTS]):
        point = search.points[k]
        if point.alive:
            c = search.nodes[point.node].belief_class
            point.previous = search.point_newest[c]
            search.point_newest[c] = k


@kernel
def close_over(model: CompiledModel, search: Search, kept: NDArray[np.bool_]) -> None:
    """Add the vectors that kept ones go on with, so that acting on the set is worth what it promises."""
    for k in range(search.counts[ALPHAS] - 1, -1, -1):  # a vector only goes on with older ones
        alpha = search.alphas[k]
        if kept[k] and alpha.next_at >= 0:
            pair = alpha.belief_class * model.n_actions + alpha.action
            for n in range(model.branch_first[pair + 1] - model.branch_first[pair]):
                kept[search.alpha_next[alpha.next_at + n]] = True
        elif kept[k]:  # a blind policy goes on with itself; those come first, class by class
            for c in range(model.class_first.size - 1):
                kept[c * model.n_actions + alpha.action] = True
