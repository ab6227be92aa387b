"""The inner loops of SARSOP, compiled by numba and cached on disk.

Every belief of the search is a *node*. Its probabilities are dense over its class (:mod:`bgn.planning.compiled`);
equal beliefs share a node. A node becomes *sampled* when it is first backed up, which gives it a slot for its
actions; an action's children are only made when the search first needs their bounds. Alpha vectors and upper-bound
points are append-only lists, linked class by class from the newest to the oldest, and every node remembers the newest
it has seen, so that none is looked at twice for the same belief.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bgn.planning.compiled import CompiledModel

F = TypeVar("F", bound=Callable[..., Any])
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: An improvement of a bound smaller than this share of the value scale is not worth a vector or a point.
RELATIVE_IMPROVEMENT = 1e-9
#: Observations less likely than this are left out.
NEGLIGIBLE = 1e-13
#: Beliefs whose probabilities round to the same multiples of this are one node.
RESOLUTION = 2.0**-38
#: Steps a sampled path may have.
MAX_DEPTH = 200

NODES, BELIEFS, SLOTS, EDGES, ALPHAS, ALPHA_ENTRIES, POINTS, SUPPORTS, BACKUPS = range(9)


def kernel(function: F) -> F:
    """Compile for the machine; numba keeps the result beside the source."""
    compiled: F = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})(function)
    return compiled


class Search(NamedTuple):
    """Everything the search knows; arrays are longer than used, ``counts`` says how much is in use."""

    counts: Ints
    # Nodes.
    node_class: Ints
    node_at: Ints  # where the belief begins in `beliefs`
    node_hash: NDArray[np.uint64]
    node_corner: Floats  # Σ b(s) corner(s)
    node_start_upper: Floats  # the fast informed bound
    node_upper: Floats
    node_seen_point: Ints
    node_lower: Floats
    node_alpha: Ints  # the best alpha vector
    node_seen_alpha: Ints
    node_slot: Ints  # -1 until sampled
    node_support: Ints  # where its support begins in the lists of points, -1 before it has a point
    node_support_size: Ints
    beliefs: Floats
    table: Ints  # hash table of nodes, open addressing
    # Sampled nodes.
    slot_node: Ints
    slot_alive: NDArray[np.bool_]  # reachable through actions that may be optimal
    q_upper: Floats  # (slots, A)
    edge_first: Ints  # (slots, A), -1 until the action is expanded
    slot_bin: Ints  # (slots, 2) where its value is averaged: coarse and fine
    slot_binned: Floats  # the value it has contributed there; NaN: none
    edge_child: Ints
    edge_p: Floats
    # Lower bound.
    alpha_class: Ints
    alpha_at: Ints
    alpha_action: Ints
    alpha_node: Ints  # the belief it was made at, -1: a blind policy
    alpha_previous: Ints
    alpha_alive: NDArray[np.bool_]
    alphas: Floats
    alpha_newest: Ints  # (C,)
    # Upper bound.
    corner: Floats  # (L,)
    informed: Floats  # (A, L) fast informed bound
    point_node: Ints
    point_drop: Floats  # how far it lies below the plane through the corners
    point_previous: Ints
    point_alive: NDArray[np.bool_]
    node_point: Ints  # the last point of a node, -1: none
    point_newest: Ints  # (C,)
    support_state: Ints
    support_inverse: Floats  # 1 / b(s)
    # Scratch.
    forward: Floats  # (L,)
    backward: Floats  # (L,)
    default_alpha: Ints  # (C,) for observations that are impossible at the belief of a backup
    bin_sum: Floats  # (2, bins²)
    bin_count: Floats
    bin_error: Floats
    path: Ints  # (MAX_DEPTH,)
    scale: float  # largest |value|, for tolerances


@kernel
def belief_of(model: CompiledModel, search: Search, i: int) -> Floats:
    """Return a view of node i's belief over its class."""
    c = search.node_class[i]
    n = model.class_first[c + 1] - model.class_first[c]
    return search.beliefs[search.node_at[i] : search.node_at[i] + n]


