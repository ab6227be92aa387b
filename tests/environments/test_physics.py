from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env

from bgn.environments.physics import PhysicsEnvironment
from bgn.physics import RenderingUnavailableError
from bgn.policies.scripted import scripted_policy
from tests.pictures._graphics import needs_graphics

ALL = pytest.mark.parametrize("environment_id", ["bgn/TopPlate-v0", "bgn/TwoBumps1D-v0", "bgn/TwoBumps2D-v0"])


@ALL
def test_gymnasium_accepts_it_without_a_warning(environment_id):
    check_env(gymnasium.make(environment_id).unwrapped, skip_render_check=True)


def test_pictures():
    needs_graphics()
    env = gymnasium.make("bgn/TopPlate-v0", render_mode="rgb_array", width=64, height=48)
    check_env(env.unwrapped, skip_render_check=True)  # it would open a window, too
    env.reset(seed=0)
    before = env.render()
    env.step(1)
    assert before.shape == (48, 64, 3)
    assert before.dtype == np.uint8
    assert (before != env.render()).any()
    env.close()


@ALL
def test_the_seed_decides_everything(environment_id):
    def play():
        env = gymnasium.make(environment_id)
        env.action_space.seed(3)
        seen = [env.reset(seed=5)]
        for _ in range(12):
            seen.append(env.step(env.action_space.sample()))
            if seen[-1][2] or seen[-1][3]:
                seen.append(env.reset())
        return seen

    assert str(play()) == str(play())


@ALL
def test_info_says_what_training_may_use(environment_id):
    env = gymnasium.make(environment_id).unwrapped
    model = env.domain.model  # type: ignore[attr-defined]
    observation, info = env.reset(seed=1)
    assert info["last_action"] == model.joint.n_actions
    assert info["angle"] == 0
    for action in (1, 2, 0):
        assert info["state"] == info["observed"] * model.n_hidden + info["hidden"]
        assert model.joint.observations[0].indices[info["state"]] == observation
        assert info["belief"].shape == (model.n_hidden,)
        assert info["belief"].sum() == pytest.approx(1)
        assert info["belief"][info["hidden"]] > 0
        if env.domain.id == "top-plate" and action == 2:  # type: ignore[attr-defined]
            assert abs(info["angle"]) == pytest.approx(0.115, abs=1e-3)  # one plate up
            break
        observation, _, over, _, info = env.step(action)
        assert info["last_action"] == action
        if over:
            break


@ALL
def test_the_scripted_policy_earns_the_reward(environment_id):
    env = gymnasium.make(environment_id)
    policy = scripted_policy(env.unwrapped.domain)  # type: ignore[attr-defined]
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        policy.reset()
        total, over, action = 0.0, False, None
        while not over:
            action = policy.act(int(observation), action)
            observation, reward, ended, cut, _ = env.step(action)
            total, over = total + reward, ended or cut
        assert (total, cut) == (1.0, False)


@pytest.mark.parametrize(("variant", "limit"), [("paper", 50), ("authors", 100)])
def test_episodes_are_cut_at_the_limit_of_the_variant(variant, limit):
    env = gymnasium.make("bgn/TopPlate-v0", variant=variant)
    env.reset(seed=0)
    cuts = [env.step(0)[3] for _ in range(limit)]
    assert cuts == [False] * (limit - 1) + [True]
    with pytest.raises(ResetNeeded):
        env.step(0)


def test_vector_environment():
    envs = gymnasium.make_vec("bgn/TwoBumps1D-v0", num_envs=2, vectorization_mode="sync")
    observations, info = envs.reset(seed=0)
    assert observations.shape == (2,)
    assert np.stack(info["belief"]).shape == (2, 39)
    envs.close()


def test_clear_errors(monkeypatch):
    with pytest.raises(ValueError, match="unknown variant 'new'"):
        PhysicsEnvironment("top-plate", variant="new")
    with pytest.raises(ValueError, match="'hallway' has no physics"):
        PhysicsEnvironment("hallway")
    with pytest.raises(ValueError, match="no render mode 'ansi'; expected 'rgb_array' or 'human'"):
        PhysicsEnvironment("top-plate", render_mode="ansi")
    env = PhysicsEnvironment("top-plate")
    with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
        env.step(np.int64(0))
    env.reset(seed=0)
    with pytest.raises(InvalidAction, match=r"not in 0\.\.2"):
        env.step(np.int64(3))
    assert env.render() is None


def test_a_window_without_a_screen_is_a_clear_error(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    env = PhysicsEnvironment("top-plate", render_mode="human")
    with pytest.raises(RenderingUnavailableError, match="needs a screen, but neither DISPLAY nor"):
        env.reset(seed=0)


def test_missing_graphics_is_a_clear_error(monkeypatch):
    def fail(*args):
        raise AttributeError("'NoneType' object has no attribute 'glGetError'")

    monkeypatch.setattr("mujoco.Renderer", fail)
    env = PhysicsEnvironment("top-plate", render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(RenderingUnavailableError, match=r"no OpenGL by .*glGetError.*libegl1"):
        env.render()
