from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn import domains
from bgn.planning.episodic import start_beliefs
from bgn.planning.evaluate import evaluate
from bgn.planning.sarsop import PlanningError, Sarsop, solve
from bgn.policies.alpha_vectors import AlphaVectorPolicy
from tests.planning.exact import tree_bounds
from tests.planning.models import (
    best_action,
    corridor,
    guess,
    pomdp,
    random_model,
    slotted_aloha,
    tiger,
    value,
)


def solved(model, precision=1e-3, timeout=20, **options):
    solution = solve(model, precision=precision, timeout=timeout, **options)
    assert solution.reason == "precision"
    assert 0 <= solution.progress.gap + 1e-9 <= precision + 1e-9
    return solution


def test_guessing_by_hand():
    # Guess at once: .5. Listen, then guess: -.1 + .9 · .8 = .62. Listening again after the first time:
    # -.1 + .9 (.68 · .64/.68 + .32 · .5) = .62 < .8, so no.
    solution = solved(guess(), precision=1e-6)
    assert solution.progress.lower == pytest.approx(0.62, abs=2e-6)
    policy = solution.policy
    assert best_action(policy, np.array([0.5, 0.5])) == 0
    assert best_action(policy, np.array([0.8, 0.2])) == 1
    assert best_action(policy, np.array([0.2, 0.8])) == 2


def test_tiger():
    # The value to five digits is in the literature (γ = .95, uniform start).
    solution = solved(tiger())
    assert solution.progress.lower == pytest.approx(19.3714, abs=1.1e-3)
    policy = solution.policy
    heard_left_twice = np.array([0.85**2, 0.15**2]) / (0.85**2 + 0.15**2)
    assert best_action(policy, np.array([0.5, 0.5])) == 0
    assert best_action(policy, np.array([0.85, 0.15])) == 0
    assert best_action(policy, heard_left_twice) == 2


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    shape=st.sampled_from([(2, 2, 2), (3, 2, 2), (5, 2, 2), (3, 3, 1), (3, 1, 3), (4, 2, 1)]),
    resets=st.booleans(),
)
def test_random_models_against_the_whole_tree(seed, shape, resets):
    n_states, n_actions, n_observations = shape
    model = random_model(
        seed,
        n_states=n_states,
        n_actions=n_actions,
        n_observations=n_observations,
        discount=0.4,
        resets=resets,
    )
    progress = solved(model, precision=1e-4).progress
    lower, upper = tree_bounds(model, depth=8)
    assert progress.lower <= upper + 1e-7
    assert progress.upper >= lower - 1e-7
    assert progress.lower >= lower - 1e-4 - 1e-7
    assert progress.upper <= upper + 1e-4 + 1e-7


@pytest.mark.parametrize(
    "model", [tiger(), random_model(7, n_states=5, discount=0.95), domains.get("hallway").model]
)
def test_bounds_are_monotone_and_never_cross(model):
    search = Sarsop(model)
    before = search.progress()
    for _, _ in zip(range(40), search.trials(1e-4), strict=False):
        now = search.progress()
        assert before.lower - 1e-12 <= now.lower <= now.upper + 1e-9
        assert now.upper <= before.upper + 1e-12
        before = now


@pytest.mark.parametrize("name", ["rocksample-4-4", "hallway"])
@pytest.mark.parametrize("convention", ["clean", "hidden-first-action"])
def test_the_policy_earns_at_least_its_bound(name, convention):
    domain = domains.get(name)
    solution = solve(domain.model, precision=1e-3, timeout=20, backups=3000, convention=convention)
    policy = AlphaVectorPolicy(solution.policy, domain)
    outcome = evaluate(domain, policy, episodes=2000, seed=0, convention=convention)
    cut = 0.95**100 * 200  # what the limit of 100 steps can cost at the most
    assert outcome.mean >= solution.progress.lower - 4 * outcome.standard_error - cut
    assert outcome.mean <= solution.progress.upper + 4 * outcome.standard_error


@pytest.mark.parametrize("model", [tiger(), guess(), random_model(3, discount=0.9)])
def test_the_vectors_attain_the_lower_bound(model):
    solution = solved(model)
    assert value(solution.policy, model.start) == pytest.approx(solution.progress.lower, abs=1e-9)


