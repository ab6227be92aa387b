"""Forward and inverse kinematics against published poses of a real arm, an independent library, and themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bgn.robot import kinematics, lab, preflight
from bgn.robot.errors import PreflightError

# Joint angles and flange positions of a real UR5e, published with the tests of ur-analytic-ik (MIT licence),
# `ur5e_poses.txt`; the arm is calibrated, hence the 2 mm.
PUBLISHED = [
    (
        (-0.0000146, -1.5708100, -1.5708133, -1.5708577, 1.5707831, -0.0000117),
        (0.4921685, -0.1348219, 0.4888366),
    ),
    (
        (-0.0000270, -1.5708567, -1.5707752, -0.0000199, 1.5707994, -0.0000246),
        (0.4921702, -0.1335850, 0.6883443),
    ),
    (
        (-0.0000356, -1.5708472, 0.7853978, -0.0000258, 1.5707703, 0.7853847),
        (-0.4191102, -0.1317001, 0.8649069),
    ),
    (
        (-0.0000160, -1.5707908, -0.7854142, 0.0000127, 1.5707787, 0.7853818),
        (0.2769325, -0.1328356, 1.0069722),
    ),
    (
        (-0.0000361, -1.5707952, -0.7853780, 1.5707921, 1.5708319, 0.7853773),
        (0.1358534, -0.1328062, 0.8658771),
    ),
    (
        (0.0000225, -1.5708028, -0.7854142, -1.5707717, 1.5707831, 0.7854224),
        (0.4180440, -0.1342781, 0.8659031),
    ),
    (
        (0.0000254, -1.7707931, -0.7854018, -1.5708252, 1.5707908, 0.7854100),
        (0.5494241, -0.1342819, 0.7688733),
    ),
    (
        (1.5707799, -1.7707759, -0.7853899, -1.5708085, 1.5708041, 0.7854297),
        (0.1342914, 0.5494314, 0.7688792),
    ),
    (
        (1.5707171, -1.7707941, -1.5708168, -1.5708085, 1.5707664, 0.7854178),
        (0.1348910, 0.5471484, 0.3845920),
    ),
]
angles = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6)


@pytest.mark.parametrize(("joints", "position"), PUBLISHED)
def test_forward_agrees_with_a_real_arm_within_its_calibration(
    joints: tuple[float, ...], position: tuple[float, ...]
) -> None:
    assert np.linalg.norm(kinematics.forward(joints)[:3, 3] - position) < 2e-3


def test_forward_by_hand() -> None:
    # All joints zero: the arm lies along -x, wrist and flange to the side and down.
    expected = [-(0.425 + 0.3922), -(0.1333 + 0.0996), 0.1625 - 0.0997]
    np.testing.assert_allclose(kinematics.forward(np.zeros(6))[:3, 3], expected, atol=1e-12)


@given(angles)
def test_inverse_undoes_forward(joints: list[float]) -> None:
    pose = kinematics.forward(joints)
    solutions = kinematics.inverse(pose)
    solutions = solutions[~np.isnan(solutions[:, 0])]
    for solution in solutions:
        np.testing.assert_allclose(kinematics.forward(solution), pose, atol=1e-7)
    if abs(np.sin(joints[4])) > 0.01 and abs(np.sin(joints[2])) > 0.01:
        gaps = np.abs((solutions - joints + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
        assert gaps.min() < 1e-6


def test_inverse_finds_the_branches_of_an_independent_library() -> None:
    oracle = pytest.importorskip("ur_analytic_ik", reason="ur-analytic-ik is not installed").ur5e
    rng = np.random.default_rng(0)
    for joints in rng.uniform(-np.pi, np.pi, (200, 6)):
        pose = kinematics.forward(joints)
        np.testing.assert_allclose(oracle.forward_kinematics(*joints), pose, atol=1e-9)
        ours = kinematics.inverse(pose)
        ours = ours[~np.isnan(ours[:, 0])]
        theirs = np.array(oracle.inverse_kinematics(pose)).reshape(-1, 6)
        assert len(ours) == len(theirs)
        apart = np.abs((ours[:, None] - theirs[None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
        assert apart.min(axis=1).max() < 1e-6


def test_nothing_beyond_reach() -> None:
    far = kinematics.to_transform([1.2, 0, 0.3, np.pi, 0, 0])
    assert np.isnan(kinematics.inverse(far)).all()
    assert kinematics.nearest(far, np.zeros(6)) is None


def test_following_a_line_keeps_to_one_branch() -> None:
    near = np.array([-0.19, -1.4, 1.7, -1.85, -1.57, 1.38])
    start = kinematics.forward(near)
    end = start.copy()
    end[1, 3] += 0.3
    joints = kinematics.follow(kinematics.interpolate(start, end, np.linspace(0, 1, 50)), near)
    assert joints is not None
    np.testing.assert_allclose(joints[0], near, atol=1e-9)
    assert np.abs(np.diff(joints, axis=0)).max() < 0.05
    np.testing.assert_allclose(kinematics.forward(joints[-1]), end, atol=1e-9)


def test_jacobian_is_the_derivative_of_forward() -> None:
    joints, step = np.array([0.1, -1.2, 1.3, -0.4, 0.9, 0.2]), 1e-6
    for i in range(6):
        moved = joints.copy()
        moved[i] += step
        change = (kinematics.forward(moved)[:3, 3] - kinematics.forward(joints)[:3, 3]) / step
        np.testing.assert_allclose(kinematics.jacobian(joints)[:3, i], change, atol=1e-5)


@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3)
)
def test_poses_survive_transforms(position: list[float], turn: list[float]) -> None:
    pose = np.array([*position, *turn])
    np.testing.assert_allclose(kinematics.to_pose(kinematics.to_transform(pose)), pose, atol=1e-9)


@pytest.mark.parametrize("task", ["top-plate", "two-bumps-1d", "two-bumps-2d"])
def test_every_cell_of_every_task_is_in_reach(task: str) -> None:
    reach = preflight.check_station(lab.load(), task)
    assert reach.condition < 20


def test_a_station_out_of_reach_is_refused() -> None:
    own = lab.load()
    station = own.tasks["two-bumps-1d"].model_copy(
        update={"origin": (-0.95, 0.56, 0.154), "workspace": ((-1.2, -1, 0), (0, 1, 1))}
    )
    moved = own.model_copy(update={"tasks": {"two-bumps-1d": station}})
    with pytest.raises(PreflightError, match="out of reach"):
        preflight.check_station(moved, "two-bumps-1d")


def test_the_authors_slots_13_and_14_are_out_of_reach() -> None:
    """Their line was 0.6 m away with slot 0 at y = -0.32; slots 0 to 10 were used."""
    own = lab.load()
    reachable = []
    for slot in range(15):
        pose = np.array([-0.6, 0.32 - 0.08 * slot, 0.2, np.pi, 0, 0])
        solutions = kinematics.inverse(kinematics.to_transform(pose) @ np.linalg.inv(own.tool))
        reachable.append(not np.isnan(solutions[:, 0]).all())
    assert all(reachable[:11])
    assert not any(reachable[13:])
