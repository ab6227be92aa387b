"""The three robot domains: sizes, starts, endings, rewards, variants, features, exact policy values."""

from __future__ import annotations

import numpy as np
import pytest

from bgn import domains
from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d
from bgn.policies.scripted import scripted_policy

ROBOTS = ("top-plate", "two-bumps-1d", "two-bumps-2d")
VARIANTS = [(name, variant) for name in ROBOTS for variant in ("paper", "authors")]


def successors(domain):
    """(A, S) the one successor of every state and action."""
    joint = domain.model.joint
    assert all(T.nnz == joint.n_states for T in joint.transitions)
    return np.stack([T.indices for T in joint.transitions])


def reachable(domain):
    joint, following = domain.model.joint, successors(domain)
    seen = joint.start > 0
    frontier = np.flatnonzero(seen)
    while len(frontier):
        new = np.unique(
            [following[a, s] for a in range(joint.n_actions) for s in frontier[~joint.reset[a, frontier]]]
        )
        frontier = new[~seen[new]]
        seen[frontier] = True
    return seen


@pytest.mark.parametrize(
    ("name", "sizes", "states"),
    [
        ("top-plate", (36, 10, 3, 36), 175),
        ("two-bumps-1d", (45, 39, 4, 45), 663),
        ("two-bumps-2d", (320, 192, 5, 80), 12184),
    ],
)
def test_sizes_and_reachable_states(name, sizes, states):
    domain = domains.get(name)
    joint = domain.model.joint
    assert (domain.model.n_observed, domain.model.n_hidden, joint.n_actions, joint.n_observations) == sizes
    assert reachable(domain).sum() == states


@pytest.mark.parametrize(
    ("name", "limit", "authors"), [(ROBOTS[0], 50, 100), (ROBOTS[1], 100, 50), (ROBOTS[2], 100, 100)]
)
def test_episode_rules(name, limit, authors):
    domain = domains.get(name)
    assert (domain.family, domain.episode_limit, domain.hidden_first_action) == ("robot", limit, False)
    assert (domain.training_discount, domain.report_discount) == (0.99, 1.0)
    assert domain.prior is None
    assert domain.elimination is None
    assert domains.get(name, variant="authors").episode_limit == authors


@pytest.mark.parametrize(("name", "variant"), VARIANTS)
def test_rewards_are_earned_by_endings_only(name, variant):
    joint = domains.get(name, variant=variant).model.joint
    rewards = joint.expected_rewards
    assert set(np.unique(rewards)) == {0.0, 1.0}
    assert not rewards[~joint.reset].any()


@pytest.mark.parametrize(("name", "variant"), VARIANTS)
def test_endings_and_impossible_states_stay_put(name, variant):
    domain = domains.get(name, variant=variant)
    following, states = successors(domain), np.arange(domain.model.joint.n_states)
    assert (following == states)[domain.model.joint.reset].all()


@pytest.mark.parametrize(("name", "variant"), VARIANTS)
def test_features_are_normalised_and_tell_readings_apart(name, variant):
    domain = domains.get(name, variant=variant)
    features, model = domain.features, domain.model
    assert len(features.observation) == model.joint.n_observations
    assert len(features.observed) == model.n_observed
    assert len(features.state) == model.joint.n_states
    for part in (features.observation, features.observed, features.state):
        assert part.dtype == np.float32
        assert part.min() == 0
        assert part.max() == 1
    assert len(np.unique(features.observation, axis=0)) == len(features.observation)
    seen = model.joint.observations[0].indices[:: model.n_hidden]
    np.testing.assert_array_equal(features.observed, features.observation[seen])


def test_features_by_hand():
    plate = domains.get("top-plate").features
    np.testing.assert_allclose(plate.observation[3 * 4 + 0], [4 / 11, 0.0], rtol=1e-6)
    np.testing.assert_allclose(plate.state[(3 * 4 + 0) * 10 + 6], [4 / 11, 0.0, 7 / 11], rtol=1e-6)
    line = domains.get("two-bumps-1d").features
    y = two_bumps_1d.PAIRS.index((3, 9))
    np.testing.assert_allclose(line.state[(3 * 14 + 1) * 39 + y], [1.0, 0.5, 3 / 14, 9 / 14], rtol=1e-6)
    y = two_bumps_2d.PAIRS.index((1, 11))  # large at column 1 row 0, small at column 3 row 2
    s = ((6 * 5 + 3) * 4 + 2) * 192 + y  # finger at column 2 row 1, mildly positive, the small one touched
    expected = [2 / 3, 1 / 3, 3 / 4, 1 / 3, 0, 1, 2 / 3]
    paper, authors = (domains.get("two-bumps-2d", variant=v).features.state[s] for v in ("paper", "authors"))
    np.testing.assert_allclose(paper, [*expected, 0, 1], rtol=1e-6)
    np.testing.assert_allclose(authors, expected, rtol=1e-6)