@kernel
def dot(a: Floats, b: Floats) -> float:
    """Inner product of two contiguous arrays."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@kernel
def refresh_lower(model: CompiledModel, search: Search, i: int) -> float:
    """Bring node i's lower bound up to date with the alpha vectors added since; return it."""
    c = search.node_class[i]
    k = search.alpha_newest[c]
    seen = search.node_seen_alpha[i]
    if k > seen:
        b = belief_of(model, search, i)
        best, best_k = search.node_lower[i], search.node_alpha[i]
        search.node_seen_alpha[i] = k
        while k > seen:
            at = search.alpha_at[k]
            value = dot(b, search.alphas[at : at + b.size])
            if value > best:
                best, best_k = value, k
            k = search.alpha_previous[k]
        search.node_lower[i], search.node_alpha[i] = best, best_k
    return search.node_lower[i]


@kernel
def sawtooth(model: CompiledModel, search: Search, i: int, best: float, after: int, skip: int) -> float:
    """Lower ``best`` by the points newer than ``after`` but ``skip``'s; each spans a tooth with the corners."""
    b = belief_of(model, search, i)
    plane = search.node_corner[i]
    k = search.point_newest[search.node_class[i]]
    while k > after:
        j, drop = search.point_node[k], search.point_drop[k]
        needed = (plane - best) / drop
        if needed < 1.0 and search.point_alive[k] and j != skip:
            at, n = search.node_support[j], search.node_support_size[j]
            states, inverses = search.support_state[at : at + n], search.support_inverse[at : at + n]
            ratio = 1.0
            for m in range(n):
                ratio = min(ratio, b[states[m]] * inverses[m])
                if ratio <= needed:
                    break
            if ratio > needed:
                best = plane - ratio * drop
        k = search.point_previous[k]
    return best


@kernel
def refresh_upper(model: CompiledModel, search: Search, i: int) -> float:
    """Bring node i's upper bound up to date with the points added since; return it."""
    newest = search.point_newest[search.node_class[i]]
    if newest > search.node_seen_point[i]:
        search.node_upper[i] = sawtooth(
            model, search, i, search.node_upper[i], search.node_seen_point[i], i
        )
        search.node_seen_point[i] = newest
    return search.node_upper[i]


@kernel
def find_or_add(model: CompiledModel, search: Search, c: int) -> int:
    """Return the node of the belief that was written behind the last one; add it if it is new."""
    at = search.counts[BELIEFS]
    n = model.class_first[c + 1] - model.class_first[c]
    b = search.beliefs[at : at + n]
    key = np.uint64(c) + np.uint64(0x9E3779B97F4A7C15)
    for j in range(n):
        key ^= np.uint64(np.int64(b[j] * (1.0 / RESOLUTION) + 0.5))
        key *= np.uint64(0xBF58476D1CE4E5B9)
        key ^= key >> np.uint64(29)
    mask = np.uint64(search.table.size - 1)
    place = (key ^ (key >> np.uint64(32))) & mask
    while search.table[place] >= 0:
        i = search.table[place]
        if search.node_hash[i] == key and search.node_class[i] == c:
            return i
        place = (place + np.uint64(1)) & mask
    i = search.counts[NODES]
    search.counts[NODES] += 1
    search.counts[BELIEFS] += n
    search.table[place] = i
    search.node_class[i], search.node_at[i], search.node_hash[i] = c, at, key
    first = model.class_first[c]
    corner = dot(b, search.corner[first : first + n])
    informed = -np.inf
    for a in range(model.n_actions):
        informed = max(informed, dot(b, search.informed[a, first : first + n]))
    search.node_corner[i] = corner
    search.node_start_upper[i] = search.node_upper[i] = min(corner, informed)
    search.node_lower[i] = -np.inf
    search.node_alpha[i] = search.node_seen_alpha[i] = search.node_seen_point[i] = -1
    search.node_slot[i] = search.node_support[i] = search.node_point[i] = -1
    return i


@kernel
def rehash(search: Search, table: Ints) -> None:
    """Enter all nodes into a larger hash table."""
    mask = np.uint64(table.size - 1)
    for i in range(search.counts[NODES]):
        key = search.node_hash[i]
        place = (key ^ (key >> np.uint64(32))) & mask
        while table[place] >= 0:
            place = (place + np.uint64(1)) & mask
        table[place] = i


@kernel
def add_belief(model: CompiledModel, search: Search, c: int, belief: Floats) -> int:
    """Return the node of a belief given over class c."""
    at = search.counts[BELIEFS]
    search.beliefs[at : at + belief.size] = belief
    return find_or_add(model, search, c)


