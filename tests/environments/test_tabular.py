from __future__ import annotations

import dataclasses
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from bgn import domains
from bgn.environments.registration import environment_id as id_of
from bgn.environments.tabular import TableEnvironment
from bgn.pictures.maps import AGENT, CELL, WALL
from bgn.pomdp.belief import update

EAST, CHECK = 1, 4
TABLE_ENVIRONMENTS = {
    id_of(domain): domain.id for domain in map(domains.get, domains.ids()) if domain.family == "classic"
}
ALL = pytest.mark.parametrize("environment_id", TABLE_ENVIRONMENTS)


@ALL
def test_gymnasium_accepts_it_without_a_warning(environment_id):
    check_env(gymnasium.make(environment_id).unwrapped)  # pytest turns warnings into errors


@ALL
def test_the_step_limit_is_the_domains(environment_id):
    domain = domains.get(TABLE_ENVIRONMENTS[environment_id])
    assert gymnasium.spec(environment_id).max_episode_steps == domain.episode_limit


@ALL
@pytest.mark.parametrize("hidden", [True, False])
def test_belief_is_the_filters_and_believes_in_the_state(environment_id, hidden):
    env = gymnasium.make(environment_id, hidden_first_action=hidden)
    model = domains.get(TABLE_ENVIRONMENTS[environment_id]).model.joint
    env.action_space.seed(0)
    for episode in range(5):
        observation, info = env.reset(seed=episode)
        belief = model.start
        if hidden:
            belief = update(model, belief, info["last_action"], observation)
        else:
            assert (observation, info["last_action"]) == (model.n_observations, model.n_actions)
        for _ in range(20):
            np.testing.assert_array_equal(info["belief"], belief)
            assert info["belief"][info["state"]] > 0
            action = env.action_space.sample()
            observation, _, over, _, info = env.step(action)
            assert info["last_action"] == action
            if over:
                break
            belief = update(model, belief, action, observation, ended=False)


@ALL
def test_the_seed_decides_everything(environment_id):
    def play():
        env = gymnasium.make(environment_id)
        env.action_space.seed(1)
        yield env.reset(seed=7)
        for _ in range(150):
            *seen, terminated, truncated, info = env.step(env.action_space.sample())
            yield *seen, terminated, truncated, info
            if terminated or truncated:
                yield env.reset()

    for one, other in zip(play(), play(), strict=True):
        assert one[:-1] == other[:-1]
        np.testing.assert_equal(one[-1], other[-1])


def test_an_episode_ends_one_step_after_the_exit():
    env = gymnasium.make("bgn/RockSample44-v0", hidden_first_action=False)
    env.reset(seed=0)
    model = domains.get("rocksample-4-4").model.joint
    for reward, x in [(0.0, 1), (0.0, 2), (0.0, 3)]:
        _, got, terminated, truncated, info = env.step(EAST)
        assert (got, terminated, truncated) == (reward, False, False)
        assert model.state_names[info["state"]].startswith(f"s{x}2")
    observation, reward, terminated, _, info = env.step(EAST)
    assert (reward, terminated, info["state"]) == (10.0, False, 256)
    again, reward, terminated, truncated, last = env.step(CHECK)
    assert (again, reward, terminated, truncated) == (observation, 0.0, True, False)
    assert (last["state"], last["last_action"], last["belief"][256]) == (256, CHECK, 1.0)
    with pytest.raises(ResetNeeded):
        env.step(EAST)


def test_the_hidden_action_ends_two_ninths_of_the_episodes():
    env = gymnasium.make("bgn/RockSample44-v0").unwrapped
    env.reset(seed=0)
    episodes, over = 1_000, 0
    for _ in range(episodes):
        env.reset()
        _, reward, terminated, _, _ = env.step(CHECK)
        assert reward == 0
        over += terminated
    assert over / episodes == pytest.approx(2 / 9, abs=4 * np.sqrt(2 / 9 * 7 / 9 / episodes))


def test_the_step_limit_truncates_after_the_counted_steps():
    env = gymnasium.make("bgn/RockSample44-v0", hidden_first_action=False)
    env.reset(seed=0)
    flags = [env.step(CHECK)[2:4] for _ in range(100)]
    assert flags == [(False, False)] * 99 + [(False, True)]