def start(name, **variant):
    model = domains.get(name, **variant).model
    return model.joint.start.reshape(model.n_observed, model.n_hidden)


def test_top_plate_starts_below_a_stack_of_uniform_height():
    expected = np.zeros((36, 10))
    expected[1] = 0.1  # level 0, neutral
    np.testing.assert_allclose(start("top-plate"), expected)


def test_bumps_and_finger_start_jointly_uniform():
    line, plane = start("two-bumps-1d"), start("two-bumps-2d")
    assert set(np.unique(line)) == {0, 1 / (39 * 13)}
    np.testing.assert_allclose(line.sum(axis=0), 1 / 39)
    assert line[3 * 5 + 1, two_bumps_1d.PAIRS.index((5, 7))] == 0  # on the left bump
    assert set(np.unique(plane)) == {0, 1 / (192 * 14)}
    assert not plane[np.arange(320) % 4 != 0].any()  # nothing touched yet


def test_pairs_of_bumps():
    assert len(two_bumps_1d.PAIRS) == 39
    assert len(two_bumps_2d.PAIRS) == 192
    assert (0, 4) not in two_bumps_2d.PAIRS  # above each other
    assert (3, 4) in two_bumps_2d.PAIRS  # the end of a row and the beginning of the next


def test_top_plate_is_grasped_at_the_top():
    joint = domains.get("top-plate").model.joint
    R, Y = joint.expected_rewards, 10
    assert R[top_plate.GRASP, (3 * 7 + 0) * Y + 6] == 1  # level 7 of a stack of 7
    assert R[top_plate.GRASP, (3 * 6 + 0) * Y + 6] == 0
    assert joint.reset[top_plate.GRASP].all()
    assert not joint.reset[[top_plate.DOWN, top_plate.UP]].any()


def test_stiff_pushes_by_hand():
    joint = domains.get("two-bumps-1d").model.joint
    R, reset = joint.expected_rewards, joint.reset
    y = two_bumps_1d.PAIRS.index((4, 8))

    def s(cell, angle):
        return (3 * cell + angle) * 39 + y

    right, left, soft = two_bumps_1d.RIGHT_STIFF, two_bumps_1d.LEFT_STIFF, two_bumps_1d.RIGHT_SOFT
    assert (reset[right, s(7, 1)], R[right, s(7, 1)]) == (True, 1)  # into the right bump from its left
    assert (reset[left, s(9, 1)], R[left, s(9, 1)]) == (True, 0)  # into it from its right
    assert (reset[right, s(3, 1)], R[right, s(3, 1)]) == (True, 0)  # into the left bump
    assert (reset[right, s(8, 0)], R[right, s(8, 0)]) == (True, 1)  # through the bump the tip lags behind
    assert not reset[right, s(8, 2)]  # the tip lies ahead: it leaves without touching
    assert not reset[soft, s(7, 1)]
    assert not reset[right, s(5, 1)]


def test_large_bump_is_grasped_once_both_were_touched():
    domain = domains.get("two-bumps-2d")
    R = domain.model.joint.expected_rewards[two_bumps_2d.GRASP].reshape(80, 4, 192)
    y = two_bumps_2d.PAIRS.index((5, 10))
    assert R[5 * 5 + 4, :, y].tolist() == [0, 0, 0, 1]
    assert R[10 * 5 + 3, :, y].tolist() == [0, 0, 0, 0]
    following = successors(domain)[two_bumps_2d.RIGHT].reshape(80, 4, 192) // 192
    assert following[4 * 5 + 2, 2, y] == (5 * 5 + 0) * 4 + 3  # onto the large one, the small one known


def test_authors_top_plate():
    domain = domains.get("top-plate", variant="authors")
    assert (domain.model.n_observed, domain.model.n_hidden) == (21, 8)  # as the paper's Table 5 prints
    np.testing.assert_allclose(start("top-plate", variant="authors")[1], [0, *[0.2] * 5, 0, 0])
    np.testing.assert_allclose(domain.prior[1], [0, *[1 / 6] * 6, 0])