@kernel
def sample(model: CompiledModel, search: Search, i: int) -> int:
    """Give node i a slot for its actions if it has none; return the slot."""
    slot = search.node_slot[i]
    if slot < 0:
        slot = search.counts[SLOTS]
        search.counts[SLOTS] += 1
        search.node_slot[i], search.slot_node[slot] = slot, i
        search.slot_alive[slot] = True
        search.slot_binned[slot] = np.nan
        b = belief_of(model, search, i)
        first = model.class_first[search.node_class[i]]
        for a in range(model.n_actions):
            search.q_upper[slot, a] = dot(b, search.informed[a, first : first + b.size])
            search.edge_first[slot, a] = -1
    return slot


@kernel
def expand(model: CompiledModel, search: Search, i: int, a: int) -> int:
    """Make the children of node i under action a if they are not there; return the first edge."""
    slot = search.node_slot[i]
    if search.edge_first[slot, a] >= 0:
        return search.edge_first[slot, a]
    c = search.node_class[i]
    pair = c * model.n_actions + a
    b, first, w = belief_of(model, search, i), model.class_first[c], search.forward
    for k in range(model.successor_first[pair], model.successor_first[pair + 1]):
        d = model.successor[k]
        w[model.class_first[d] : model.class_first[d + 1]] = 0.0
    for j in range(b.size):
        if b[j] > 0.0:
            for e in range(model.t_first[a, first + j], model.t_first[a, first + j + 1]):
                w[model.t_to[e]] += b[j] * model.t_p[e]
    edge = search.counts[EDGES]
    search.edge_first[slot, a] = edge
    for k in range(model.branch_first[pair], model.branch_first[pair + 1]):
        d = model.branch_class[k]
        predicted = w[model.class_first[d] : model.class_first[d + 1]]
        n, at = predicted.size, model.branch_at[k]
        seen = model.o_p[at : at + n]
        p = dot(predicted, seen)
        child = -1
        if p > NEGLIGIBLE:
            end = search.counts[BELIEFS]
            b_next = search.beliefs[end : end + n]
            for j in range(n):
                b_next[j] = predicted[j] * seen[j] / p
            child = find_or_add(model, search, d)
        search.edge_child[search.counts[EDGES]] = child
        search.edge_p[search.counts[EDGES]] = p
        search.counts[EDGES] += 1
    return edge


@kernel
def reward_at(model: CompiledModel, search: Search, i: int, a: int) -> float:
    """Expected reward of action a at node i."""
    b = belief_of(model, search, i)
    first = model.class_first[search.node_class[i]]
    return dot(b, model.rewards[a, first : first + b.size])


@kernel
def n_branches(model: CompiledModel, search: Search, i: int, a: int) -> int:
    """Return how many edges an expanded action has."""
    pair = search.node_class[i] * model.n_actions + a
    return model.branch_first[pair + 1] - model.branch_first[pair]


@kernel
def update_upper(model: CompiledModel, search: Search, i: int) -> int:
    """Back up node i's upper bound; return its best action by that bound.

    Bounds only fall, so an action's old bound suffices unless it is the largest.
    """
    slot = sample(model, search, i)
    fresh = np.zeros(model.n_actions, dtype=np.bool_)
    q = search.q_upper[slot]
    best = 0
    while True:
        best = int(np.argmax(q))
        if fresh[best]:
            break
        edge = expand(model, search, i, best)
        value = 0.0
        for e in range(edge, edge + n_branches(model, search, i, best)):
            if search.edge_child[e] >= 0:
                value += search.edge_p[e] * refresh_upper(model, search, search.edge_child[e])
        q[best] = min(q[best], reward_at(model, search, i, best) + model.discount * value)
        fresh[best] = True
    refresh_upper(model, search, i)
    search.node_upper[i] = min(search.node_upper[i], q[best])
    return best


