"""Simulated episodes of a policy, compiled by numba: exact beliefs, one random stream an episode."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from bgn.planning.alpha_vectors import AlphaVectors
from bgn.planning.compiled import CompiledModel, Ints, restrict
from bgn.planning.episodic import Convention, StartBelief
from bgn.pomdp.model import MOMDP, POMDP, Floats


class World(NamedTuple):
    """The model as it is simulated, all states included; rows of sparse arrays are cumulative."""

    start: Floats  # (S,) cumulative
    t_first: Ints  # (A, S + 1)
    t_to: Ints
    t_p: Floats
    o_first: Ints  # (A, S + 1)
    o_to: Ints
    o_p: Floats
    rewards: Floats  # 4-D, axes of length one do not matter
    reset: NDArray[np.bool_]  # (A, S)
    hidden_first_action: bool
    n_hidden: int
    n_observations: int
    root_of: Ints
    """Row of ``roots`` for what is seen before the first counted action."""
    root_class: Ints
    roots: Floats  # (roots, largest class)


class Rule(NamedTuple):
    """Alpha vectors cut to the classes: those of class c are rows first[c] to first[c + 1] - 1."""

    first: Ints  # (C + 1,)
    at: Ints  # (rows,) where a row's entries begin
    entries: Floats
    actions: Ints  # (rows,)


def lay_out(
    model: POMDP | MOMDP, compiled: CompiledModel, starts: tuple[StartBelief, ...], convention: Convention
) -> World:
    """Return the simulated world of a model under a convention."""
    joint, n_hidden = (model.joint, model.n_hidden) if isinstance(model, MOMDP) else (model, model.n_states)
    widest = int(np.diff(compiled.class_first).max(initial=1))
    root_of = np.full(max(start.seen for start in starts) + 1, -1, dtype=np.int64)
    root_class, roots = np.full(len(starts), -1, dtype=np.int64), np.zeros((len(starts), widest))
    for row, start in enumerate(starts):
        c, belief, _ = restrict(compiled, start.belief)
        root_of[start.seen], root_class[row] = row, c
        roots[row, : belief.size] = belief
    t_first, t_to, t_p = _cumulative(joint.transitions)
    o_first, o_to, o_p = _cumulative(joint.observations)
    return World(
        start=np.cumsum(joint.start),
        t_first=t_first,
        t_to=t_to,
        t_p=t_p,
        o_first=o_first,
        o_to=o_to,
        o_p=o_p,
        rewards=np.ascontiguousarray(joint.rewards, dtype=np.float64),
        reset=joint.reset,
        hidden_first_action=convention == "hidden-first-action",
        n_hidden=n_hidden,
        n_observations=joint.n_observations,
        root_of=root_of,
        root_class=root_class,
        roots=roots,
    )


def cut_to_classes(policy: AlphaVectors, compiled: CompiledModel) -> Rule:
    """Cut alpha vectors to each class, without those that a constant below another vector dominates."""
    first, at, entries, actions = [0], [], [], []
    size = 0
    for c in range(compiled.n_classes):
        states = compiled.states[compiled.class_first[c] : compiled.class_first[c + 1]]
        rows = policy.vectors[:, states]
        floor = rows.min(axis=1).max()
        best = int(rows.min(axis=1).argmax())
        kept = np.flatnonzero((rows.max(axis=1) > floor) | (np.arange(len(rows)) == best))
        entries.append(rows[kept].ravel())
        at.append(size + np.arange(kept.size) * states.size)
        actions.append(policy.actions[kept])
        size += kept.size * states.size
        first.append(first[-1] + kept.size)
    nothing = np.zeros(0, dtype=np.int64)
    return Rule(
        first=np.array(first, dtype=np.int64),
        at=np.concatenate([nothing, *at]).astype(np.int64),
        entries=np.concatenate([np.zeros(0), *entries]),
        actions=np.concatenate([nothing, *actions]).astype(np.int64),
    )


def no_rule(compiled: CompiledModel) -> Rule:
    """Return the rule of a policy that looks at nothing."""
    nothing = np.zeros(0, dtype=np.int64)
    return Rule(np.zeros(compiled.n_classes + 1, dtype=np.int64), nothing, np.zeros(0), nothing)


def _cumulative(arrays: tuple[sparse.csr_array, ...]) -> tuple[Ints, Ints, Floats]:
    """Stack sparse rows; each row's last cumulative entry is exactly one."""
    offsets = np.cumsum([0] + [array.nnz for array in arrays])
    first = np.stack([array.indptr.astype(np.int64) + at for array, at in zip(arrays, offsets, strict=False)])
    to = np.concatenate([array.indices for array in arrays]).astype(np.int64)
    p = np.concatenate([array.data for array in arrays]).astype(np.float64)
    total = np.cumsum(p)
    begins, ends = first[:, :-1].ravel(), first[:, 1:].ravel()
    before = np.concatenate([[0.0], total])[begins]
    rows = total - np.repeat(before, ends - begins)
    rows[ends - 1] = 1.0
    return first, to, rows


