import numpy as np
import pytest

from bgn.planning.episodic import start_beliefs, without_resets, worthless_states
from tests.planning.models import corridor, guess, pomdp, random_model, tiger


def chain():
    """Three states in a row; the last pays on arrival, and only resets."""
    T = [[[0, 1, 0], [0, 0, 1], [1, 0, 0]]]
    O = [[[1, 0], [0, 1], [0, 1]]]
    return pomdp(T, O, [[0, 5, 0]], start=[1, 0, 0], discount=0.9, reset=[[False, False, True]])


def test_a_clean_start_is_the_start_distribution():
    (start,) = start_beliefs(tiger(), "clean")
    assert start.weight == pytest.approx(1)
    assert start.belief.tolist() == [0.5, 0.5]


def test_a_hidden_first_action_splits_the_start_by_action_and_observation():
    # Of three actions only listening tells anything: 1/3 · 1/2 for each of six openings.
    starts = start_beliefs(tiger(), "hidden-first-action")
    assert [s.seen for s in starts] == [0, 1, 2, 3, 4, 5]
    assert [s.weight for s in starts] == pytest.approx([1 / 6] * 6)
    assert starts[0].belief == pytest.approx([0.85, 0.15])
    assert starts[1].belief == pytest.approx([0.15, 0.85])
    assert starts[4].belief == pytest.approx([0.5, 0.5])


def test_impossible_openings_are_left_out():
    starts = start_beliefs(chain(), "hidden-first-action")
    assert [(s.seen, s.belief.tolist()) for s in starts] == [(1, [0, 1, 0])]


def test_a_mixed_observability_model_shows_its_first_x():
    model = corridor(3)
    (start,) = start_beliefs(model)
    assert (start.seen, start.weight) == (0, pytest.approx(1))
    assert start.belief[:3] == pytest.approx([0, 0.5, 0.5])
    with pytest.raises(ValueError, match="no hidden first action"):
        start_beliefs(model, "hidden-first-action")


def test_an_unknown_convention_is_refused():
    with pytest.raises(ValueError, match="known: clean, hidden-first-action"):
        start_beliefs(tiger(), "dirty")


def test_worthless_states_are_those_from_which_nothing_is_earned():
    assert worthless_states(chain()).tolist() == [False, False, True]
    assert not worthless_states(tiger()).any()


def test_a_reset_state_becomes_absorbing():
    absorbing = without_resets(chain())
    assert not absorbing.reset.any()
    assert absorbing.n_states == 3
    assert absorbing.transitions[0].toarray()[2].tolist() == [0, 0, 1]
    assert absorbing.expected_rewards.tolist() == [[0, 5, 0]]


def test_resets_of_some_actions_lead_to_an_added_end():
    absorbing = without_resets(guess())
    assert absorbing.state_names == ("s0", "s1", "end")
    assert absorbing.observation_names == ("o0", "o1", "end")
    T, O, _ = absorbing.dense()
    assert T[1].tolist() == [[0, 0, 1]] * 3
    assert T[0].tolist() == np.eye(3).tolist()
    assert (O[:, 2] == [0, 0, 1]).all()
    assert absorbing.expected_rewards == pytest.approx(np.array([[-0.1, -0.1, 0], [1, 0, 0], [0, 1, 0]]))


@pytest.mark.parametrize("seed", range(5))
def test_values_of_a_fixed_action_survive_the_conversion(seed):
    model = random_model(seed, resets=True)
    absorbing = without_resets(model)
    for a in range(model.n_actions):
        goes_on = np.where(model.reset[a][:, None], 0, model.transitions[a].toarray())
        expected = np.linalg.solve(np.eye(4) - 0.5 * goes_on, model.expected_rewards[a])
        n = absorbing.n_states
        found = np.linalg.solve(
            np.eye(n) - 0.5 * absorbing.transitions[a].toarray(), absorbing.expected_rewards[a]
        )
        assert found[:4] == pytest.approx(expected)
