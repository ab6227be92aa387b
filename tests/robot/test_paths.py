"""Timed paths, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bgn.robot import kinematics, paths

NEAR = np.array([-0.19, -1.4, 1.7, -1.85, -1.57, 1.38])


def test_a_trapezoid_by_hand() -> None:
    # 0.1 m at 0.1 m/s and 0.5 m/s^2: ramps of 0.2 s and 0.01 m, 0.08 m in between.
    profile = paths.Trapezoid(0.1, 0.1, 0.5)
    assert profile.duration == pytest.approx(1.2)
    np.testing.assert_allclose(
        profile.at([0, 0.1, 0.2, 0.6, 1.0, 1.1, 1.2, 9]), [0, 0.0025, 0.01, 0.05, 0.09, 0.0975, 0.1, 0.1]
    )


def test_a_short_path_never_reaches_its_speed() -> None:
    profile = paths.Trapezoid(0.005, 0.1, 0.5)
    assert profile.duration == pytest.approx(0.2)
    np.testing.assert_allclose(profile.at([0.1]), [0.0025])


@given(st.floats(1e-4, 2), st.floats(0.01, 1), st.floats(0.05, 5))
def test_a_trapezoid_keeps_to_speed_and_acceleration(
    length: float, speed: float, acceleration: float
) -> None:
    profile = paths.Trapezoid(length, speed, acceleration)
    times = np.linspace(0, profile.duration, 400)
    covered = profile.at(times)
    assert covered[0] == 0
    assert covered[-1] == pytest.approx(length)
    speeds = np.diff(covered) / np.diff(times)
    assert (speeds >= -1e-9).all()
    assert speeds.max() <= speed * (1 + 1e-6)


def test_a_line_is_straight_and_on_time() -> None:
    start = kinematics.forward(NEAR)
    end = start.copy()
    end[1, 3] -= 0.08
    joints = paths.line(start, end, NEAR, 0.1, 0.5, 0.002)
    assert joints is not None
    assert len(joints) == 500
    tips = kinematics.forward(joints)
    np.testing.assert_allclose(tips[-1], end, atol=1e-9)
    np.testing.assert_allclose(tips[:, [0, 2], 3], np.broadcast_to(start[[0, 2], 3], (500, 2)), atol=1e-9)


def test_a_line_out_of_reach_is_none() -> None:
    start = kinematics.forward(NEAR)
    end = start.copy()
    end[0, 3] -= 1
    assert paths.line(start, end, NEAR, 0.1, 0.5, 0.002) is None


def test_braking_comes_to_rest_along_the_path() -> None:
    # A joint at 1 rad/s that slows down by 2 of its speeds a second: half a second, a quarter of a radian.
    path = np.arange(1000)[:, None] * np.full(6, 0.002)
    stopped = paths.brake(path, 2.0, 0.002)
    assert len(stopped) == 250
    assert stopped[-1, 0] == pytest.approx(0.25)
    speeds = np.diff(stopped[:, 0])
    assert (np.diff(speeds) < 0).all()


def test_no_way_to_go_is_one_row() -> None:
    assert len(paths.joint_line(NEAR, NEAR, 0.1, 0.5, 0.002)) == 1
