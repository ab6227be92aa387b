import numpy as np
import pytest

from bgn import domains
from bgn.planning.deterministic import solve_deterministic
from bgn.planning.sarsop import PlanningError, solve
from bgn.pomdp.model import MOMDP
from tests.planning.models import corridor, guess, pomdp

# Exact optima by an independent belief-tree program: value, mean and longest episode; success is certain in
# all.
OPTIMA = {
    ("top-plate", "paper"): (0.929579, 8.3, 12),
    ("two-bumps-1d", "paper"): (0.935953, 7.64, 16),
    ("two-bumps-1d", "authors"): (0.939495, 7.27, 18),
    ("two-bumps-2d", "paper"): (0.884850, 13.24, 22),
}


@pytest.mark.parametrize(("name", "variant"), OPTIMA)
def test_robot_domains(name, variant):
    optimum = solve_deterministic(domains.get(name, variant=variant).model)
    value, length, longest = OPTIMA[name, variant]
    assert optimum.value == pytest.approx(value, abs=1e-6)
    assert optimum.mean_return == pytest.approx(1, abs=1e-9)
    assert optimum.return_sd == pytest.approx(0, abs=1e-6)
    assert optimum.mean_length == pytest.approx(length, abs=0.01)
    assert optimum.max_length == longest


@pytest.mark.parametrize("n", [3, 4, 7])
def test_a_corridor_by_hand(n):
    # The goal d cells away takes d moves and the grasp; at the last cell nothing need be felt.
    optimum = solve_deterministic(corridor(n))
    distances = np.arange(1, n)
    assert optimum.value == pytest.approx((0.9**distances).mean(), abs=1e-12)
    assert optimum.mean_length == pytest.approx((distances + 1).mean())
    assert optimum.max_length == n


def test_giving_up_on_some_is_weighed():
    # At a discount of .1 going on is not worth it: grasp at the first chance. Cell 1 feels the goal or not.
    optimum = solve_deterministic(corridor(4, discount=0.1))
    assert optimum.value == pytest.approx((0.1 + 0.01 + 0.001) / 3)


def test_a_shot_in_the_dark_has_spread():
    # Guess one of three y at once, nothing to be felt: right with probability .5.
    n = 3
    model = pomdp(
        [np.eye(n)] * n,
        [np.ones((n, 1))] * n,
        np.eye(n),
        start=[0.2, 0.5, 0.3],
        discount=0.9,
        reset=np.ones((n, n), bool),
    )
    optimum = solve_deterministic(MOMDP(model))
    assert (optimum.value, optimum.mean_return, optimum.return_sd) == pytest.approx((0.5, 0.5, 0.5))
    assert (optimum.mean_length, optimum.max_length, optimum.beliefs) == (1, 1, 1)


def test_the_search_agrees():
    model = domains.get("top-plate").model
    progress = solve(model, precision=1e-3, timeout=20).progress
    assert progress.lower - 1e-6 <= 0.929579 <= progress.upper + 1e-6
    assert progress.gap <= 1e-3


def test_other_models_are_refused():
    with pytest.raises(PlanningError, match="only reward the step that ends"):
        solve_deterministic(MOMDP(guess()))
    random = pomdp([np.full((2, 2), 0.5)], [np.eye(2)], [[0, 0]], start=[1, 0], discount=0.9)
    with pytest.raises(PlanningError, match="'a0' has random outcomes"):
        solve_deterministic(MOMDP(random))
    turning = pomdp([np.eye(2)[::-1]], [np.eye(2)], [[0, 0]], start=[1, 0], discount=0.9)
    with pytest.raises(PlanningError, match="'a0' changes the hidden part"):
        solve_deterministic(MOMDP(turning))
    idle = pomdp([np.eye(2)], [np.eye(2)], [[0, 0]], start=[1, 0], discount=0.9)
    with pytest.raises(PlanningError, match="never ends"):
        solve_deterministic(MOMDP(idle))
    endless = pomdp([np.eye(2)], [np.eye(2)], [[0, 0]], start=[1, 0], discount=1.0)
    with pytest.raises(PlanningError, match="discount below 1"):
        solve_deterministic(MOMDP(endless))
    skewed = pomdp(
        [np.eye(4)],
        [np.eye(4)],
        [np.zeros(4)],
        start=[0.4, 0.1, 0.1, 0.4],
        discount=0.9,
        reset=np.ones((1, 4), bool),
    )
    with pytest.raises(PlanningError, match="depends on x"):
        solve_deterministic(MOMDP(skewed, 2))