@njit(cache=True)
def _uniform(state: NDArray[np.uint64]) -> float:
    """Next number in [0, 1) of a SplitMix64 stream (Steele, Lea, Flood 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.float64((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@njit(cache=True)
def _draw(state: NDArray[np.uint64], first: int, last: int, to: Ints, cumulative: Floats) -> int:
    """Draw an entry of a sparse row."""
    u = _uniform(state)
    while first < last - 1 and cumulative[first] <= u:
        first += 1
    return int(to[first])


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _choose(compiled: CompiledModel, rule: Rule, c: int, belief: Floats) -> int:
    """Return the action of the best alpha vector; nothing matters any more where there is no live belief."""
    action, best = 0, -np.inf
    if c >= 0:
        n = compiled.class_first[c + 1] - compiled.class_first[c]
        for row in range(rule.first[c], rule.first[c + 1]):
            entries, value = rule.entries[rule.at[row] : rule.at[row] + n], 0.0
            for j in range(n):
                value += entries[j] * belief[j]
            if value > best:
                best, action = value, rule.actions[row]
    return action


@njit(cache=True)
def _filter(compiled: CompiledModel, c: int, belief: Floats, a: int, o: int, scratch: Floats) -> int:
    """Update a belief over class c in place (paper, Eq. 1), as the episode goes on; return its class."""
    if c < 0:
        return c
    pair, first = c * compiled.n_actions + a, compiled.class_first[c]
    for k in range(compiled.successor_first[pair], compiled.successor_first[pair + 1]):
        d = compiled.successor[k]
        scratch[compiled.class_first[d] : compiled.class_first[d + 1]] = 0.0
    for j in range(compiled.class_first[c + 1] - first):
        if belief[j] > 0.0:
            for e in range(compiled.t_first[a, first + j], compiled.t_first[a, first + j + 1]):
                scratch[compiled.t_to[e]] += belief[j] * compiled.t_p[e]
    for k in range(compiled.branch_first[pair], compiled.branch_first[pair + 1]):
        if compiled.branch_observation[k] == o:
            d = compiled.branch_class[k]
            first, total = compiled.class_first[d], 0.0
            for j in range(compiled.class_first[d + 1] - first):
                belief[j] = scratch[first + j] * compiled.o_p[compiled.branch_at[k] + j]
                total += belief[j]
            if total > 0.0:
                for j in range(compiled.class_first[d + 1] - first):
                    belief[j] /= total
                return int(d)
    return -1


@njit(cache=True)
def _open(world: World, rng: NDArray[np.uint64]) -> tuple[int, int]:
    """Draw the state in which the counted steps begin, and what was seen before."""
    s = min(int(np.searchsorted(world.start, _uniform(rng), side="right")), world.start.size - 1)
    if not world.hidden_first_action:
        return s, s // world.n_hidden
    n_actions = world.reset.shape[0]
    a = int(_uniform(rng) * n_actions)
    s = _draw(rng, world.t_first[a, s], world.t_first[a, s + 1], world.t_to, world.t_p)
    o = _draw(rng, world.o_first[a, s], world.o_first[a, s + 1], world.o_to, world.o_p)
    return s, a * world.n_observations + o


@njit(cache=True)
def simulate(
    world: World,
    compiled: CompiledModel,
    rule: Rule,
    random: bool,
    seed: int,
    limit: int,
    discount: float,
    n: int,
) -> Floats:
    """Run ``n`` episodes; return (n, 3): discounted return, undiscounted return, counted steps."""
    results = np.zeros((n, 3))
    belief, scratch = np.empty(world.roots.shape[1]), np.zeros(compiled.class_of.size)
    rng = np.empty(1, dtype=np.uint64)
    n_actions, R = world.reset.shape[0], world.rewards
    A, S, S_next, O = R.shape
    for episode in range(n):
        rng[0] = np.uint64(seed) * np.uint64(0xD1342543DE82EF95) + np.uint64(episode)
        rng[0] = np.uint64(_uniform(rng) * 2.0**53) ^ (np.uint64(episode) << np.uint64(20))
        s, seen = _open(world, rng)
        root = world.root_of[seen]
        c = world.root_class[root]
        belief[:] = world.roots[root]
        weight = 1.0
        for step in range(limit):
            a = int(_uniform(rng) * n_actions) if random else _choose(compiled, rule, c, belief)
            s_next = _draw(rng, world.t_first[a, s], world.t_first[a, s + 1], world.t_to, world.t_p)
            o = _draw(rng, world.o_first[a, s_next], world.o_first[a, s_next + 1], world.o_to, world.o_p)
            reward = R[min(a, A - 1), min(s, S - 1), min(s_next, S_next - 1), min(o, O - 1)]
            results[episode, 0] += weight * reward
            results[episode, 1] += reward
            results[episode, 2] = step + 1
            if world.reset[a, s]:
                break
            if not random:
                c = _filter(compiled, c, belief, a, o, scratch)
            s, weight = s_next, weight * discount
    return results
