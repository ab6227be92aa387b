"""The arm's environment shows a policy what the simulated one shows it, and nothing of the belief."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded

from bgn import domains
from bgn.domains import two_bumps_1d
from bgn.environments.physics import PhysicsEnvironment
from bgn.policies.scripted import scripted_policy
from bgn.robot import lab
from bgn.robot.environment import ArmEnvironment
from bgn.robot.errors import BaselineError
from bgn.robot.twin.direct import direct_finger

LAB = lab.load()


@pytest.mark.parametrize("task", ["top-plate", "two-bumps-1d", "two-bumps-2d"])
def test_a_policy_sees_the_same_in_simulation_and_on_the_twin(task: str) -> None:
    domain = domains.get(task)
    simulated = PhysicsEnvironment(task)
    finger, _ = direct_finger(LAB, task)
    arm = ArmEnvironment(domain, finger)
    assert (arm.observation_space, arm.action_space) == (simulated.observation_space, simulated.action_space)
    policy = scripted_policy(domain)
    for seed in (1, 2):
        seen, information = simulated.reset(seed=seed)
        start = information["observed"], information["hidden"]
        here, told = arm.reset(options={"start": start})
        assert here == seen
        policy.reset()
        action, over = None, False
        while not over:
            action = policy.act(int(seen), action)
            seen, reward, ended, truncated, information = simulated.step(np.int64(action))
            here, won, stopped, cut, told = arm.step(np.int64(action))
            assert (here, won, stopped, cut) == (seen, reward, ended, truncated)
            assert told["observed"] == information["observed"]
            over = ended or truncated
        assert reward == 1
    assert "belief" not in told
    with pytest.raises(ResetNeeded):
        arm.step(np.int64(0))


def test_what_is_no_action_is_refused() -> None:
    finger, _ = direct_finger(LAB, "top-plate")
    arm = ArmEnvironment(domains.get("top-plate"), finger)
    arm.reset(seed=0)
    with pytest.raises(InvalidAction):
        arm.step(np.int64(3))


def test_an_interrupted_reset_leaves_no_episode() -> None:
    finger, plant = direct_finger(LAB, "top-plate")
    plant.noise = 0.1
    arm = ArmEnvironment(domains.get("top-plate"), finger)
    with pytest.raises(BaselineError, match="scatters"):
        arm.reset(seed=0)
    with pytest.raises(ResetNeeded):
        arm.step(np.int64(1))


def test_a_stiff_finger_straightens_before_it_pushes() -> None:
    """A finger that stands bent on a bump is made stiff at its angle first, so that nothing jumps."""
    finger, plant = direct_finger(LAB, "two-bumps-1d")
    plant.noise = 0.0
    finger.reset(0, 3)  # bumps at 2 and 4
    outcome = finger.act(two_bumps_1d.RIGHT_SOFT)
    assert outcome.angle == pytest.approx(-0.155, abs=0.02)
    told: list[tuple[str, tuple[float, ...]]] = []
    gripper = finger.gripper
    for name in ("set_stiffness", "set_positions", "set_max_velocities"):
        plain = getattr(gripper, name)
        setattr(
            gripper,
            name,
            lambda pair, name=name, plain=plain: (told.append((name, tuple(pair))), plain(pair)),
        )
    assert finger.act(two_bumps_1d.RIGHT_STIFF).pushed == two_bumps_1d.RIGHT_BUMP_RIGHT
    kinds = [name for name, _ in told]
    assert kinds == [
        "set_max_velocities",
        "set_positions",
        "set_stiffness",
        "set_max_velocities",
        "set_positions",
    ]
    assert told[1][1][0] == pytest.approx(outcome.angle, abs=1e-3)
    assert told[2][1] == (4.0, 1.0)
    assert told[4][1][0] == pytest.approx(0, abs=1e-6)
