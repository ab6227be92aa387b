from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.pomdp.belief import ImpossibleObservationError, update, update_hidden
from bgn.pomdp.model import MOMDP
from tests.pomdp._models import distributions, random_model

seeds = st.integers(0, 2**32 - 1)


def tiger():
    """Two doors; listening (action 0) is right with .85; opening (actions 1, 2) starts over."""
    model = random_model(np.random.default_rng(0), 2, 3, 2)
    listen, half = np.eye(2), np.full((2, 2), 0.5)
    hears = np.array([[0.85, 0.15], [0.15, 0.85]])
    return type(model)(
        transitions=tuple(type(model.transitions[0])(t) for t in (listen, half, half)),
        observations=tuple(type(model.transitions[0])(o) for o in (hears, half, half)),
        rewards=np.zeros((1, 1, 1, 1)),
        start=np.array([0.5, 0.5]),
        reset=np.zeros((3, 2), dtype=bool),
        discount=0.95,
        state_names=("left", "right"),
        action_names=("listen", "open-left", "open-right"),
        observation_names=("hear-left", "hear-right"),
    )


def test_tiger_by_hand():
    once = update(tiger(), np.array([0.5, 0.5]), 0, 0)
    np.testing.assert_allclose(once, [0.85, 0.15], rtol=1e-15)
    twice = update(tiger(), once, 0, 0)
    np.testing.assert_allclose(twice, [0.7225 / 0.745, 0.0225 / 0.745], rtol=1e-15)
    np.testing.assert_allclose(update(tiger(), twice, 1, 0), [0.5, 0.5], rtol=1e-15)


def enumerate_posteriors(model, belief, action):
    """{(ended, o): Σ over explicit (s, s') of their joint probability}, by the definition of conditioning."""
    T, O, _ = model.dense()
    joint: dict[tuple[bool, int], np.ndarray] = {}
    for s, s_next, o in product(range(model.n_states), range(model.n_states), range(model.n_observations)):
        key = (bool(model.reset[action, s]), o)
        joint.setdefault(key, np.zeros(model.n_states))[s_next] += (
            belief[s] * T[action, s, s_next] * O[action, s_next, o]
        )
    return joint


@settings(max_examples=60, deadline=None)
@given(seeds, st.sampled_from([None, False, True]))
def test_equals_brute_force_enumeration(seed, ended):
    rng = np.random.default_rng(seed)
    model = random_model(rng, 5, 2, 3)
    belief, action = distributions(rng, (5,)), int(rng.integers(2))
    joint = enumerate_posteriors(model, belief, action)
    for o in range(3):
        expected = sum(
            (p for (end, seen), p in joint.items() if seen == o and ended in (None, end)), np.zeros(5)
        )
        if expected.sum() == 0:
            with pytest.raises(ImpossibleObservationError):
                update(model, belief, action, o, ended=ended)
        else:
            posterior = update(model, belief, action, o, ended=ended)
            np.testing.assert_allclose(posterior, expected / expected.sum(), atol=1e-14)


@settings(max_examples=60, deadline=None)
@given(seeds, st.sampled_from([None, False, True]))
def test_hidden_update_is_the_joint_update_given_x(seed, ended):
    """Appendix E equals Eq. 1 on the joint state, conditioned on the observed x'."""
    rng = np.random.default_rng(seed)
    X, Y = 3, 2
    model = MOMDP(random_model(rng, X * Y, 2, 3), X)
    x, action, b_y = int(rng.integers(X)), int(rng.integers(2)), distributions(rng, (Y,))
    belief = np.zeros(X * Y)
    belief[x * Y : (x + 1) * Y] = b_y
    joint = enumerate_posteriors(model.joint, belief, action)
    for x_next, o in product(range(X), range(3)):
        mass = sum((p for (end, seen), p in joint.items() if seen == o and ended in (None, end)), np.zeros(6))
        part = mass[x_next * Y : (x_next + 1) * Y]
        if part.sum() == 0:
            with pytest.raises(ImpossibleObservationError):
                update_hidden(model, b_y, action, o, x=x, x_next=x_next, ended=ended)
        else:
            posterior = update_hidden(model, b_y, action, o, x=x, x_next=x_next, ended=ended)
            np.testing.assert_allclose(posterior, part / part.sum(), atol=1e-14)


def test_a_momdp_with_one_x_is_the_pomdp():
    model = random_model(np.random.default_rng(3), 4, 2, 2)
    belief = np.full(4, 0.25)
    np.testing.assert_array_equal(
        update_hidden(MOMDP(model), belief, 1, 0, x=0, x_next=0), update(model, belief, 1, 0)
    )


def test_impossible_observation_names_what_was_seen():
    model = tiger()
    certain = type(model.transitions[0])(np.array([[1.0, 0.0], [1.0, 0.0]]))
    object.__setattr__(model, "observations", (certain,) * 3)
    with pytest.raises(ImpossibleObservationError, match="'hear-right' is impossible after action 'listen'"):
        update(model, np.array([0.5, 0.5]), 0, 1)


@pytest.mark.parametrize(
    ("belief", "action", "observation", "message"),
    [
        (np.ones(3), 0, 0, r"belief has shape \(3,\), not \(2,\)"),
        (np.ones(2), 3, 0, r"action 3 is not in 0\.\.2"),
        (np.ones(2), 0, -1, r"observation -1 is not in 0\.\.1"),
    ],
)
def test_bad_arguments_are_refused(belief, action, observation, message):
    with pytest.raises(ValueError, match=message):
        update(tiger(), belief, action, observation)
