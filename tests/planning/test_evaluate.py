import numpy as np
import pytest

from bgn import domains
from bgn.errors import InputError
from bgn.planning.evaluate import evaluate
from bgn.planning.heuristics import always, informed, qmdp
from bgn.policies.alpha_vectors import AlphaVectorPolicy, AlphaVectors
from bgn.policies.scripted import scripted_policy
from bgn.policies.uniform import RandomPolicy
from bgn.pomdp.model import MOMDP
from tests.planning.models import best_action, corridor, domain_of, guess, tiger


def exact_return(model, actions, *, hidden, limit=100):
    """Mean discounted return and its standard deviation, by propagating states and second moments.

    ``actions``: the distribution from which every action is drawn, whatever is seen.
    """
    T, _, R = model.dense()
    R = R[..., 0]
    S, gamma = model.n_states, model.discount
    # First and second moment of the return with n steps to go.
    m1, m2 = np.zeros(S), np.zeros(S)
    for _ in range(limit):
        n1, n2 = np.zeros(S), np.zeros(S)
        for a, p in ((a, p) for a, p in enumerate(actions) if p > 0):
            go = ~model.reset[a][:, None] * np.ones((1, S))
            mean = R[a] + gamma * go * m1
            square = R[a] ** 2 + 2 * gamma * R[a] * go * m1 + gamma**2 * go * m2
            n1 += p * (T[a] * mean).sum(axis=1)
            n2 += p * (T[a] * square).sum(axis=1)
        m1, m2 = n1, n2
    start = model.start @ T.mean(axis=0) if hidden else model.start
    return start @ m1, np.sqrt(start @ m2 - (start @ m1) ** 2)


# The exact values of random play and their standard deviations, under both conventions.
RANDOM = {
    ("hallway", False): (0.0421, 0.151),
    ("hallway", True): (0.0407, 0.147),
    ("hallway-2", False): (0.0264, 0.121),
    ("hallway-2", True): (0.0255, 0.118),
    ("rocksample-4-4", False): (-82.75, 19.8),
    ("rocksample-4-4", True): (-63.71, 38.75),
}


@pytest.mark.parametrize(("name", "hidden"), RANDOM)
def test_random_play_is_worth_what_propagation_says(name, hidden):
    domain = domains.get(name)
    model = domain.model
    n = model.joint.n_actions
    mean, sd = exact_return(model.joint, np.full(n, 1 / n), hidden=hidden)
    expected = RANDOM[name, hidden]
    assert mean == pytest.approx(expected[0], rel=2e-3)
    assert sd == pytest.approx(expected[1], rel=5e-3)
    convention = "hidden-first-action" if hidden else "clean"
    outcome = evaluate(domain, RandomPolicy(domain), episodes=20_000, seed=1, convention=convention)
    assert outcome.mean == pytest.approx(mean, abs=4 * outcome.standard_error)
    assert outcome.standard_deviation == pytest.approx(sd, rel=0.05)
    low, high = outcome.interval
    assert high - low == pytest.approx(2 * 1.96 * sd / np.sqrt(20_000), rel=0.05)


@pytest.mark.parametrize(
    ("name", "clean", "hidden"), [("rocksample-4-4", 8.57375, 6.72), ("rocksample-5-5", 8.1450625, 6.56)]
)
def test_driving_east(name, clean, hidden):
    domain = domains.get(name)
    model = domain.model
    policy = AlphaVectorPolicy(always(model.joint, "east"), domain)
    outcome = evaluate(domain, policy, episodes=100, seed=0)
    assert outcome.mean == pytest.approx(clean)
    assert outcome.standard_deviation == pytest.approx(0, abs=1e-9)
    assert outcome.length == {"rocksample-4-4": 5, "rocksample-5-5": 6}[name]  # the reset is a counted step
    east = np.eye(model.joint.n_actions)[model.joint.action_names.index("east")]
    assert exact_return(model.joint, east, hidden=True)[0] == pytest.approx(hidden, abs=5e-3)
    outcome = evaluate(domain, policy, episodes=20_000, seed=0, convention="hidden-first-action")
    assert outcome.mean == pytest.approx(hidden, abs=4 * outcome.standard_error + 5e-3)


def test_beliefs_follow_bayes():
    # Listen until one state is .9 likely, then guess: right with the probability believed.
    vectors = np.array([[0.4, 0.4], [1.0, -3.0], [-3.0, 1.0]])  # 1 - 4 (1 - p) > .4 iff p > .85
    domain = domain_of(guess(discount=0.999999))
    policy = AlphaVectorPolicy(AlphaVectors(vectors=vectors, actions=np.array([0, 1, 2])), domain)
    outcome = evaluate(domain, policy, episodes=20_000, seed=3)
    # Two agreeing answers more on one side: p = .64 / .68; a random walk that ends at ±2 takes 2 / .68
    # answers.
    right, answers = 0.64 / 0.68, 2 / 0.68
    assert outcome.length == pytest.approx(answers + 1, rel=0.02)
    assert outcome.mean == pytest.approx(right - 0.1 * answers, abs=4 * outcome.standard_error + 1e-3)


def test_x_is_seen_from_the_start():
    domain = domain_of(corridor(4))
    policy = AlphaVectorPolicy(qmdp(domain.model), domain)
    outcome = evaluate(domain, policy, episodes=3000, seed=0)
    assert outcome.success == 1
    assert outcome.mean == pytest.approx((0.9 + 0.81 + 0.729) / 3, abs=4 * outcome.standard_error)
    assert outcome.length == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize("make", [qmdp, informed])
def test_greedy_policies_hold_one_vector_an_action(make):
    alpha = make(MOMDP(tiger()))
    assert alpha.actions.tolist() == [0, 1, 2]
    assert best_action(alpha, np.array([1.0, 0.0])) == 2


def test_the_seed_decides():
    domain = domains.get("hallway")
    same = [evaluate(domain, RandomPolicy(domain), episodes=500, seed=s) for s in (5, 5, 6)]
    assert same[0] == same[1] != same[2]


def test_the_limit_counts_steps():
    domain = domain_of(tiger())
    policy = AlphaVectorPolicy(always(tiger(), "listen"), domain)
    outcome = evaluate(domain, policy, episodes=10, seed=0, limit=3)
    assert outcome.length == 3
    assert outcome.mean == pytest.approx(-1 - 0.95 - 0.95**2)
    assert outcome.success == 0
    undiscounted = evaluate(domain, policy, episodes=10, seed=0, limit=3, discount=1.0)
    assert undiscounted.mean == pytest.approx(-3)


def test_bad_requests_are_refused():
    domain = domain_of(tiger())
    with pytest.raises(InputError, match=r"no action 'sing'; known: listen, open-left, open-right"):
        always(tiger(), "sing")
    with pytest.raises(InputError, match="1 episodes"):
        evaluate(domain, RandomPolicy(domain), episodes=1, seed=0)
    corridors = domain_of(corridor(3))
    with pytest.raises(InputError, match="model has no hidden first action"):
        evaluate(corridors, RandomPolicy(corridors), episodes=2, seed=0, convention="hidden-first-action")


@pytest.mark.parametrize("name", ["top-plate", "two-bumps-1d", "two-bumps-2d"])
def test_a_policy_with_a_memory_acts_in_every_lane(name):
    domain = domains.get(name)
    outcome = evaluate(domain, scripted_policy(domain), episodes=300, seed=0, discount=1.0)
    assert outcome.success == 1
    assert outcome.length < domain.episode_limit
