"""The twin's MuJoCo model: a UR5e from its DH parameters, our finger at its flange, a task's objects before it.

World coordinates are those of the task's simulated scene, whose objects stay where they are; the arm stands where
the laboratory's station says, seen from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from bgn.physics import top_plate, two_bumps_1d, two_bumps_2d
from bgn.physics.scene import FINGER_LENGTH, HERE
from bgn.robot import kinematics
from bgn.robot.errors import UsageError
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab, Station

STIFFNESS: Final = (2e4, 2e4, 1e4, 4e3, 4e3, 2e3)  # N m / rad, of the joints' position servos
DAMPING: Final = (800.0, 800.0, 300.0, 80.0, 80.0, 40.0)
ARMATURE: Final = 0.1
WALL: Final = "wall"
PADDED: Final = (0.4, 1.0)  # contact of wall and gripper: yields, as a tool's flange and a foam pad do
ROBOT, WALL_BIT = 8, 4  # contact bits of the gripper's housing and of the wall


@dataclass(frozen=True)
class Mounting:
    """How a task's scene and its finger hang together."""

    hinge: tuple[float, float, float]
    """Of cell 0, in the scene."""
    points: tuple[float, float, float]
    """Where the finger points, in the scene."""
    knuckles: dict[str, tuple[float, float, float]]
    """Its hinges and their axes."""
    camera: tuple[tuple[float, float, float], tuple[float, float, float]]
    """From where, and at what point, the scene is looked at, arm and all."""


MOUNTINGS: Final = {
    "top-plate": Mounting(
        (0, top_plate.HINGE_DISTANCE, 0),
        (0, -1, 0),
        {"finger": (-1, 0, 0)},
        ((2.5, 0.1, 1.0), (0, 0.42, 0.5)),
    ),
    "two-bumps-1d": Mounting(
        (-0.56, 0, two_bumps_1d.HINGE_HEIGHT),
        (0, 0, -1),
        {"finger": (0, -1, 0)},
        ((-0.5, -2.1, 1.3), (0, 0.1, 0.2)),
    ),
    "two-bumps-2d": Mounting(
        (-0.24, -0.24, two_bumps_2d.HINGE_HEIGHT),
        (0, 0, -1),
        {"finger-x": (0, -1, 0), "finger-y": (1, 0, 0)},
        ((-1.0, -1.5, 1.3), (0, 0.2, 0.15)),
    ),
}
CAMERA: Final = "talk"
FIELD_OF_VIEW: Final = 30  # degrees
PEDESTAL: Final = 0.09  # m, radius


def build(lab: Lab, task: str) -> mujoco.MjModel:
    """Compile the model of one task.

    Raises
    ------
    UsageError
        The laboratory has no such task.
    """
    station = lab.station(task)
    if task not in MOUNTINGS:
        raise UsageError(f"the twin has no objects for task {task!r}; it has {', '.join(MOUNTINGS)}")
    mounting, spec = MOUNTINGS[task], _scenery(task)
    turn = scene_axes(station, mounting)
    place = np.array(station.origin) - turn @ mounting.hinge
    base = spec.worldbody.add_body(name="arm", pos=-turn.T @ place, quat=_quaternion(turn.T))
    flange = _add_arm(spec, base)
    _add_finger(spec, flange, lab, station, mounting, turn)
    _add_wall(spec)
    _add_pedestal(spec, base)
    _aim_camera(spec, mounting)
    return spec.compile()


def scene_axes(station: Station, mounting: Mounting) -> Floats:
    """Return the scene's axes (3, 3) as columns in the controller's base frame."""
    points = Rotation.from_rotvec(station.orientation).as_matrix()[:, 2]
    axes = np.array(station.axes)
    if mounting.points[2] == 0:  # a horizontal finger that goes up and down
        up, depth = axes[0], -points
        return np.stack([np.cross(depth, up), depth, up], axis=1)
    up = -points
    return np.stack([axes[0], np.cross(up, axes[0]), up], axis=1)


