"""Brute force: bounds on the optimum from the whole tree of beliefs to a depth."""

import numpy as np


def tree_bounds(model, depth):
    """Return (lower, upper) on V* at the start: ``depth`` optimal steps, then the least and the most."""
    T, O, _ = model.dense()
    T = np.where(model.reset[:, :, None], 0, T)
    R, gamma = model.expected_rewards, model.discount
    levels = [model.start[None]]  # unnormalised beliefs, (nodes, S)
    for _ in range(depth):
        after = np.einsum("ns,ast->nat", levels[-1], T)  # (nodes, A, S)
        levels.append(np.einsum("nat,ato->naot", after, O).reshape(-1, model.n_states))
    mass = levels[-1].sum(axis=1)
    reach = np.array([min(R.min(), 0), max(R.max(), 0)]) / (1 - gamma)
    values = mass[:, None] * reach  # (nodes, 2)
    for beliefs in levels[-2::-1]:
        future = values.reshape(len(beliefs), model.n_actions, model.n_observations, 2).sum(axis=2)
        values = ((beliefs @ R.T)[:, :, None] + gamma * future).max(axis=1)
    return values[0]
