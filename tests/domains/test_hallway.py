from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import breadth_first_order

from bgn import domains
from bgn.domains import grid_navigation as grid
from bgn.domains.hallway import MAP
from bgn.domains.hallway2 import MAP as MAP2

N, E, S, W = range(4)
STAY, FORWARD, RIGHT, AROUND, LEFT = range(5)

BOTH = pytest.mark.parametrize("domain_id", ["hallway", "hallway-2"])


def model_of(domain_id):
    return domains.get(domain_id).model.joint


@pytest.mark.parametrize(
    ("domain_id", "sizes", "goal"), [("hallway", (60, 5, 21), 14), ("hallway-2", (92, 5, 17), 17)]
)
def test_sizes_start_reset_and_rewards(domain_id, sizes, goal):
    domain = domains.get(domain_id)
    model = domain.model.joint
    T, _, R = model.dense()
    goals = slice(4 * goal, 4 * goal + 4)
    assert (model.n_states, model.n_actions, model.n_observations) == sizes
    assert (domain.model.n_observed, domain.model.n_hidden) == (1, sizes[0])
    assert (domain.episode_limit, domain.report_discount, domain.hidden_first_action) == (100, 0.95, True)
    start = np.full(sizes[0], 1 / (sizes[0] - 4))
    start[goals] = 0
    np.testing.assert_array_equal(model.start, start)
    assert model.reset[:, goals].all()
    assert model.reset.sum() == 20
    np.testing.assert_array_equal(T[:, goals], np.broadcast_to(start, (5, 4, sizes[0])))
    assert (R[:, :, goals] == 1).all()
    assert R.sum() == 5 * sizes[0] * 4 * sizes[2]


@BOTH
def test_turns_stay_in_the_cell(domain_id):
    T, _, _ = model_of(domain_id).dense()
    np.testing.assert_array_equal(T[STAY, :8, :8], np.eye(8))
    np.testing.assert_array_equal(T[RIGHT, 4 + E, 4:8], [0.1, 0.1, 0.7, 0.1])
    np.testing.assert_array_equal(T[AROUND, 4 + E, 4:8], [0.15, 0.1, 0.15, 0.6])
    np.testing.assert_array_equal(T[LEFT, 4 + E, 4:8], [0.7, 0.1, 0.1, 0.1])


@pytest.mark.parametrize(
    ("state", "successors"),
    [
        # The west end of the corridor: only the east is open.
        (4 * 0 + N, {4 * 0 + N: 0.95, 4 * 1 + E: 0.05}),
        (4 * 0 + E, {4 * 1 + E: 0.8, 4 * 0 + E: 0.2}),
        (4 * 0 + W, {4 * 1 + W: 0.025, 4 * 1 + E: 0.025, 4 * 0 + W: 0.95}),
        # Above the goal, facing it; east, west and south are open.
        (4 * 8 + S, {4 * 14 + S: 0.8, 4 * 9 + E: 0.05, 4 * 7 + W: 0.05, 4 * 8 + S: 0.1}),
        # Above the goal, facing east: the goal is on the right.
        (4 * 8 + E, {4 * 9 + E: 0.8, 4 * 14 + S: 0.05, 4 * 7 + E: 0.025, 4 * 7 + W: 0.025, 4 * 8 + E: 0.1}),
    ],
)
def test_forward_in_hallway(state, successors):
    T, _, _ = model_of("hallway").dense()
    assert {int(s): T[FORWARD, state, s] for s in T[FORWARD, state].nonzero()[0]} == successors


def test_forward_in_hallway2():
    """Cell 5 of the second row is open to the east and, by cells 0 and 12, nowhere else but north-south."""
    T, _, _ = model_of("hallway-2").dense()
    assert MAP2.cells[5:7] == ((1, 0), (1, 1))
    assert {int(s): T[FORWARD, 20 + N, s] for s in T[FORWARD, 20 + N].nonzero()[0]} == {
        4 * 5 + N: 0.95,
        4 * 6 + E: 0.05,
    }


@BOTH
def test_wall_patterns(domain_id):
    """Hallway's cell 0 has walls but to the east; Hallway-2's is open to the south too."""
    _, O, _ = model_of(domain_id).dense()
    seen = O[FORWARD, 4 * 0 + N]
    wall, miss, alarm, clear = 0.9, 0.1, 0.05, 0.95
    back, no_back = (wall, miss) if domain_id == "hallway" else (alarm, clear)
    assert seen[0b1011] == pytest.approx(wall * clear * back * wall, rel=1e-12)
    assert seen[0b1001] == pytest.approx(wall * clear * no_back * wall, rel=1e-12)
    assert seen[0b0100] == pytest.approx(miss * alarm * no_back * miss, rel=1e-12)
    assert seen[16:].sum() == 0
    assert (O[0] == O).all()


def test_landmarks_are_seen_with_certainty_above_an_alcove():
    model = model_of("hallway")
    _, O, _ = model.dense()
    certain = {int(s): int(O[0, s].argmax()) for s in np.argwhere(O[0].max(axis=1) == 1).ravel()}
    goals = dict.fromkeys(range(56, 60), 20)
    assert certain == {4 * 2 + S: 16, 4 * 4 + S: 17, 4 * 6 + S: 18, 4 * 8 + S: 19, **goals}
    assert model.observation_names[16:] == ("landmark0", "landmark1", "landmark2", "landmark3", "goal")
    assert model.observation_names[0b1011] == "wall-FBL"


def test_hallway2_has_no_landmark():
    _, O, _ = model_of("hallway-2").dense()
    assert np.argwhere(O[0].max(axis=1) == 1).ravel().tolist() == [68, 69, 70, 71]
    assert (O[0, 68:72, 16] == 1).all()


@pytest.mark.parametrize(("domain_id", "reachable"), [("hallway", 58), ("hallway-2", 90)])
def test_reachable_states(domain_id, reachable):
    """The goal alcove has one open side: its four headings are not all reached."""
    model = model_of(domain_id)
    anywhere = sum(model.transitions)
    reached = {
        int(s)
        for first in model.start.nonzero()[0]
        for s in breadth_first_order(anywhere, first, return_predecessors=False)
    }
    assert len(reached) == reachable


def test_the_map():
    assert len(MAP.cells) == 15
    assert MAP.cells[MAP.goal] == (1, 8)
    assert MAP.neighbour(8, S) == 14
    assert MAP.neighbour(14, N) == 8
    assert MAP.neighbour(0, N) is None
    assert MAP.neighbour(10, E) is None
    assert len(MAP2.cells) == 23
    assert MAP2.cells[MAP2.goal] == (3, 6)
    assert sum(p for _, p in grid.DRIFT) + grid.NO_MOTION == pytest.approx(1)
