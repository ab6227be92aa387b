from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse, stats

from bgn import domains
from bgn.simulation.compiled_tables import MAX_LISTED_PREDECESSORS
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld
from tests.pomdp._models import random_model
from tests.simulation._reference import Checker, domain_of

seeds = st.integers(0, 2**32 - 1)

VARIANTS = [
    *((domain_id, {}) for domain_id in domains.ids()),
    *((domain_id, {"variant": "authors"}) for domain_id in ("top-plate", "two-bumps-1d", "two-bumps-2d")),
    ("top-plate", {"plates": 3}),
]
NAMES = ["/".join([domain_id, *map(str, variant.values())]) for domain_id, variant in VARIANTS]  # type: ignore[attr-defined]


def random_actions(world, rng):
    return torch.from_numpy(rng.integers(world.tables.n_actions, size=world.lanes))


def check_randomly(domain, seed, *, lanes=2, steps=16, **options):
    world = TableWorld(domain, lanes, **options)
    checker, rng = Checker(world, seed), np.random.default_rng(seed)
    for _ in range(steps):
        checker.step(random_actions(world, rng))
    return world


@settings(max_examples=30, deadline=None)
@given(seeds, st.booleans(), st.integers(1, 8))
def test_random_pomdps_equal_the_reference(seed, hidden_first_action, limit):
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(2, 7)), int(rng.integers(1, 4)), int(rng.integers(1, 5)))
    if hidden_first_action:  # an episode that cannot end before it is seen, as in all such domains
        model = replace(model, reset=model.reset & (model.start == 0))
    domain = domain_of(model, limit=limit, hidden_first_action=hidden_first_action)
    check_randomly(domain, seed)


@settings(max_examples=30, deadline=None)
@given(seeds, st.booleans())
def test_random_momdps_equal_the_reference(seed, observes_x):
    """Several successors within and across x; readings that are drawn, or are a function of x'."""
    rng = np.random.default_rng(seed)
    X, Y, A = 3, int(rng.integers(1, 5)), 2
    model = random_model(rng, X * Y, A, 4)
    if observes_x:
        readings = np.eye(4)[np.repeat(rng.integers(4, size=X), Y)]
        model = replace(model, observations=(sparse.csr_array(readings),) * A)
    world = check_randomly(domain_of(model, X), seed)
    assert (world.tables.sensing.of_observed is not None) or not observes_x


def test_an_observation_that_depends_on_y_is_not_taken_for_a_function_of_x():
    model = random_model(np.random.default_rng(0), 4, 1, 4)
    model = replace(model, observations=(sparse.csr_array(np.eye(4)),))
    world = check_randomly(domain_of(model, 2), 0)
    assert world.tables.sensing.of_observed is None


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_hubs_are_filtered_exactly(seed):
    """States with more predecessors than are listed; the others keep their lists."""
    rng = np.random.default_rng(seed)
    S, hubs = MAX_LISTED_PREDECESSORS + 8, [2, 9]
    model = random_model(rng, S, 2, 2)
    T = np.zeros((2, S, S))
    T[:, np.arange(S), (np.arange(S) + 1) % S] = 0.5
    T[0][:, hubs] += 0.25
    T[1][:, np.arange(S)] += np.eye(S) / 2
    model = replace(model, transitions=tuple(sparse.csr_array(t) for t in T), reset=model.reset & False)
    world = check_randomly(domain_of(model), seed)
    assert world.tables.filter.hubs is not None
    assert world.tables.filter.hubs.tolist() == hubs
    assert world.tables.filter.listed == 2


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_prior_and_elimination_replace_the_exact_belief(seed):
    rng = np.random.default_rng(seed)
    X, Y = 2, 4
    model = random_model(rng, X * Y, 2, 3)
    prior, keep = rng.random((X, Y)), rng.random((X, Y)) < 0.8
    keep[:, 0] = True
    check_randomly(domain_of(model, X, prior=prior / prior.sum(1, keepdims=True), elimination=keep), seed)


@pytest.mark.parametrize(("domain_id", "variant"), VARIANTS, ids=NAMES)
def test_domains_equal_the_reference(domain_id, variant):
    """Lanes that act at random, and lanes that avoid the end and so reach the episode limit."""
    domain = domains.get(domain_id, **variant)
    joint = domain.model.joint
    world = TableWorld(domain, 4)
    checker, rng = Checker(world, 5), np.random.default_rng(5)
    longest = 0
    for _ in range(domain.episode_limit + 3):
        actions = random_actions(world, rng)
        for lane in (2, 3):
            s = int(world.inputs.state[lane])
            going_on = np.flatnonzero(~joint.reset[:, s])
            # A MOMDP's impossible joint states may end at once; the sampler never shows them.
            actions[lane] = int(rng.choice(going_on)) if len(going_on) else 0
        checker.step(actions)
        longest = max(longest, int(checker.steps.max()))
    assert longest >= domain.episode_limit - 1 or domain.family == "classic"


@pytest.mark.parametrize("domain_id", [d for d in domains.ids() if domains.get(d).hidden_first_action])
def test_classic_domains_can_start_clean(domain_id):
    world = check_randomly(domains.get(domain_id), 1, steps=8, hidden_first_action=False)
    assert not world.hidden_first_action
    assert TableWorld(domains.get(domain_id), 1).hidden_first_action


def test_no_domain_opens_with_a_hidden_action_unless_it_says_so():
    world = TableWorld(domains.get("top-plate"), 2, hidden_first_action=True)
    assert not world.hidden_first_action
    model = random_model(np.random.default_rng(0), 4, 1, 1)
    with pytest.raises(ValueError, match="without an observed part"):
        TableWorld(domain_of(model, 2, hidden_first_action=True), 1)