def _scenery(task: str) -> mujoco.MjSpec:
    """Return the simulated scene without the stage that moves its finger."""
    if task == "top-plate":
        spec = top_plate._specify()
    else:
        spec = mujoco.MjSpec.from_file(str(HERE / f"{task.replace('-', '_')}.xml"))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for body in list(spec.worldbody.bodies):
        if body.name in ("base", "bridge"):
            spec.delete(body)
    for geom in list(spec.worldbody.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX and geom.material in ("steel", "accent"):
            spec.delete(geom)
    return spec


def _add_arm(spec: mujoco.MjSpec, base: Any) -> Any:
    radii = (0.06, 0.055, 0.045, 0.045, 0.045, 0.04)
    aside = (0.0, 0.138, 0.007, 0.0, 0.0, 0.0)  # lateral offsets of upper arm and forearm
    body: Any = base
    for i in range(6):
        previous = i - 1
        pos = (kinematics.A[previous], 0, kinematics.D[previous]) if i else (0, 0, 0)
        quat = _quaternion(Rotation.from_euler("x", kinematics.ALPHA[previous] if i else 0).as_matrix())
        body = body.add_body(name=f"link-{i}", pos=pos, quat=quat, gravcomp=1)
        joint = f"joint-{i}"
        body.add_joint(name=joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1), armature=ARMATURE)
        end = np.array([kinematics.A[i], 0, kinematics.D[i] if i != 5 else 0.08])
        offset = np.array([0, 0, aside[i]])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[radii[i], 0, 0],
            fromto=[*offset, *(end + offset)],
            mass=kinematics.MASSES[i],
            contype=0,
            conaffinity=0,
            group=1,
            material="steel" if i % 2 else "accent",
        )
        for at in (np.zeros(3), np.array([kinematics.A[i], 0, 0])) if aside[i] else ():
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[radii[i], 0, 0],
                fromto=[*at, *(at + offset)],
                mass=0,
                contype=0,
                conaffinity=0,
                group=1,
                material="steel" if i % 2 else "accent",
            )
        gains, biases = np.zeros(10), np.zeros(10)
        gains[0] = STIFFNESS[i]
        biases[:3] = 0, -STIFFNESS[i], -DAMPING[i]
        spec.add_actuator(
            name=joint,
            target=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            gainprm=gains,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=biases,
        )
    return body.add_body(name="flange", pos=(0, 0, kinematics.D[5]), gravcomp=1)


def _add_finger(
    spec: mujoco.MjSpec, flange: Any, lab: Lab, station: Station, mounting: Mounting, turn: Floats
) -> None:
    fitting, tip = spec.find_default("fitting"), spec.find_default("tip")
    orientation = Rotation.from_rotvec(station.orientation).as_matrix()
    gripper = flange.add_body(
        name="gripper", pos=lab.arm.tcp[:3], quat=_quaternion(orientation.T @ turn), gravcomp=1
    )
    points = np.array(mounting.points, dtype=np.float64)
    gripper.add_geom(
        name="housing",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=[0.028, 0, 0],
        fromto=[*(-0.045 * points), *(-0.11 * points)],
        mass=lab.arm.payload,
        contype=ROBOT,
        conaffinity=WALL_BIT,
        solref=list(PADDED),
        material="dark",
    )
    gripper.add_geom(fitting, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], material="accent", mass=0)
    finger = gripper.add_body(
        name="finger",
        gravcomp=1,
        mass=0.02,
        ipos=0.06 * points,
        inertia=np.where(points == 0, 2.4e-5, 1e-6),
        explicitinertial=True,
    )
    for name, axis in mounting.knuckles.items():
        finger.add_joint(spec.find_default("knuckle"), name=name, axis=axis)
        gains, biases = np.zeros(10), np.zeros(10)
        spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            gainprm=gains,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=biases,
        )
    finger.add_geom(
        fitting,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=[0.0085, 0, 0],
        fromto=[0, 0, 0, *(0.115 * points)],
        material="finger",
    )
    finger.add_geom(tip, name="tip", pos=FINGER_LENGTH * points)


def _add_wall(spec: mujoco.MjSpec) -> None:
    """Add a wall far away; a fault of the twin brings it into the arm's way."""
    wall = spec.worldbody.add_body(name=WALL, mocap=True, pos=(0, 0, -10))
    wall.add_geom(
        name=WALL,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.02, 0.02, 0.02],
        contype=WALL_BIT,
        conaffinity=ROBOT,
        solref=list(PADDED),
        rgba=[0.8, 0.2, 0.2, 1],
    )


def _add_pedestal(spec: mujoco.MjSpec, base: Any) -> None:
    """Let the arm stand on something."""
    floor = spec.geom("floor").pos[2]
    height = float(base.pos[2] - floor)
    spec.worldbody.add_geom(
        spec.find_default("fitting"),
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[PEDESTAL, height / 2, 0],
        pos=[base.pos[0], base.pos[1], floor + height / 2],
        material="dark",
    )


def _aim_camera(spec: mujoco.MjSpec, mounting: Mounting) -> None:
    """Look at the whole arm instead of at the finger only."""
    eye, at = (np.array(point, dtype=np.float64) for point in mounting.camera)
    back = (eye - at) / np.linalg.norm(eye - at)
    right = np.cross(np.array([0.0, 0.0, 1.0]), back)
    right = right / np.linalg.norm(right)
    camera = spec.camera(CAMERA)
    camera.pos, camera.fovy = eye, FIELD_OF_VIEW
    camera.quat = _quaternion(np.stack([right, np.cross(back, right), back], axis=1))
    camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _quaternion(matrix: Floats) -> Floats:
    quaternion: Floats = Rotation.from_matrix(matrix).as_quat(scalar_first=True)
    return quaternion
