"""Physics against the tables, beliefs against brute force, scripted policies, determinism, clear errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bgn import domains
from bgn.domains import two_bumps_1d, two_bumps_2d
from bgn.physics.tasks import task_of
from bgn.physics.world import PhysicsWorld, evaluate_in_physics, play
from bgn.policies.scripted import scripted_policy
from bgn.policies.uniform import RandomPolicy
from tests.domains._definitions import definition
from tests.physics._replay import compare_with_table

ROBOTS = ("top-plate", "two-bumps-1d", "two-bumps-2d")


@pytest.mark.parametrize("name", ROBOTS)
def test_physics_replays_the_table(name):
    comparison = compare_with_table(domains.get(name), steps=2000, seed=1)
    assert comparison.violations == 0
    assert comparison.pairs > 250


@pytest.mark.parametrize("name", ROBOTS)
def test_physics_replays_the_authors_table(name):
    assert compare_with_table(domains.get(name, variant="authors"), steps=100, seed=2).violations == 0


def test_a_wrong_table_is_noticed():
    domain = domains.get("top-plate")
    joint = domain.model.joint
    swapped = dataclasses.replace(
        joint, transitions=(joint.transitions[1], joint.transitions[0], joint.transitions[2])
    )
    wrong = dataclasses.replace(domain, model=type(domain.model)(swapped, domain.model.n_observed))
    assert compare_with_table(wrong, steps=30, seed=0).violations > 5


@pytest.mark.parametrize("name", ROBOTS)
def test_scripted_policy_always_succeeds_in_physics(name):
    result = evaluate_in_physics(name, scripted_policy(domains.get(name)), episodes=25, seed=3)
    assert (result["success"], result["success_se"], result["episodes"]) == (1.0, 0.0, 25)


def test_evaluation_reports_the_binomial_error():
    result = evaluate_in_physics("top-plate", RandomPolicy(domains.get("top-plate")), episodes=60, seed=5)
    p = result["success"]
    assert p == pytest.approx(0.0382, abs=4 * np.sqrt(0.0382 * 0.9618 / 60))
    assert result["success_se"] == pytest.approx(np.sqrt(p * (1 - p) / 60))
    assert 2 < result["length"] < 4  # a grasp is one action of three


def test_evaluation_is_a_function_of_the_seed():
    domain = domains.get("two-bumps-2d")
    first, again, other = (
        evaluate_in_physics("two-bumps-2d", RandomPolicy(domain), episodes=8, seed=seed) for seed in (7, 7, 8)
    )
    assert first == again
    assert first != other


def hidden_parts_consistent(name, x0, history):
    """Every hidden part that starts at x0 and follows the same readings, by the definition of the domain."""
    moves, pushed = definition(name)
    parts = range(moves.shape[2])
    if name == "top-plate":
        parts = range(1, 11)
    pairs = {"two-bumps-1d": two_bumps_1d.PAIRS, "two-bumps-2d": two_bumps_2d.PAIRS}.get(name)
    bins = {"two-bumps-2d": 5}.get(name, 3)
    for part in parts:
        reading = x0
        if pairs and x0 // bins in pairs[part]:
            continue
        for action, after in history:
            if pushed[reading, action, part] or moves[reading, action, part] != after:
                break
            reading = after
        else:
            yield part


@pytest.mark.parametrize("name", ROBOTS)
def test_belief_equals_brute_force_enumeration(name):
    domain = domains.get(name)
    world, rng = PhysicsWorld(domain), np.random.default_rng(11)
    grasp = {"top-plate": 1, "two-bumps-2d": 1}.get(name, 0)
    for _ in range(4):
        state = world.reset(rng)
        x0, history = state.observation, []
        for _ in range(12):
            action = int(rng.integers(domain.model.joint.n_actions - grasp))
            state = world.step(action)
            if state.ended:
                break
            history.append((action, state.observation))
            expected = np.zeros(domain.model.n_hidden)
            offset = 1 if name == "top-plate" else 0
            expected[[part - offset for part in hidden_parts_consistent(name, x0, history)]] = 1
            np.testing.assert_allclose(state.belief, expected / expected.sum(), atol=1e-12)


def test_elimination_belief_is_wider_than_the_exact_one():
    exact, authors = (PhysicsWorld(domains.get("two-bumps-2d", variant=v)) for v in ("paper", "authors"))
    starts = np.random.default_rng(0)
    wider = 0
    for _ in range(5):
        x, y = divmod(int(starts.choice(np.flatnonzero(exact.domain.model.joint.start))), 192)
        exact.reset_to(x, y)
        authors.reset_to(x, y)
        for action in starts.integers(4, size=10):
            one, other = exact.step(int(action)), authors.step(int(action))
            assert one.x == other.x
            assert other.belief[y] > 0
            assert ((other.belief > 0) | (one.belief == 0)).all()
            wider += (other.belief > 0).sum() > (one.belief > 0).sum()
    assert wider > 10


def test_authors_start_belief_holds_an_impossible_height():
    world = PhysicsWorld(domains.get("top-plate", variant="authors"))
    state = world.reset_to(1, 5)
    np.testing.assert_allclose(state.belief, [0, *[1 / 6] * 6, 0])
    for _ in range(5):
        state = world.step(1)
    np.testing.assert_allclose(state.belief, [0, 0, 0, 0, 0, 0.5, 0.5, 0])  # five plates felt: 5 or 6


@pytest.mark.parametrize("name", ROBOTS)
def test_restored_physics_continues_bit_for_bit(name):
    scene, fresh = task_of(name).scene(), task_of(name).scene()
    hidden = scene.hidden_parts()[7]
    scene.reset(hidden, scene.starts(hidden)[0])
    actions = np.random.default_rng(0).integers(scene.actions, size=8)
    for action in actions[:3]:
        scene.act(int(action))
    snapshot = scene.save()
    straight = [scene.act(int(action)) for action in actions[3:]]
    fresh.restore(snapshot)
    assert [fresh.act(int(action)) for action in actions[3:]] == straight


def test_watching_a_move_does_not_change_it():
    plain, watched = task_of("two-bumps-1d").scene(), task_of("two-bumps-1d").scene()
    seen = []
    watched.observer = lambda: seen.append(watched.data.time)
    for scene in (plain, watched):
        scene.reset(20, 0)
    for _ in range(6):
        assert plain.act(2) == watched.act(2)
    assert len(seen) == 6 * 25 + 5  # every 20 ms of six moves and of the settling at the start


@pytest.mark.parametrize("name", ROBOTS)
def test_finger_angles_are_those_of_the_geometry(name):
    scene = task_of(name).scene()
    contact = {"two-bumps-2d": 0.2543}.get(name, scene.angle_gaps[-1])
    angles = []
    for hidden in scene.hidden_parts()[1:8:3]:
        scene.reset(hidden, scene.starts(hidden)[0])
        angles += [abs(scene.act(a).angle) for a in [1 if name != "two-bumps-1d" else 2] * 3]
    touching = [angle for angle in angles if angle > 0.2 or (name != "two-bumps-2d" and angle > 0.05)]
    np.testing.assert_allclose(touching, contact, atol=5e-3)


def test_steps_outside_an_episode_are_errors():
    world = PhysicsWorld(domains.get("top-plate"))
    with pytest.raises(RuntimeError, match=r"reset\(\) must be called"):
        world.step(0)
    world.reset_to(1, 0)
    with pytest.raises(ValueError, match=r"action 3 is not in 0\.\.2"):
        world.step(3)
    assert world.step(2).ended
    with pytest.raises(RuntimeError, match="the episode is over"):
        world.step(0)


def test_episodes_are_cut_at_the_limit():
    domain = domains.get("top-plate")

    class Waits(RandomPolicy):
        def act(self, observation, last_action):
            return 0  # refused at level 0, without end

    assert play(domain, PhysicsWorld(domain).task, Waits(domain), np.random.default_rng(0)) == (False, 50)
    world = PhysicsWorld(domain)
    world.reset_to(1, 0)
    states = [world.step(0) for _ in range(50)]
    assert [state.truncated for state in states] == [False] * 49 + [True]


def test_clear_errors():
    with pytest.raises(ValueError, match="'hallway' has no physics; those that have: top-plate"):
        PhysicsWorld(domains.get("hallway"))
    with pytest.raises(ValueError, match="episodes >= 1, not 0"):
        evaluate_in_physics("top-plate", RandomPolicy(domains.get("top-plate")), episodes=0, seed=0)
    with pytest.raises(ValueError, match="no scripted policy for 'hallway'"):
        scripted_policy(domains.get("hallway"))
