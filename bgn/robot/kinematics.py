"""Kinematics of the UR5e: forward, closed-form inverse, joint windows.

Metres and radians; a pose is [x, y, z, rx, ry, rz] with a rotation vector, in the controller's base frame, as
the controller speaks. The numbers are the manufacturer's nominal ones; a real arm is calibrated at the factory
and differs from them by 1 to 2 mm, which the controller knows and we do not.
"""

from __future__ import annotations

import itertools
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

Floats = NDArray[np.float64]

# Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e.
A: Final = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
D: Final = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
ALPHA: Final = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
MASSES: Final = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)
TORQUES: Final = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
JOINT_LIMIT: Final = 2 * np.pi
JOINT_SPEED_LIMIT: Final = np.pi
#: Of the eight branches: shoulder (left, right), wrist 2 (positive, negative), elbow (positive, negative).
SIGNS: Final = tuple(itertools.product((1, -1), repeat=3))
SINGULAR: Final = 1e-9  # sine of wrist 2 below which wrist 3 is not determined


def forward(joints: ArrayLike) -> Floats:
    """Return the flange's transform (..., 4, 4) of joint angles (..., 6)."""
    q = np.asarray(joints, dtype=np.float64)
    transform = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for i in range(6):
        transform = transform @ link(i, q[..., i])
    return transform


