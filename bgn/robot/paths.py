"""Timed paths of the arm: a trapezoid of speed along a straight line of the tool or of the joints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from bgn.robot import kinematics
from bgn.robot.kinematics import Floats

MINIMUM: Final = 1e-9  # a shorter path is no motion


@dataclass(frozen=True)
class Trapezoid:
    """A length covered from rest to rest: constant acceleration, constant speed, constant deceleration."""

    length: float
    speed: float
    acceleration: float

    @property
    def _ramp(self) -> float:
        peak = min(self.speed, math.sqrt(self.length * self.acceleration))
        return peak / self.acceleration

    @property
    def duration(self) -> float:
        """Seconds it takes."""
        if self.length == 0:
            return 0.0
        peak = self._ramp * self.acceleration
        return self._ramp + self.length / peak

    def at(self, times: ArrayLike) -> Floats:
        """Return the length covered at each of the times."""
        t = np.clip(np.asarray(times, dtype=np.float64), 0, self.duration)
        ramp, peak = self._ramp, self._ramp * self.acceleration
        left = self.duration - t
        return np.select(
            [t < ramp, left < ramp],
            [self.acceleration * t**2 / 2, self.length - self.acceleration * left**2 / 2],
            peak * (t - ramp / 2),
        )


def line(
    start: Floats, end: Floats, near: Floats, speed: float, acceleration: float, step: float
) -> Floats | None:
    """Return joints (n, 6), one per ``step`` seconds, that carry the flange straight from one transform to another.

    The joints begin on the branch of ``near`` (6,). None if the line leaves what the arm can reach. A turn is timed
    as if a radian were a metre.
    """
    turned = Rotation.from_matrix(start[:3, :3].T @ end[:3, :3]).magnitude()
    length = max(float(np.linalg.norm(end[:3, 3] - start[:3, 3])), float(turned))
    fractions = _fractions(length, speed, acceleration, step)
    return kinematics.follow(kinematics.interpolate(start, end, fractions), near)


def joint_line(start: Floats, end: Floats, speed: float, acceleration: float, step: float) -> Floats:
    """Return joints (n, 6), one per ``step`` seconds, straight from one configuration (6,) to another."""
    length = float(np.abs(end - start).max())
    fractions = _fractions(length, speed, acceleration, step)
    return start + fractions[:, None] * (end - start)


def brake(joints: Floats, deceleration: float, step: float) -> Floats:
    """Return joints (n, 6) that come to rest along a path of joints (m, 6) that was being followed.

    The first two rows of ``joints`` say how fast; ``deceleration`` is that of the path's parameter in units of its
    present speed per second. The path must not end before the arm is at rest: its last row is held.
    """
    ticks = max(1, math.ceil(1 / (deceleration * step)))
    elapsed = np.arange(1, ticks + 1) * step
    travelled = (elapsed - deceleration * elapsed**2 / 2) / step  # in rows of the path
    rows = np.clip(np.minimum(travelled, travelled.max()), 0, len(joints) - 1)
    low = np.floor(rows).astype(int)
    high = np.minimum(low + 1, len(joints) - 1)
    weight = (rows - low)[:, None]
    stopped: Floats = joints[low] * (1 - weight) + joints[high] * weight
    return stopped


def _fractions(length: float, speed: float, acceleration: float, step: float) -> Floats:
    if length < MINIMUM:
        return np.ones(1)
    profile = Trapezoid(length, speed, acceleration)
    times = np.arange(1, math.ceil(profile.duration / step) + 1) * step
    return profile.at(times) / length