def test_authors_draw_the_left_bump_first_and_believe_otherwise():
    model = start("two-bumps-1d", variant="authors").sum(axis=0)
    by_left = {
        b1: sum(p for (b, _), p in zip(two_bumps_1d.PAIRS, model, strict=True) if b == b1)
        for b1 in range(2, 11)
    }
    np.testing.assert_allclose(list(by_left.values()), 1 / 9)
    assert model[two_bumps_1d.PAIRS.index((10, 12))] == pytest.approx(1 / 9)
    prior = domains.get("two-bumps-1d", variant="authors").prior
    x = 3 * 5 + 1
    possible = np.array([5 not in pair for pair in two_bumps_1d.PAIRS])
    np.testing.assert_allclose(prior[x], possible / possible.sum())
    np.testing.assert_allclose(prior.sum(axis=1), 1)


def test_authors_eliminate_only_cells_felt_neutral():
    keeps = domains.get("two-bumps-2d", variant="authors").elimination.reshape(80, 4, 192)
    pairs = np.array(two_bumps_2d.PAIRS)
    for flags in range(4):
        np.testing.assert_array_equal(keeps[5 * 6 + 2, flags], ~(pairs == 6).any(axis=1))
        assert keeps[5 * 6 + 4, flags].all()


@pytest.mark.parametrize("name", ROBOTS)
def test_unknown_variant_is_a_clear_error(name):
    with pytest.raises(ValueError, match="unknown variant 'new'; known: paper, authors"):
        domains.get(name, variant="new")


@pytest.mark.parametrize(
    ("variant", "message"),
    [
        ({"plates": 0}, "1 to 10 plates, not 0"),
        ({"plates": 11}, "1 to 10 plates, not 11"),
        ({"plates": 7, "variant": "authors"}, "has 5 plates, not 7"),
    ],
)
def test_impossible_stacks_are_a_clear_error(variant, message):
    with pytest.raises(ValueError, match=message):
        domains.get("top-plate", **variant)


def random_success(domain):
    """Success probability of uniformly random actions within the episode limit, exactly."""
    joint, following = domain.model.joint, successors(domain)
    mass, success = joint.start.copy(), 0.0
    for _ in range(domain.episode_limit):
        each = np.broadcast_to(mass / joint.n_actions, joint.reset.shape)
        success += (each * joint.expected_rewards).sum()
        goes_on = ~joint.reset & (each > 0)
        mass = np.bincount(following[goes_on], weights=each[goes_on], minlength=joint.n_states)
    return success


@pytest.mark.parametrize(
    ("name", "variant", "success"),
    [
        ("top-plate", {"plates": 1}, 0.25),  # by hand: p0 = (p0 + p1) / 3, p1 = (p0 + p2 + 1) / 3, p2 = p0
        ("top-plate", {"plates": 5}, 0.0759),
        ("top-plate", {}, 0.0382),
        ("two-bumps-1d", {}, 0.1496),
        ("two-bumps-2d", {}, 0.0039),
    ],
)
def test_random_success(name, variant, success):
    assert random_success(domains.get(name, **variant)) == pytest.approx(success, abs=5e-5)


def episodes(domain):
    """Run the scripted policy from every start; yield (probability, success, length)."""
    joint, following, policy = domain.model.joint, successors(domain), scripted_policy(domain)
    for s in np.flatnonzero(joint.start):
        probability, action, length, over = joint.start[s], None, 0, False
        policy.reset()
        while not over:
            action = policy.act(int(joint.observations[0].indices[s]), action)
            length += 1
            assert length <= domain.episode_limit
            over, reward = joint.reset[action, s], joint.expected_rewards[action, s]
            s = following[action, s]
        yield probability, reward, length


@pytest.mark.parametrize(
    ("name", "variant", "value", "mean", "longest"),
    [
        ("top-plate", {}, 0.929579, 8.3, 12),  # it is optimal
        ("top-plate", {"plates": 5}, 0.954871, 5.6, 7),
        ("two-bumps-1d", {}, 0.914844, 9.94, 23),
        ("two-bumps-2d", {}, 0.882222, 13.54, 22),
    ],
)
def test_the_policies_the_paper_describes_always_succeed(name, variant, value, mean, longest):
    probability, success, length = np.array(list(episodes(domains.get(name, **variant)))).T
    assert success.all()
    assert (probability * 0.99 ** (length - 1)).sum() == pytest.approx(value, abs=1e-6)
    assert (probability * length).sum() == pytest.approx(mean, abs=5e-3)
    assert length.max() == longest