def link(i: int, angle: ArrayLike) -> Floats:
    """Return the transform (..., 4, 4) across joint ``i`` (from 0) turned by angles (...)."""
    theta = np.asarray(angle, dtype=np.float64)
    cos, sin = np.cos(theta), np.sin(theta)
    ca, sa = np.cos(ALPHA[i]), np.sin(ALPHA[i])
    zero, one = np.zeros_like(theta), np.ones_like(theta)
    rows = [
        [cos, -sin * ca, sin * sa, A[i] * cos],
        [sin, cos * ca, -cos * sa, A[i] * sin],
        [zero, sa * one, ca * one, D[i] * one],
        [zero, zero, zero, one],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def inverse(transform: ArrayLike) -> Floats:
    """Return all joint solutions (..., 8, 6) of flange transforms (..., 4, 4), within ±pi; NaN where there is none.

    The branches are in the order of ``SIGNS``. At a singular wrist (the sine of wrist 2 is 0) a branch has no unique
    solution and is NaN.
    """
    T = np.asarray(transform, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        solutions = [_branch(T, *signs) for signs in SIGNS]
    joints = np.stack(solutions, axis=-2)
    joints[np.isnan(joints).any(axis=-1)] = np.nan
    return (joints + np.pi) % (2 * np.pi) - np.pi


def _branch(T: Floats, shoulder: int, wrist: int, elbow: int) -> Floats:
    centre = T[..., :3, 3] - D[5] * T[..., :3, 2]  # where the axes of wrist 2 and wrist 3 meet
    radius = np.hypot(centre[..., 0], centre[..., 1])
    q1 = np.arctan2(centre[..., 1], centre[..., 0]) + shoulder * np.arccos(D[3] / radius) + np.pi / 2
    side = T[..., 0, 3] * np.sin(q1) - T[..., 1, 3] * np.cos(q1)
    q5 = wrist * np.arccos((side - D[3]) / D[5])
    sine = np.sin(q5)
    sine = np.where(np.abs(sine) < SINGULAR, np.nan, sine)
    from_1 = np.linalg.inv(link(0, q1)) @ T
    q6 = np.arctan2(-from_1[..., 2, 1] / sine, from_1[..., 2, 0] / sine)
    to_4 = from_1 @ np.linalg.inv(link(4, q5) @ link(5, q6))
    x, y = to_4[..., 0, 3], to_4[..., 1, 3]
    q3 = elbow * np.arccos((x**2 + y**2 - A[1] ** 2 - A[2] ** 2) / (2 * A[1] * A[2]))
    q2 = np.arctan2(y, x) - np.arctan2(A[2] * np.sin(q3), A[1] + A[2] * np.cos(q3))
    q4 = np.arctan2(to_4[..., 1, 0], to_4[..., 0, 0]) - q2 - q3
    return np.stack([q1, q2, q3, q4, q5, q6], axis=-1)


def nearest(transform: ArrayLike, near: ArrayLike) -> Floats | None:
    """Return the solution (6,) closest to ``near`` (6,), each joint within half a turn of it; None if there is none."""
    reference = np.asarray(near, dtype=np.float64)
    solutions = inverse(transform)
    solutions = solutions[~np.isnan(solutions[:, 0])]
    if not len(solutions):
        return None
    turns = (solutions - reference + np.pi) % (2 * np.pi) - np.pi
    turned: Floats = reference + turns[np.abs(turns).max(axis=1).argmin()]
    return turned


def follow(transforms: ArrayLike, near: ArrayLike) -> Floats | None:
    """Return joints (n, 6) along flange transforms (n, 4, 4) on the branch of ``near`` (6,) at the first.

    None if the branch ends before the path does. The joints are continuous: no joint jumps by a turn.
    """
    path = np.asarray(transforms, dtype=np.float64)
    start = nearest(path[0], near)
    if start is None:
        return None
    gaps = np.abs((inverse(path[0]) - start + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        branch = _branch(path, *SIGNS[int(np.nanargmin(gaps))])
    if np.isnan(branch).any():
        return None
    joints = np.unwrap(branch, axis=0)
    turned: Floats = joints + np.round((start - joints[0]) / (2 * np.pi)) * 2 * np.pi
    return turned


def condition(joints: ArrayLike) -> float:
    """Return the condition number of the geometric Jacobian, lengths scaled by the arm's reach; large is singular."""
    scaled = jacobian(joints)
    scaled[:3] /= abs(A[1]) + abs(A[2])
    return float(np.linalg.cond(scaled))


def jacobian(joints: ArrayLike) -> Floats:
    """Return the flange's geometric Jacobian (6, 6) in the base frame: linear rows above angular ones."""
    q = np.asarray(joints, dtype=np.float64)
    frames = [np.eye(4)]
    for i in range(6):
        frames.append(frames[-1] @ link(i, q[i]))
    tip = frames[-1][:3, 3]
    columns = [np.concatenate([np.cross(f[:3, 2], tip - f[:3, 3]), f[:3, 2]]) for f in frames[:-1]]
    return np.stack(columns, axis=1)


def to_transform(pose: ArrayLike) -> Floats:
    """Return transforms (..., 4, 4) of poses (..., 6)."""
    p = np.asarray(pose, dtype=np.float64)
    transform = np.zeros((*p.shape[:-1], 4, 4))
    transform[..., :3, :3] = (
        Rotation.from_rotvec(p[..., 3:].reshape(-1, 3)).as_matrix().reshape(*p.shape[:-1], 3, 3)
    )
    transform[..., :3, 3] = p[..., :3]
    transform[..., 3, 3] = 1
    return transform


def to_pose(transform: ArrayLike) -> Floats:
    """Return the pose (6,) of a transform (4, 4)."""
    T = np.asarray(transform, dtype=np.float64)
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])


def interpolate(start: ArrayLike, end: ArrayLike, fractions: ArrayLike) -> Floats:
    """Return transforms (n, 4, 4) on the straight line between two transforms, at fractions (n,) of it."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    along = np.asarray(fractions, dtype=np.float64)
    path = np.zeros((len(along), 4, 4))
    turns: Any = Slerp([0, 1], Rotation.from_matrix(np.stack([first[:3, :3], last[:3, :3]])))
    path[:, :3, :3] = turns(np.clip(along, 0, 1)).as_matrix()
    path[:, :3, 3] = first[:3, 3] + along[:, None] * (last[:3, 3] - first[:3, 3])
    path[:, 3, 3] = 1
    return path


def within_limits(joints: ArrayLike) -> bool:
    """Whether all joints are within ±360 degrees, the arm's own limits."""
    return bool((np.abs(np.asarray(joints)) <= JOINT_LIMIT).all())