def test_vector_environments_autoreset_on_the_next_step():
    envs = gymnasium.make_vec("bgn/RockSample44-v0", num_envs=2, hidden_first_action=False)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    _, info = envs.reset(seed=3)
    assert info["belief"].shape == (2, 257)
    for _ in range(4):
        envs.step(np.array([EAST, CHECK]))
    _, rewards, terminated, _, info = envs.step(np.array([EAST, CHECK]))
    assert terminated.tolist() == [True, False]
    assert info["state"][0] == 256
    observations, rewards, terminated, truncated, info = envs.step(np.array([EAST, CHECK]))
    assert (observations[0], rewards[0], terminated[0], truncated[0]) == (2, 0.0, False, False)
    np.testing.assert_array_equal(info["belief"][0], domains.get("rocksample-4-4").model.joint.start)


def test_a_truncated_lane_keeps_what_it_bootstraps_from():
    envs = gymnasium.make_vec("bgn/RockSample44-v0", num_envs=1, hidden_first_action=False)
    _, info = envs.reset(seed=3)
    for _ in range(100):
        before = info["belief"][0]
        observations, _, _, truncated, info = envs.step(np.array([CHECK]))
    model = domains.get("rocksample-4-4").model.joint
    assert truncated.tolist() == [True]
    np.testing.assert_array_equal(
        info["belief"][0], update(model, before, CHECK, observations[0], ended=False)
    )


def test_bad_use_is_refused():
    env = gymnasium.make("bgn/Hallway-v0").unwrapped
    with pytest.raises(ResetNeeded):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(InvalidAction, match=r"action 5 is not in 0\.\.4"):
        env.step(5)
    with pytest.raises(
        ValueError, match="no render mode 'human' for hallway; expected 'ansi' or 'rgb_array'"
    ):
        TableEnvironment("hallway", render_mode="human")
    with pytest.raises(ValueError, match="two-bumps-1d has an observed part"):
        TableEnvironment("two-bumps-1d")


@pytest.mark.parametrize(
    "environment_id", [i for i, d in TABLE_ENVIRONMENTS.items() if domains.get(d).layout]
)
def test_pictures(environment_id):
    env = gymnasium.make(environment_id, render_mode="rgb_array", hidden_first_action=False)
    env.reset(seed=2)
    picture = env.render()
    rows, columns = domains.get(TABLE_ENVIRONMENTS[environment_id]).layout.shape
    assert picture.shape == ((rows + 1) * CELL, (columns + 1) * CELL, 3)
    assert picture.dtype == np.uint8
    assert (picture[0, 0] == WALL).all()
    assert (picture == AGENT).all(axis=2).any()


def test_the_map_holds_the_whole_belief_in_the_right_place():
    layout, model = domains.get("hallway").layout, domains.get("hallway").model.joint
    marginal = layout.marginal(model.start)  # type: ignore[call-arg]
    assert marginal.shape == (2, 11, 4)
    assert marginal.sum() == pytest.approx(1)
    assert (marginal[layout.goal] == 0).all()
    facing_east = np.zeros(60)
    facing_east[4 * 11 + 1] = 1.0  # cell 11 is the first alcove, below cell 2
    assert np.argwhere(layout.marginal(facing_east)).tolist() == [[1, 2, 1]]  # type: ignore[call-arg]


def test_text():
    env = gymnasium.make("bgn/RockSample44-v0", render_mode="ansi", hidden_first_action=False)
    env.reset(seed=0)
    env.step(EAST)
    lines = env.render().splitlines()
    assert [line.translate(str.maketrans("ox", "RR")) for line in lines[:6]] == [
        "######",
        "# R  #",
        "# @  #",
        "#  RR#",
        "# R  #",
        "######",
    ]
    assert lines[6].endswith("after east, observing ogood; belief in the true state 0.062")


def test_a_domain_without_a_map_is_told_in_words(monkeypatch):
    domain = dataclasses.replace(domains.get("hallway"), layout=None)
    monkeypatch.setattr(domains.registry, "get", lambda _: domain)
    with pytest.raises(ValueError, match="no render mode 'rgb_array' for hallway; expected 'ansi'"):
        TableEnvironment("hallway", render_mode="rgb_array")
    env = TableEnvironment("hallway", render_mode="ansi", hidden_first_action=False)
    env.reset(seed=0)
    assert "after none, observing none; belief in the true state" in env.render()


def test_importing_the_package_is_cheap():
    heavy = ["torch", "mujoco", "numba", "pandas", "lark", "scipy", "matplotlib"]
    code = f"import bgn, sys; print([name for name in {heavy} if name in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_an_unknown_variant_is_refused_with_what_is_known():
    with pytest.raises(ValueError, match="hallway has no variant 'size'; known: none"):
        domains.get("hallway", size=3)
    with pytest.raises(
        domains.UnknownDomainError, match="unknown domain 'corridor'; known: hallway, hallway-2"
    ):
        domains.get("corridor")