def test_rocksample_4_4_is_solved():
    progress = solved(domains.get("rocksample-4-4").model).progress
    assert progress.lower == pytest.approx(17.9245, abs=1e-3)


def test_rocksample_4_4_under_a_hidden_first_action():
    # The artefact of the paper's table: no agent that lives through that action can earn 17.92.
    progress = solved(domains.get("rocksample-4-4").model, convention="hidden-first-action").progress
    assert progress.lower == pytest.approx(14.117, abs=1e-3)


def test_a_hidden_first_action_is_the_mean_over_its_openings():
    model = tiger()
    expected = 0.0
    for start in start_beliefs(model, "hidden-first-action"):
        from_here = pomdp(*model.dense()[:2], model.expected_rewards, start=start.belief, discount=0.95)
        expected += start.weight * solved(from_here, precision=1e-4).progress.lower
    hidden = solved(model, precision=1e-4, convention="hidden-first-action").progress
    assert hidden.lower == pytest.approx(expected, abs=2e-4)


def test_mixed_observability_by_hand():
    # Goal at cell 1, 2 or 3, finger at 0: at step d the goal at d is felt, then grasped, so it earns γ^d.
    progress = solved(corridor(4), precision=1e-6).progress
    assert progress.lower == pytest.approx((0.9 + 0.81 + 0.729) / 3, abs=1e-5)


def test_an_episode_that_is_over_at_once_is_worth_nothing():
    over = pomdp([np.eye(1)], [np.ones((1, 1))], [[0.0]], start=[1.0], discount=0.9)
    progress = solved(over).progress
    assert (progress.lower, progress.upper) == (0, 0)


@pytest.mark.parametrize("precision", [0.0, -1.0, float("nan"), 1e-12])
def test_an_impossible_precision_is_refused(precision):
    with pytest.raises(PlanningError, match=r"precision .* is impossible"):
        solve(tiger(), precision=precision, timeout=1)


def test_other_impossible_requests_are_refused():
    with pytest.raises(PlanningError, match="timeout -1 is not positive"):
        solve(tiger(), precision=1e-3, timeout=-1)
    with pytest.raises(PlanningError, match="discount below 1"):
        solve(tiger(discount=1.0), precision=1e-3, timeout=1)


def test_an_interrupt_keeps_what_was_found():
    def interrupt(progress):
        if progress.trials > 5:
            raise KeyboardInterrupt

    model = domains.get("hallway").model
    solution = solve(model, precision=1e-3, timeout=60, on_progress=interrupt)
    assert solution.reason == "interrupted"
    assert value(solution.policy, model.joint.start) == pytest.approx(solution.progress.lower, abs=1e-9)


def test_a_timeout_is_kept():
    solution = solve(domains.get("hallway-2").model, precision=1e-3, timeout=0.5)
    assert solution.reason == "timeout"
    assert 0.5 <= solution.progress.seconds < 2.0


@pytest.mark.parametrize(
    ("stations", "sending", "discount", "stalled_at"),
    [(5, 4, 0.98, (39.604, 41.653)), (6, 5, 0.99, (72.344, 76.256))],
)
def test_paths_that_go_round_do_not_stall_the_search(stations, sending, discount, stalled_at):
    # A slot in which nothing is sent leads back to the same belief, which is also the likeliest to follow.
    # A search that always goes there stands still at `stalled_at` (measured, for 20,000 backups).
    model = slotted_aloha(stations, actions=sending, discount=discount)
    progress = solve(model, precision=1e-3, timeout=60, backups=10_000).progress
    assert progress.lower > stalled_at[0] + 0.5
    assert progress.upper < stalled_at[1] - 0.2


def test_work_decides_what_is_found_not_time():
    model = domains.get("hallway").model
    first, second = (
        solve(model, precision=1e-3, timeout=100, backups=500, on_progress=waste)
        for waste in (None, lambda progress: sum(range(100_000)))
    )
    assert first.reason == second.reason == "backups"
    assert 500 <= first.progress.backups < 700
    assert replace(first.progress, seconds=0.0) == replace(second.progress, seconds=0.0)
    assert (first.policy.vectors == second.policy.vectors).all()


def test_no_work_is_refused():
    with pytest.raises(PlanningError, match="0 backups are not positive"):
        solve(tiger(), precision=1e-3, timeout=1, backups=0)