@kernel
def update_lower(model: CompiledModel, search: Search, i: int, found: Floats) -> int:
    """Find the action with the best lower bound one step ahead of node i; its value goes to ``found[0]``.

    Returns -1 if none beats the alpha vectors. Actions that cannot do better by their upper bound are passed over.
    """
    slot = search.node_slot[i]
    best = refresh_lower(model, search, i) + RELATIVE_IMPROVEMENT * search.scale
    best_a = -1
    for a in range(model.n_actions):
        if search.q_upper[slot, a] > best:
            edge = expand(model, search, i, a)
            value = 0.0
            for e in range(edge, edge + n_branches(model, search, i, a)):
                if search.edge_child[e] >= 0:
                    value += search.edge_p[e] * refresh_lower(model, search, search.edge_child[e])
            value = reward_at(model, search, i, a) + model.discount * value
            if value > best:
                best, best_a = value, a
    found[0] = best if best_a >= 0 else search.node_lower[i]
    return best_a


@kernel
def append_alpha(model: CompiledModel, search: Search, c: int, action: int, node: int) -> Floats:
    """Add an alpha vector to class c; return a view of its entries, to be filled in."""
    k, at = search.counts[ALPHAS], search.counts[ALPHA_ENTRIES]
    n = model.class_first[c + 1] - model.class_first[c]
    search.counts[ALPHAS] += 1
    search.counts[ALPHA_ENTRIES] += n
    search.alpha_class[k], search.alpha_at[k], search.alpha_action[k] = c, at, action
    search.alpha_node[k], search.alpha_alive[k] = node, True
    search.alpha_previous[k] = search.alpha_newest[c]
    search.alpha_newest[c] = k
    return search.alphas[at : at + n]


@kernel
def build_alpha(model: CompiledModel, search: Search, i: int, a: int) -> None:
    """Add the alpha vector of taking a at node i and then following the children's best vectors."""
    c = search.node_class[i]
    pair, first, w = c * model.n_actions + a, model.class_first[c], search.backward
    for k in range(model.successor_first[pair], model.successor_first[pair + 1]):
        d = model.successor[k]
        w[model.class_first[d] : model.class_first[d + 1]] = 0.0
    edge = search.edge_first[search.node_slot[i], a] - model.branch_first[pair]
    for k in range(model.branch_first[pair], model.branch_first[pair + 1]):
        d, child = model.branch_class[k], search.edge_child[edge + k]
        chosen = search.node_alpha[child] if child >= 0 else search.default_alpha[d]
        into = w[model.class_first[d] : model.class_first[d + 1]]
        seen = model.o_p[model.branch_at[k] : model.branch_at[k] + into.size]
        alpha = search.alphas[search.alpha_at[chosen] : search.alpha_at[chosen] + into.size]
        for j in range(into.size):
            into[j] += seen[j] * alpha[j]
    new = append_alpha(model, search, c, a, i)
    for j in range(new.size):
        total = 0.0
        for e in range(model.t_first[a, first + j], model.t_first[a, first + j + 1]):
            total += model.t_p[e] * w[model.t_to[e]]
        new[j] = model.rewards[a, first + j] + model.discount * total


@kernel
def log_point(model: CompiledModel, search: Search, i: int) -> None:
    """Let node i's upper bound stand as a point of the sawtooth, in place of its older one."""
    k, c = search.counts[POINTS], search.node_class[i]
    if search.node_support[i] < 0:
        b, at = belief_of(model, search, i), search.counts[SUPPORTS]
        order = np.argsort(-b)  # the most probable state first: there another belief's ratio tends to fail
        n = 0
        while n < b.size and b[order[n]] > 0.0:
            search.support_state[at + n] = order[n]
            search.support_inverse[at + n] = 1.0 / b[order[n]]
            n += 1
        search.node_support[i], search.node_support_size[i] = at, n
        search.counts[SUPPORTS] += n
    if search.node_point[i] >= 0:
        search.point_alive[search.node_point[i]] = False
    search.counts[POINTS] += 1
    search.point_node[k], search.point_alive[k] = i, True
    search.point_drop[k] = search.node_corner[i] - search.node_upper[i]
    search.point_previous[k] = search.point_newest[c]
    search.point_newest[c] = k
    search.node_point[i] = k


