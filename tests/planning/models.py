"""Small models whose values are known."""

import math

import numpy as np
from scipy import sparse

from bgn.domains.domain import Domain
from bgn.pomdp.model import MOMDP, POMDP


def pomdp(T, O, R, *, start, discount, reset=None, actions=None):
    """Build a model from dense arrays T[a, s, s'], O[a, s', o], R(a, s)."""
    T, O, R = (np.asarray(x, dtype=float) for x in (T, O, R))
    A, S, _ = T.shape
    return POMDP(
        transitions=tuple(sparse.csr_array(t) for t in T),
        observations=tuple(sparse.csr_array(o) for o in O),
        rewards=R[:, :, None, None],
        start=np.asarray(start, dtype=float),
        reset=np.zeros((A, S), dtype=bool) if reset is None else np.asarray(reset),
        discount=discount,
        state_names=tuple(f"s{i}" for i in range(S)),
        action_names=tuple(actions or (f"a{i}" for i in range(A))),
        observation_names=tuple(f"o{i}" for i in range(O.shape[2])),
    )


def tiger(discount=0.95):
    """Kaelbling, Littman, Cassandra (1998): listen, or open one of two doors."""
    stay, fresh = np.eye(2), np.full((2, 2), 0.5)
    hear = [[0.85, 0.15], [0.15, 0.85]]
    return pomdp(
        [stay, fresh, fresh],
        [hear, fresh, fresh],
        [[-1, -1], [-100, 10], [10, -100]],
        start=[0.5, 0.5],
        discount=discount,
        actions=("listen", "open-left", "open-right"),
    )


def guess(cost=0.1, discount=0.9, accuracy=0.8):
    """Listen for a fee, or guess which of two states it is: that ends the episode and earns 1 if right."""
    stay = np.eye(2)
    hear = [[accuracy, 1 - accuracy], [1 - accuracy, accuracy]]
    nothing = np.full((2, 2), 0.5)
    return pomdp(
        [stay, stay, stay],
        [hear, nothing, nothing],
        [[-cost, -cost], [1, 0], [0, 1]],
        start=[0.5, 0.5],
        discount=discount,
        reset=[[False, False], [True, True], [True, True]],
        actions=("listen", "left", "right"),
    )


def random_model(seed, *, n_states=4, n_actions=2, n_observations=2, discount=0.5, resets=False):
    """Return a model with random sparse dynamics; some (state, action) pairs end the episode if wanted."""
    random = np.random.default_rng(seed)

    def rows(n, m):
        p = random.dirichlet(np.ones(m), size=n)
        p[random.random((n, m)) < 0.3] = 0
        p[np.arange(n), random.integers(m, size=n)] += 0.1
        return p / p.sum(axis=1, keepdims=True)

    return pomdp(
        [rows(n_states, n_states) for _ in range(n_actions)],
        [rows(n_states, n_observations) for _ in range(n_actions)],
        random.uniform(-1, 1, size=(n_actions, n_states)),
        start=rows(1, n_states)[0],
        discount=discount,
        reset=(random.random((n_actions, n_states)) < 0.2) if resets else None,
    )


def corridor(n=4, discount=0.9):
    """Find the hidden goal of a corridor: x is the cell, or one beyond them when it has been felt; y the
    goal.

    Moving onto the goal is felt; grasping ends the episode and earns 1 at the goal.
    """
    X, S = 2 * n, 2 * n * n
    T, R, reset = np.zeros((3, S, S)), np.zeros((3, S)), np.zeros((3, S), dtype=bool)
    O = np.zeros((3, S, X))
    for x in range(X):
        for y in range(n):
            s, cell = x * n + y, x % n
            for a, step in enumerate((-1, 1)):
                to = min(max(cell + step, 0), n - 1)
                T[a, s, (to + n * (to == y)) * n + y] = 1
            T[2, s, s], reset[2, s], R[2, s] = 1, True, float(cell == y)
            O[:, s, x] = 1
    start = np.zeros((X, n))
    start[0, 1:] = 1 / (n - 1)
    model = pomdp(
        T, O, R, start=start.ravel(), discount=discount, reset=reset, actions=("left", "right", "grasp")
    )
    return MOMDP(model, X)


def slotted_aloha(n=10, *, actions=9, arrivals=0.9, discount=0.999):
    """Share a channel: let every backlogged station send with probability 1, 1/2, ... or 1/actions in a slot.

    A state is (stations backlogged, what the last slot held: 0 nothing, 1 a message, 2 a collision); only the
    latter is seen. A message leaves the backlog, Poisson arrivals join it, and every free place earns 1.
    """
    poisson = np.array([np.exp(-arrivals) * arrivals**k / math.factorial(k) for k in range(n)])
    T = np.zeros((actions, n, 3, n, 3))
    for a, backlog in np.ndindex(actions, n):
        p = 1 / (a + 1)
        idle = (1 - p) ** backlog
        message = backlog * p * (1 - p) ** (backlog - 1) if backlog else 0.0
        for held, chance in enumerate((idle, message, max(1 - idle - message, 0))):
            left = max(backlog - (held == 1), 0)
            joined = np.append(poisson[: n - 1 - left], 1 - poisson[: n - 1 - left].sum())
            T[a, backlog, :, left:, held] = chance * joined
    free = np.repeat(n - 1.0 - np.arange(n), 3)
    return pomdp(
        T.reshape(actions, 3 * n, 3 * n),
        np.tile(np.eye(3), (actions, n, 1)),
        np.tile(free, (actions, 1)),
        start=np.eye(3 * n)[0],
        discount=discount,
    )


def domain_of(model, limit=100):
    """Return a domain of a bare model, whose episodes may open either way if it shows no x."""
    mixed = model if isinstance(model, MOMDP) else MOMDP(model)
    return Domain(
        id="model",
        title="Model",
        family="classic",
        model=mixed,
        episode_limit=limit,
        training_discount=mixed.joint.discount,
        report_discount=mixed.joint.discount,
        hidden_first_action=mixed.n_observed == 1,
    )


def best_action(alpha, belief):
    """Return the action of the vector that is the best at a belief."""
    return int(alpha.actions[(alpha.vectors @ belief).argmax()])


def value(alpha, belief):
    """Return what the best vector promises at a belief."""
    return float((alpha.vectors @ belief).max())
