from __future__ import annotations

from math import exp, sqrt

import numpy as np
import pytest

from bgn import domains
from bgn.domains.rocksample import RockSample, rocksample

NORTH, EAST, SOUTH, WEST = range(4)


def model_of(domain_id):
    return domains.get(domain_id).model.joint


def at(model, name):
    return model.state_names.index(name)


@pytest.mark.parametrize(
    ("domain_id", "sizes"), [("rocksample-4-4", (257, 9, 2)), ("rocksample-5-5", (801, 10, 2))]
)
def test_sizes_and_episode_rules(domain_id, sizes):
    domain = domains.get(domain_id)
    model = domain.model.joint
    assert (model.n_states, model.n_actions, model.n_observations) == sizes
    assert (domain.episode_limit, domain.report_discount, domain.hidden_first_action) == (100, 0.95, True)
    assert model.reset[:, -1].all()
    assert model.reset.sum() == model.n_actions
    assert model.state_names[-1] == "st"


def test_start_is_the_west_edge_with_unknown_rocks():
    model = model_of("rocksample-4-4")
    starts = [model.state_names[s] for s in model.start.nonzero()[0]]
    assert starts == [f"s02{m:04b}" for m in range(16)]
    assert (model.start[model.start > 0] == 1 / 16).all()


@pytest.mark.parametrize(
    ("state", "action", "successor", "reward"),
    [
        ("s020110", "north", "s030110", 0),
        ("s020110", "east", "s120110", 0),
        ("s020110", "south", "s010110", 0),
        ("s020110", "west", "st", -100),
        ("s330110", "north", "st", -100),
        ("s000110", "south", "st", -100),
        ("s330110", "east", "st", 10),
        ("s020110", "sample", "st", -100),
        ("s311000", "sample", "s310000", 10),  # rock 0 at (3, 1), the most significant bit
        ("s310111", "sample", "s310111", -10),
        ("s100001", "sample", "s100000", 10),  # rock 3 at (1, 0), the least significant
        ("s020110", "check_2", "s020110", 0),
    ],
)
def test_outcomes(state, action, successor, reward):
    model = model_of("rocksample-4-4")
    a, s, s_next = model.action_names.index(action), at(model, state), at(model, successor)
    assert model.transitions[a][s, s_next] == 1
    assert model.rewards[a, s, 0, 0] == reward


@pytest.mark.parametrize(
    ("domain_id", "efficiency"),
    [("rocksample-4-4", lambda d: exp(-d)), ("rocksample-5-5", lambda d: 2 ** (-d / 4))],
)
def test_checks(domain_id, efficiency):
    """Rock 1 is at (2, 1) in [4,4] and at (0, 4) in [5,5]; the rover checks it from (0, 2)."""
    model = model_of(domain_id)
    k = len(model.state_names[0]) - 3
    distance = sqrt(5) if k == 4 else 2.0
    check = model.observations[model.action_names.index("check_1")]
    good, bad = at(model, "s02" + "01" + "0" * (k - 2)), at(model, "s02" + "0" * k)
    right = 0.5 * (1 + efficiency(distance))
    np.testing.assert_allclose(check[[good]].toarray().ravel(), [right, 1 - right], rtol=1e-15)
    np.testing.assert_allclose(check[[bad]].toarray().ravel(), [1 - right, right], rtol=1e-15)


def test_checks_on_the_spot_are_perfect_and_other_actions_see_good():
    model = model_of("rocksample-4-4")
    check_0 = model.observations[model.action_names.index("check_0")]
    assert check_0[at(model, "s311000"), 0] == 1
    assert check_0[at(model, "s310000"), 1] == 1
    for a in (NORTH, EAST, SOUTH, WEST, 8):
        assert (model.observations[a].toarray() == [1, 0]).all()
    assert (np.array([o[[256]].toarray().ravel() for o in model.observations]) == [1, 0]).all()


@pytest.mark.parametrize("domain_id", ["rocksample-4-4", "rocksample-5-5"])
def test_rewards_by_count(domain_id):
    model = model_of(domain_id)
    n, k = (4, 4) if domain_id == "rocksample-4-4" else (5, 5)
    M = 2**k
    values, counts = np.unique(model.rewards, return_counts=True)
    found = dict(zip(values.tolist(), counts.tolist(), strict=True))
    assert found[10.0] == n * M + k * M // 2  # the east edge, and every good rock
    assert found[-10.0] == k * M // 2
    assert found[-100.0] == 3 * n * M + (n * n - k) * M  # the other edges, and cells without a rock
    assert sum(found.values()) == model.n_actions * model.n_states
    assert all(T[:-1].nnz == model.n_states - 1 for T in model.transitions)  # one successor each


def test_any_instance_can_be_built():
    domain = rocksample(11, [(10, 10)], start=(3, 7))
    model = domain.model.joint
    assert domain.id == "rocksample-11-1"
    assert model.n_states == 243
    assert len(set(model.state_names)) == 243
    assert [model.state_names[s] for s in model.start.nonzero()[0]] == ["s3_7_0", "s3_7_1"]
    assert rocksample(2, []).model.joint.n_states == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 0, "rocks": ()}, "n must be at least 1"),
        ({"n": 2, "rocks": ((2, 0),)}, r"rock cell \(2, 0\) is outside the 2 x 2 grid"),
        ({"n": 2, "rocks": (), "start": (0, 5)}, r"start cell \(0, 5\) is outside"),
        ({"n": 2, "rocks": ((1, 0), (1, 0))}, "two rocks share a cell"),
        ({"n": 2, "rocks": (), "half_efficiency_distance": 0.0}, "is not positive"),
    ],
)
def test_bad_instances_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        rocksample(**arguments)


def test_pack_and_unpack_are_inverse():
    instance = RockSample(n=3, rocks=((0, 0), (1, 2)), start=(0, 1), half_efficiency_distance=1.0)
    assert [instance.pack(*instance.unpack(s)) for s in range(instance.terminal)] == list(range(36))