@kernel
def backup(model: CompiledModel, search: Search, i: int) -> None:
    """Back up both bounds of node i and pass on what improved."""
    update_upper(model, search, i)
    tolerance = RELATIVE_IMPROVEMENT * search.scale
    standing = search.node_start_upper[i]
    if search.node_point[i] >= 0:
        standing = search.node_corner[i] - search.point_drop[search.node_point[i]]
    drop = search.node_corner[i] - search.node_upper[i]
    if search.node_upper[i] < standing - tolerance and drop > tolerance:
        log_point(model, search, i)
    found = np.zeros(1)
    a = update_lower(model, search, i, found)
    if a >= 0:
        build_alpha(model, search, i, a)
        refresh_lower(model, search, i)
    search.counts[BACKUPS] += 1
    enter_bins(model, search, i)


@kernel
def bins_of(model: CompiledModel, search: Search, i: int, bins: int) -> int:
    """Return the cell of (initial upper bound, entropy) that node i falls into on a grid of bins x bins."""
    b = belief_of(model, search, i)
    entropy = 0.0
    for j in range(b.size):
        if b[j] > 0.0:
            entropy -= b[j] * np.log(b[j])
    spread = entropy / max(np.log(float(b.size)), 1e-9)
    height = 0.5 + 0.5 * search.node_start_upper[i] / search.scale
    row = min(max(int(height * bins), 0), bins - 1)
    return row * bins + min(max(int(spread * bins), 0), bins - 1)


@kernel
def enter_bins(model: CompiledModel, search: Search, i: int) -> None:
    """Keep the averages of the lower bounds of similar beliefs up to date with node i's."""
    slot, value = search.node_slot[i], search.node_lower[i]
    known = search.slot_binned[slot]
    for level in range(2):
        if np.isnan(known):
            cell = bins_of(model, search, i, 5 if level == 0 else 25)
            search.slot_bin[slot, level] = cell
            if search.bin_count[level, cell] > 0:
                mean = search.bin_sum[level, cell] / search.bin_count[level, cell]
                search.bin_error[level, cell] += (value - mean) ** 2
            search.bin_count[level, cell] += 1
            search.bin_sum[level, cell] += value
        else:
            search.bin_sum[level, search.slot_bin[slot, level]] += value - known
    search.slot_binned[slot] = value


@kernel
def predict(model: CompiledModel, search: Search, i: int) -> float:
    """Guess node i's optimal value: the average of similar beliefs, or its upper bound if there are none."""
    coarse, fine = bins_of(model, search, i, 5), bins_of(model, search, i, 25)
    if search.bin_count[0, coarse] == 0:
        return search.node_upper[i]
    level, cell = 0, coarse
    if search.bin_count[1, fine] > 0:
        error_coarse = search.bin_error[0, coarse] / search.bin_count[0, coarse]
        error_fine = search.bin_error[1, fine] / search.bin_count[1, fine]
        if error_fine <= error_coarse:
            level, cell = 1, fine
    return search.bin_sum[level, cell] / search.bin_count[level, cell]


@kernel
def trial(
    model: CompiledModel, search: Search, root: int, lower_target: float, upper_target: float, epsilon: float
) -> int:
    """Sample one path from a root towards beliefs that matter, then back it up; return its length.

    Kurniawati, Hsu, Lee (2008), Algorithm 3: a path ends where neither the predicted value would raise the root's
    lower bound nor the upper bound keeps the root's gap above the target.
    """
    i, depth, slack = root, 0, epsilon
    found = np.zeros(1)
    while depth < MAX_DEPTH:
        search.path[depth] = i
        depth += 1
        a = update_upper(model, search, i)
        update_lower(model, search, i, found)
        lower, upper = found[0], search.node_upper[i]
        if upper - lower <= RELATIVE_IMPROVEMENT * search.scale:
            break
        predicted = max(predict(model, search, i), lower)
        if predicted <= lower_target and upper <= max(upper_target, lower + slack):
            break
        lower_target, upper_target = max(lower_target, lower), max(upper_target, lower + slack)
        edge = expand(model, search, i, a)
        reward = reward_at(model, search, i, a)
        chosen, widest, below, above = -1, 0.0, 0.0, 0.0
        for e in range(edge, edge + n_branches(model, search, i, a)):
            child = search.edge_child[e]
            if child >= 0:
                low = search.edge_p[e] * refresh_lower(model, search, child)
                high = search.edge_p[e] * refresh_upper(model, search, child)
                below += low
                above += high
                if high - low > widest:
                    chosen, widest = e, high - low
        if chosen < 0:
            break
        i = search.edge_child[chosen]
        p = search.edge_p[chosen]
        slack /= model.discount
        lower_target = (lower_target - reward) / model.discount - (below - p * search.node_lower[i])
        upper_target = (upper_target - reward) / model.discount - (above - p * search.node_upper[i])
        lower_target /= p
        upper_target /= p
    for step in range(depth - 1, -1, -1):
        backup(model, search, search.path[step])
    return depth


