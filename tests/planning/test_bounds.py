import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.planning.bounds import blind_policies, fast_informed, mdp_values, value_scale
from bgn.planning.compiled import compile_model
from bgn.planning.episodic import start_beliefs
from tests.planning.models import guess, pomdp, random_model, tiger


def compiled(model):
    return compile_model(model, start_beliefs(model))


def test_tiger_by_hand():
    model = compiled(tiger())
    # Seeing the tiger, one opens the other door for ever: 10 / (1 - .95) = 200.
    best = 10 / 0.05
    assert mdp_values(model) == pytest.approx(
        np.array([[-1 + 0.95 * best] * 2, [-100 + 0.95 * best, best], [best, -100 + 0.95 * best]]), rel=1e-6
    )
    blind = blind_policies(model)
    assert blind[0] == pytest.approx([-20, -20], rel=1e-6)  # -1 / .05
    # Always opening left: 10 or -100 now, then -45 a step for ever.
    assert blind[1] == pytest.approx([-100 - 45 * 19, 10 - 45 * 19], rel=1e-6)


def test_guessing_by_hand():
    model = compiled(guess())
    assert mdp_values(model) == pytest.approx(np.array([[-0.1 + 0.9, -0.1 + 0.9], [1, 0], [0, 1]]))
    # The state never moves, so seeing it after the next observation is as good as seeing it now.
    assert fast_informed(model) == pytest.approx(mdp_values(model))
    assert blind_policies(model) == pytest.approx(np.array([[-1.0, -1.0], [1, 0], [0, 1]]), rel=1e-6)


def test_seeing_the_state_one_step_late_costs_something():
    # Hidden coin, thrown anew each step: the best guess before the throw is worth 1/2, seen it would be 1.
    coin = pomdp(
        [np.full((2, 2), 0.5)] * 2,
        [np.full((2, 1), 1.0)] * 2,
        [[1, 0], [0, 1]],
        start=[0.5, 0.5],
        discount=0.5,
    )
    # The MDP: 1 now, 1 for ever = 2. Informed: what is to come is worth x = .5 (1 + γ x) + .5 γ x = 1 either
    # way.
    assert mdp_values(compiled(coin)) == pytest.approx(np.array([[2, 1], [1, 2]]))
    assert fast_informed(compiled(coin)) == pytest.approx(np.array([[1.5, 0.5], [0.5, 1.5]]))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), resets=st.booleans())
def test_bounds_are_ordered(seed, resets):
    model = compiled(random_model(seed, discount=0.8, resets=resets))
    q, informed, blind = mdp_values(model), fast_informed(model), blind_policies(model)
    slack = 1e-9 * value_scale(model)
    assert (informed <= q + slack).all()
    assert (blind <= informed + slack).all()
