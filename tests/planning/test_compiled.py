import numpy as np
import pytest

from bgn import domains
from bgn.planning.compiled import compile_model, restrict
from bgn.planning.episodic import start_beliefs
from tests.planning.models import corridor, guess, random_model, tiger


def compiled(model, convention="clean"):
    return compile_model(getattr(model, "joint", model), start_beliefs(model, convention))


@pytest.mark.parametrize(
    ("name", "n_classes", "n_live"), [("rocksample-4-4", 16, 256), ("rocksample-5-5", 25, 800)]
)
def test_rocksample_falls_into_cells(name, n_classes, n_live):
    model = compiled(domains.get(name).model)
    assert (model.n_classes, model.n_live) == (n_classes, n_live)
    assert np.diff(model.class_first).tolist() == [n_live // n_classes] * n_classes
    qualities = n_live // n_classes
    for c in range(n_classes):
        cells = model.states[model.class_first[c] : model.class_first[c + 1]] // qualities
        assert np.unique(cells).size == 1


def test_hallway_is_one_class_without_its_goal():
    model = compiled(domains.get("hallway").model)
    assert model.n_classes == 1
    assert sorted(model.states) == list(range(56))


def test_what_is_observed_separates_the_classes():
    model = corridor(4)
    compact = compiled(model)
    # The goal's place is known once felt, unknown among up to three places else.
    assert np.diff(compact.class_first).max() == 3
    for c in range(compact.n_classes):
        states = compact.states[compact.class_first[c] : compact.class_first[c + 1]]
        assert np.unique(states // model.n_hidden).size == 1


@pytest.mark.parametrize("model", [tiger(), guess(), random_model(1), random_model(2, resets=True)])
def test_branches_hold_all_that_may_follow(model):
    compact = compiled(model)
    dense_T, dense_O, _ = model.dense()
    assert compact.n_classes == 1
    for a in range(model.n_actions):
        rows = slice(compact.branch_first[a], compact.branch_first[a + 1])
        seen = np.zeros((compact.n_live, model.n_observations))
        for o, at in zip(compact.branch_observation[rows], compact.branch_at[rows], strict=True):
            seen[:, o] = compact.o_p[at : at + compact.n_live]
        goes_on = np.where(model.reset[a][:, None], 0, dense_T[a])
        moved = goes_on[np.ix_(compact.states, compact.states)]
        reached = moved.any(axis=0)
        assert seen[reached] == pytest.approx(dense_O[a][compact.states][reached])
        found = np.zeros_like(moved)
        for s in range(compact.n_live):
            for e in range(compact.t_first[a, s], compact.t_first[a, s + 1]):
                found[s, compact.t_to[e]] = compact.t_p[e]
        assert found == pytest.approx(moved)


def test_restricting_a_belief_keeps_its_live_mass():
    domain = domains.get("hallway")
    compact = compiled(domain.model)
    belief = np.zeros(60)
    belief[[3, 58]] = 0.25, 0.75
    c, inside, mass = restrict(compact, belief)
    assert (c, mass) == (0, 0.25)
    assert compact.states[inside.argmax()] == 3
    assert inside.sum() == pytest.approx(1)
    belief[3] = 0
    assert restrict(compact, belief)[0] == -1