@kernel
def mark_alive(model: CompiledModel, search: Search, roots: Ints, stack: Ints) -> None:
    """Find the sampled nodes that are still reachable through actions that may be optimal."""
    search.slot_alive[: search.counts[SLOTS]] = False
    depth = 0
    for root in roots:
        search.slot_alive[search.node_slot[root]] = True
        stack[depth] = root
        depth += 1
    while depth > 0:
        depth -= 1
        i = stack[depth]
        slot = search.node_slot[i]
        for a in range(model.n_actions):
            edge = search.edge_first[slot, a]
            if edge >= 0 and search.q_upper[slot, a] >= search.node_lower[i]:
                for e in range(edge, edge + n_branches(model, search, i, a)):
                    child = search.edge_child[e]
                    if child >= 0 and search.node_slot[child] >= 0:
                        if not search.slot_alive[search.node_slot[child]]:
                            search.slot_alive[search.node_slot[child]] = True
                            stack[depth] = child
                            depth += 1


@kernel
def may_matter(model: CompiledModel, search: Search, k: int, witnesses: Ints, delta: float) -> bool:
    """Tell whether alpha vector k comes within ``delta`` of being the best somewhere around a sampled belief.

    The distance is that from the belief to where k crosses the belief's best vector.
    """
    at = search.alpha_at[k]
    for i in witnesses:
        b = belief_of(model, search, i)
        alpha = search.alphas[at : at + b.size]
        gap = search.node_lower[i] - dot(b, alpha)
        best_at = search.alpha_at[search.node_alpha[i]]
        best = search.alphas[best_at : best_at + b.size]
        squares = 0.0
        for j in range(b.size):
            squares += (best[j] - alpha[j]) ** 2
        if gap * gap < delta * delta * squares:
            return True
    return False


@kernel
def prune_alphas(model: CompiledModel, search: Search, delta: float) -> None:
    """Drop the alpha vectors that are dominated around all sampled beliefs still alive."""
    n_classes = model.class_first.size - 1
    first = np.zeros(n_classes + 1, dtype=np.int64)
    for slot in range(search.counts[SLOTS]):
        if search.slot_alive[slot]:
            refresh_lower(model, search, search.slot_node[slot])
            first[search.node_class[search.slot_node[slot]] + 1] += 1
    first = np.cumsum(first)
    witnesses, fill = np.empty(first[-1], dtype=np.int64), first[:-1].copy()
    best = np.zeros(search.counts[ALPHAS], dtype=np.bool_)
    for slot in range(search.counts[SLOTS]):
        if search.slot_alive[slot]:
            i = search.slot_node[slot]
            c = search.node_class[i]
            witnesses[fill[c]] = i
            fill[c] += 1
            best[search.node_alpha[i]] = True
    search.alpha_newest[:] = -1
    for k in range(search.counts[ALPHAS]):
        c = search.alpha_class[k]
        near = witnesses[first[c] : first[c + 1]]
        search.alpha_alive[k] = best[k] or (
            search.alpha_alive[k] and may_matter(model, search, k, near, delta)
        )
        if search.alpha_alive[k]:
            search.alpha_previous[k] = search.alpha_newest[c]
            search.alpha_newest[c] = k


@kernel
def prune_points(model: CompiledModel, search: Search) -> None:
    """Drop the upper-bound points that the others imply."""
    tolerance = RELATIVE_IMPROVEMENT * search.scale
    for k in range(search.counts[POINTS]):
        if search.point_alive[k]:
            i = search.point_node[k]
            value = search.node_corner[i] - search.point_drop[k]
            others = sawtooth(model, search, i, search.node_corner[i], -1, i)
            search.point_alive[k] = others > value + tolerance
    search.point_newest[:] = -1
    for k in range(search.counts[POINTS]):
        if search.point_alive[k]:
            c = search.node_class[search.point_node[k]]
            search.point_previous[k] = search.point_newest[c]
            search.point_newest[c] = k
