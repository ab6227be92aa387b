"""The uniformly random policy, exactly: it ignores observations, so its return is that of a Markov chain."""

from __future__ import annotations

import numpy as np
import pytest

from bgn import domains


def return_moments(domain):
    """E[G | s] and E[G² | s] of an episode's discounted return G by backward induction, each (S,)."""
    model = domain.model.joint
    S, A = model.n_states, model.n_actions
    first, second = np.zeros(S), np.zeros(S)
    moves = [T.tocoo() for T in model.transitions]
    rewards = [
        np.broadcast_to(model.rewards[min(a, len(model.rewards) - 1), :, :, 0], (S, S))[T.coords]
        for a, T in enumerate(moves)
    ]
    for _ in range(domain.episode_limit):
        mean, square = np.zeros(S), np.zeros(S)
        for a, T in enumerate(moves):
            s, s_next = T.coords
            future = np.where(model.reset[a, s], 0.0, model.discount)
            r = rewards[a]
            mean += np.bincount(s, T.data * (r + future * first[s_next]), S) / A
            after = r**2 + 2 * r * future * first[s_next] + future**2 * second[s_next]
            square += np.bincount(s, T.data * after, S) / A
        first, second = mean, square
    return first, second


@pytest.mark.parametrize(
    ("domain_id", "hidden", "mean", "deviation"),
    [
        ("hallway", False, 0.0421, 0.151),
        ("hallway", True, 0.0407, 0.147),
        ("hallway-2", False, 0.0264, 0.121),
        ("hallway-2", True, 0.0255, 0.118),
        ("rocksample-4-4", False, -82.75, 19.8),
        ("rocksample-4-4", True, -63.71, 38.75),
        ("rocksample-5-5", False, -80.22, 20.3),
        ("rocksample-5-5", True, -63.39, 36.80),
    ],
)
def test_random_returns(domain_id, hidden, mean, deviation):
    """With the hidden first action, the paper's Random row: .05±.15, .03±.11, -62±38.2, -61±36.12."""
    domain = domains.get(domain_id)
    model = domain.model.joint
    first, second = return_moments(domain)
    start = model.start
    if hidden:
        start = sum(start @ T for T in model.transitions) / model.n_actions
    digits = len(str(mean).partition(".")[2])
    assert start @ first == pytest.approx(mean, abs=0.51 * 10**-digits)
    digits = len(str(deviation).partition(".")[2])
    assert np.sqrt(start @ second - (start @ first) ** 2) == pytest.approx(deviation, abs=0.51 * 10**-digits)


@pytest.mark.parametrize(("domain_id", "share"), [("rocksample-4-4", 2 / 9), ("rocksample-5-5", 2 / 10)])
def test_the_hidden_action_ends_some_episodes(domain_id, share):
    model = domains.get(domain_id).model.joint
    ended = sum(model.start @ T for T in model.transitions)[-1] / model.n_actions
    assert ended == pytest.approx(share)
