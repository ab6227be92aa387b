"""Compiles a domain's sparse model into the padded device tensors that the batched simulator reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from bgn.domains.domain import Domain
from bgn.pomdp.model import MOMDP, POMDP

Ints = NDArray[np.int64]

#: A hidden state that more predecessors than this lead to is filtered by a dense product instead of a list.
MAX_LISTED_PREDECESSORS = 16


@dataclass(frozen=True, eq=False)
class _Entries:
    """The nonzero transitions of all pairs (s, a) that do not end the episode, sorted by pair."""

    s: Ints
    a: Ints
    s_next: Ints
    probability: NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Dynamics:
    """How states move. K is the largest number of successors; pair index sa = s * A + a."""

    successor: Tensor  # (S*A*K,) int64, padded with the last real successor
    cumulative: Tensor  # (S*A, K) float32; the last is 2, above any uniform variate
    reward: Tensor  # (S*A*K*W,) float32 with W = Ω if rewards depend on the observation, else 1
    ends: Tensor  # (S*A,) bool
    width: int  # K
    reward_width: int  # W


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensing:
    """What is observed on arriving in s' = (x', y'): a function of x', or drawn."""

    of_observed: Tensor | None  # (X,) int64
    cumulative: Tensor | None  # (A*S, Ω) float32, row a * S + s'
    likelihood: Tensor | None  # (A*X*Ω, Y) float32, row (a * X + x') * Ω + o


@dataclass(frozen=True, eq=False, kw_only=True)
class Filter:
    """Predecessor lists of the belief's prediction step; row xa = x * A + a, P the longest list.

    Without an observed part (X = 1) but with drawn observations, the weights carry the likelihood of the
    observation too, and have rows a * Ω + o.
    """

    source: Tensor | None  # (X*A, P*Y) int64 hidden predecessors; None where the hidden part never moves
    weight: Tensor  # (X*A or A*Ω, P*Y) float32 transition probabilities
    of_observation: bool  # the weights are likelihoods too
    arrives: Tensor | None  # (X*A, P*Y) int64 the x' this transition leads to; None if X = 1
    listed: int  # P
    hubs: Tensor | None  # (H,) int64 hidden states with too many predecessors for a list
    hub_weight: Tensor | None  # (X*A or A*Ω, H, Y) float32
    keep: Tensor | None  # (X, Y) float32: the elimination rule that replaces the filter, in a variant


@dataclass(frozen=True, eq=False, kw_only=True)
class Opening:
    """How episodes start."""

    states: Tensor  # (M,) int64: the support of the start distribution
    cumulative: Tensor  # (M,) float32
    prior: Tensor  # (X, Y) float32 belief on seeing x
    after_action: Tensor | None  # (A*Ω, Y) float32 belief after the hidden first action and its observation


@dataclass(frozen=True, eq=False, kw_only=True)
class WorldTables:
    """A domain as tensors on one device."""

    dynamics: Dynamics
    sensing: Sensing
    filter: Filter
    opening: Opening
    n_states: int
    n_actions: int
    n_observations: int
    n_observed: int
    n_hidden: int


def compile_tables(domain: Domain, device: torch.device, hidden_first_action: bool) -> WorldTables:
    """Lay out ``domain`` for :class:`bgn.simulation.table_world.TableWorld`."""
    model = domain.model
    entries = _entries(model.joint)
    sensing = _sensing(model, device)
    return WorldTables(
        dynamics=_dynamics(model.joint, entries, device),
        sensing=sensing,
        filter=_filter(domain, entries, sensing, device),
        opening=_opening(domain, entries, device, hidden_first_action),
        n_states=model.joint.n_states,
        n_actions=model.joint.n_actions,
        n_observations=model.joint.n_observations,
        n_observed=model.n_observed,
        n_hidden=model.n_hidden,
    )


def _entries(model: POMDP) -> _Entries:
    parts = []
    for a, T in enumerate(model.transitions):
        coo = T.tocoo()
        s, s_next = (np.asarray(c, dtype=np.int64) for c in coo.coords)
        live = (coo.data > 0) & ~model.reset[a, s]
        parts.append((s[live], np.full(live.sum(), a), s_next[live], coo.data[live]))
    s, action, s_next, p = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((s_next, action, s))
    return _Entries(s[order], action[order], s_next[order], p[order])


def _positions(keys: Ints, n_keys: int) -> tuple[Ints, Ints]:
    """Count up within runs of equal sorted keys; also return how often each key occurs."""
    counts = np.bincount(keys, minlength=n_keys)
    first = np.cumsum(counts) - counts
    return np.arange(len(keys)) - first[keys], counts


def _dynamics(model: POMDP, entries: _Entries, device: torch.device) -> Dynamics:
    S, A = model.n_states, model.n_actions
    pair = entries.s * A + entries.a
    position, counts = _positions(pair, S * A)
    K = max(1, int(counts.max(initial=1)))
    W = model.rewards.shape[3]
    successor = np.repeat(np.arange(S), A)[:, None].repeat(K, axis=1)  # ended pairs stay where they are
    successor[pair, position] = entries.s_next
    probability = np.zeros((S * A, K))
    probability[pair, position] = entries.probability
    cumulative = np.cumsum(probability, axis=1)
    last = np.maximum(counts - 1, 0)[:, None]
    cumulative[np.arange(K)[None, :] >= last] = 2.0  # so that rounding never leads into the padding
    R = model.rewards
    reward = np.zeros((S * A, K, W))
    # Axes that the rewards do not depend on have length 1: any index into them means 0.
    reward[pair, position] = R[
        np.minimum(entries.a, R.shape[0] - 1),
        np.minimum(entries.s, R.shape[1] - 1),
        np.minimum(entries.s_next, R.shape[2] - 1),
    ]
    ends = model.reset.T.reshape(-1)  # (S*A,)
    reward[ends] = model.expected_rewards.T.reshape(-1)[ends, None, None]
    return Dynamics(
        successor=_tensor(successor.reshape(-1), device),
        cumulative=_tensor(cumulative.astype(np.float32), device),
        reward=_tensor(reward.reshape(-1).astype(np.float32), device),
        ends=_tensor(ends, device),
        width=K,
        reward_width=W,
    )


def _sensing(model: MOMDP, device: torch.device) -> Sensing:
    joint, X, Y = model.joint, model.n_observed, model.n_hidden
    function = _observation_function(model)
    if function is not None:
        return Sensing(of_observed=_tensor(function, device), cumulative=None, likelihood=None)
    O = np.stack([o.toarray() for o in joint.observations])  # (A, S, Ω)
    A, S, W = O.shape
    cumulative = np.cumsum(O, axis=2)
    last = W - 1 - (O[:, :, ::-1] > 0).argmax(axis=2)  # the last possible observation of each row
    cumulative[np.arange(W)[None, None, :] >= last[:, :, None]] = 2.0
    likelihood = O.reshape(A, X, Y, W).transpose(0, 1, 3, 2)
    return Sensing(
        of_observed=None,
        cumulative=_tensor(cumulative.reshape(A * S, W).astype(np.float32), device),
        likelihood=_tensor(likelihood.reshape(A * X * W, Y).astype(np.float32), device),
    )


def _observation_function(model: MOMDP) -> Ints | None:
    """Return o(x') if every observation is a certain function of the observed part, else None."""
    joint, X, Y = model.joint, model.n_observed, model.n_hidden
    if X == 1:
        return None
    seen = []
    for O in joint.observations:
        if O.nnz != joint.n_states or not (O.data == 1).all():
            return None
        seen.append(np.asarray(O.indices, dtype=np.int64).reshape(X, Y))
    stacked = np.stack(seen)
    function = stacked[0, :, 0]
    return function if bool((stacked == function[None, :, None]).all()) else None


def _filter(domain: Domain, entries: _Entries, sensing: Sensing, device: torch.device) -> Filter:
    """Turn transitions s -> s' around, into lists of what leads to each y'.

    Prediction then is b'(y') = Σ_p weight[p, y'] b(source[p, y']), a gather and a sum along vectors, at a cost of
    the longest list times Y; the dense product would cost Y². A hub, such as the one state that every lost robot
    is put back to, would make all lists as long as its own; its few rows stay dense products.
    """
    model = domain.model
    X, Y, A = model.n_observed, model.n_hidden, model.joint.n_actions
    x, y = np.divmod(entries.s, Y)
    x_next, y_next = np.divmod(entries.s_next, Y)
    # One list per (x, a) and y'; sorting by that key puts a list's entries side by side, so that their place
    # within it can be counted up.
    row = x * A + entries.a
    key = row * Y + y_next
    order = np.lexsort((y, key))
    position, counts = _positions(key[order], X * A * Y)
    hubs = _hubs(counts.reshape(X * A, Y)) if X == 1 else np.zeros(0, dtype=np.int64)
    is_hub = np.zeros(Y, dtype=bool)
    is_hub[hubs] = True
    P = max(1, int(counts.reshape(X * A, Y)[:, ~is_hub].max(initial=1)))
    listed = ~is_hub[y_next[order]]
    at = (row[order][listed], position[listed], y_next[order][listed])
    # Shorter lists are padded with entries of weight 0, and of an x' that is never observed.
    source = np.tile(np.arange(Y), (X * A, P, 1))
    weight = np.zeros((X * A, P, Y), dtype=np.float32)
    arrives = np.full((X * A, P, Y), -1, dtype=np.int64)
    source[at] = y[order][listed]
    weight[at] = entries.probability[order][listed]
    arrives[at] = x_next[order][listed]
    # Where the hidden part never moves, every list is y' itself, and the belief need not be gathered.
    static = P == 1 and bool((source == np.arange(Y)).all())
    hub_weight = np.zeros((X * A, len(hubs), Y), dtype=np.float32)
    for h, hub in enumerate(hubs):
        into = y_next == hub
        np.add.at(hub_weight, (row[into], h, y[into]), entries.probability[into])
    # Without an observed part a row stands for an action alone. There is room to multiply the likelihood of each
    # observation in beforehand: one look-up and one product per step instead of two.
    of_observation = X == 1 and sensing.likelihood is not None
    if of_observation:
        assert sensing.likelihood is not None
        likelihood = sensing.likelihood.cpu().numpy().reshape(A, -1, 1, Y)
        weight = (weight[:, None] * likelihood).reshape(len(sensing.likelihood), P, Y)
        hub_weight = (hub_weight[:, None] * likelihood[:, :, 0, hubs, None]).reshape(
            len(weight), len(hubs), Y
        )
    keep = domain.elimination
    return Filter(
        source=None if static else _tensor(source.reshape(X * A, P * Y), device),
        weight=_tensor(weight.reshape(len(weight), P * Y), device),
        of_observation=of_observation,
        arrives=_tensor(arrives.reshape(X * A, P * Y), device) if X > 1 else None,
        listed=P,
        hubs=_tensor(hubs, device) if len(hubs) else None,
        hub_weight=_tensor(hub_weight, device) if len(hubs) else None,
        keep=None if keep is None else _tensor(keep.astype(np.float32), device),
    )


def _hubs(counts: Ints) -> Ints:
    """Return the hidden states that some action leads to from too many predecessors; counts is (A, Y)."""
    return np.flatnonzero((counts > MAX_LISTED_PREDECESSORS).any(axis=0))


def _opening(domain: Domain, entries: _Entries, device: torch.device, hidden_first_action: bool) -> Opening:
    model = domain.model
    X, Y = model.n_observed, model.n_hidden
    start = model.joint.start.reshape(X, Y)
    states = np.flatnonzero(model.joint.start)
    cumulative = np.cumsum(model.joint.start[states])
    cumulative[-1] = 2.0
    if domain.prior is not None:
        prior = domain.prior
    else:
        mass = start.sum(axis=1, keepdims=True)
        prior = np.divide(start, mass, out=np.full_like(start, 1 / Y), where=mass > 0)
    return Opening(
        states=_tensor(states, device),
        cumulative=_tensor(cumulative.astype(np.float32), device),
        prior=_tensor(prior.astype(np.float32), device),
        after_action=_tensor(_opened(model, prior, entries), device) if hidden_first_action else None,
    )


def _opened(model: MOMDP, prior: NDArray[np.float64], entries: _Entries) -> NDArray[np.float32]:
    """Belief after each (action, observation) pair taken from the start (Eq. 1); (A*Ω, Y)."""
    if model.n_observed != 1:
        raise ValueError("a hidden first action needs a model without an observed part")
    joint = model.joint
    predicted = np.zeros((joint.n_actions, joint.n_states))
    np.add.at(predicted, (entries.a, entries.s_next), entries.probability * prior[0, entries.s])
    O = np.stack([o.toarray() for o in joint.observations])  # (A, S, Ω)
    beliefs = (predicted[:, :, None] * O).transpose(0, 2, 1)  # (A, Ω, S)
    mass = beliefs.sum(axis=2, keepdims=True)
    beliefs = np.divide(beliefs, mass, out=np.zeros_like(beliefs), where=mass > 0)
    opened: NDArray[np.float32] = beliefs.reshape(-1, joint.n_states).astype(np.float32)
    return opened


def _tensor(array: NDArray[np.generic], device: torch.device) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).to(device)