def test_hallway_is_cut_after_exactly_a_hundred_counted_steps():
    domain = domains.get("hallway")
    world = TableWorld(domain, 1, hidden_first_action=False)
    world.reset(torch.zeros(1, START_VARIATES))
    cut = []
    for step in range(1, 251):
        openings = world.openings(torch.zeros(1, START_VARIATES))
        outcome = world.step(torch.zeros(1, dtype=torch.int64), torch.zeros(1, STEP_VARIATES), openings)
        assert not outcome.ended
        cut += [step] * int(outcome.truncated)
    assert cut == [100, 200]


@pytest.mark.parametrize(("domain_id", "variant"), VARIANTS, ids=NAMES)
@pytest.mark.parametrize("u", [0.0, float(np.nextafter(np.float32(1), np.float32(0)))])
def test_extreme_variates_give_possible_outcomes(domain_id, variant, u, monkeypatch):
    domain = domains.get(domain_id, **variant)
    world = TableWorld(domain, domain.model.joint.n_actions)
    monkeypatch.setattr(Checker, "uniform", lambda self, width: torch.full((self.world.lanes, width), u))
    checker = Checker(world, 0)
    for _ in range(12):
        checker.step(torch.arange(world.lanes))


def test_without_beliefs_everything_else_is_the_same():
    domain = domains.get("rocksample-4-4")
    with_beliefs, without = (TableWorld(domain, 8, track_beliefs=track) for track in (True, False))
    generator = torch.Generator().manual_seed(0)
    start = torch.rand(8, START_VARIATES, generator=generator)
    for world in (with_beliefs, without):
        world.reset(start)
    for _ in range(30):
        action = torch.randint(9, (8,), generator=generator)
        variates, opening = (torch.rand(8, n, generator=generator) for n in (STEP_VARIATES, START_VARIATES))
        one, other = (w.step(action, variates, w.openings(opening)) for w in (with_beliefs, without))
        assert torch.equal(one.reward, other.reward)
        for name in ("observation", "last_action", "observed", "state", "fresh"):
            assert torch.equal(getattr(with_beliefs.inputs, name), getattr(without.inputs, name)), name
    assert without.inputs.belief.shape == (8, 1)


def chi_square(groups, outcomes, distribution):
    """p-value of outcomes (N,) given groups (N,), pooled; distribution(group) is their law."""
    statistic, freedom = 0.0, 0
    for group in np.unique(groups):
        p = distribution(group)
        seen = np.bincount(outcomes[groups == group], minlength=len(p))
        assert not seen[p == 0].any()
        order = np.argsort(p)
        n, p = seen[order], p[order]
        rare = p * n.sum() < 5  # pooled into one cell
        n, p = np.append(n[~rare], n[rare].sum()), np.append(p[~rare], p[rare].sum())
        possible = p > 1e-12
        if (n.sum() * p[possible] < 1).any() or possible.sum() < 2:
            continue
        statistic += ((n - n.sum() * p)[possible] ** 2 / (n.sum() * p[possible])).sum()
        freedom += possible.sum() - 1
    assert freedom > 0
    return stats.chi2.sf(statistic, freedom)


@pytest.mark.parametrize("domain_id", ["hallway", "rocksample-4-4", "random", "two-bumps-1d"])
def test_frequencies_are_the_models(domain_id):
    model = random_model(np.random.default_rng(4), 6, 3, 4)
    domain = domain_of(model) if domain_id == "random" else domains.get(domain_id)
    joint, A = domain.model.joint, domain.model.joint.n_actions
    generator, n = torch.Generator().manual_seed(11), 40_000
    world = TableWorld(domain, n, hidden_first_action=False, track_beliefs=False)
    start = world.reset(torch.rand(n, START_VARIATES, generator=generator)).state.numpy()
    assert chi_square(np.zeros(n, int), start, lambda _: joint.start) > 1e-3
    action = torch.randint(A, (n,), generator=generator)
    openings = world.openings(torch.rand(n, START_VARIATES, generator=generator))
    outcome = world.step(action, torch.rand(n, STEP_VARIATES, generator=generator), openings)
    a, s_next, o = action.numpy(), outcome.arrival.state.numpy(), outcome.arrival.observation.numpy()
    live = ~joint.reset[a, start]
    pair = start * A + a
    if domain_id in ("hallway", "random"):  # the others move with certainty

        def successors(k):
            return joint.transitions[k % A][[k // A]].toarray()[0]

        assert chi_square(pair[live], s_next[live], successors) > 1e-3
    if domain_id != "two-bumps-1d":

        def readings(k):
            return joint.observations[k % A][[k // A]].toarray()[0]

        assert chi_square((s_next * A + a)[live], o[live], readings) > 1e-3


def test_the_hidden_first_action_is_uniform_and_its_outcome_the_models():
    domain = domains.get("rocksample-4-4")
    n, joint = 40_000, domain.model.joint
    world = TableWorld(domain, n, track_beliefs=False)
    first = world.reset(torch.rand(n, START_VARIATES, generator=torch.Generator().manual_seed(2)))
    action, state = first.last_action.numpy(), first.state.numpy()
    assert chi_square(np.zeros(n, int), action, lambda _: np.full(9, 1 / 9)) > 1e-3
    assert chi_square(action, state, lambda a: joint.start @ joint.transitions[a]) > 1e-3
    key = state * 9 + action

    def readings(k):
        return joint.observations[k % 9][[k // 9]].toarray()[0]

    assert chi_square(key, first.observation.numpy(), readings) > 1e-3
    # From (0, 2), going west and sampling (there is no rock) kill: two actions of nine.
    assert (state == joint.n_states - 1).mean() == pytest.approx(2 / 9, abs=0.01)
