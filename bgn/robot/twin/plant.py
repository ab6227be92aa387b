"""The twin's physics: an arm that follows timed joint paths, and a finger of chosen stiffness at its flange."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import mujoco
import numpy as np

from bgn.physics.scene import FINGER_INERTIA, TIMESTEP
from bgn.robot import kinematics, paths
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab
from bgn.robot.twin import model as models
from bgn.robot.twin.objects import OBJECTS, Objects

STEP: Final = TIMESTEP  # seconds; also the controller's cycle
SENSE_EVERY: Final = 4  # steps between two looks at the contact forces
LAG_ROWS: Final = 128  # targets remembered for the servo lag
Extend = Callable[[Floats], Floats | None]


class Plant:
    """One arm before one task's objects; everything advances by :meth:`advance` only."""

    def __init__(self, lab: Lab, task: str, seed: int = 0) -> None:
        self.lab, self.task, self.station = lab, task, lab.station(task)
        self.model = models.build(lab, task)
        self.data = mujoco.MjData(self.model)
        self.rng = np.random.default_rng(seed)
        self.objects: Objects = OBJECTS[task](self.model, self.data)
        self.hidden: int | None = None
        self.observer: Callable[[], None] | None = None
        self.drift = lab.twin.angle_drift
        self.noise = lab.twin.angle_noise
        self.motions = 0
        """Paths begun so far."""
        self._joints = [self.model.joint(f"joint-{i}").qposadr[0] for i in range(6)]
        self._speeds = [self.model.joint(f"joint-{i}").dofadr[0] for i in range(6)]
        self._servos = [self.model.actuator(f"joint-{i}").id for i in range(6)]
        self._feedforward = np.array(models.DAMPING) / np.array(models.STIFFNESS)
        knuckles = models.MOUNTINGS[task].knuckles
        self._knuckles = [self.model.joint(name).qposadr[0] for name in knuckles]
        self._springs = [self.model.actuator(name).id for name in knuckles]
        self._tool = {self.model.geom("housing").id, self.model.geom("tip").id}
        self._wall = int(self.model.body(models.WALL).mocapid[0])
        self._arm = self.model.body("arm").id
        self._lag = round(lab.twin.servo_lag / STEP)
        self._path = np.zeros((0, 6))
        self._row = 0
        self._extend: Extend | None = None
        self._since_sense = 0
        self._force = np.zeros(3)
        self._set_points = np.zeros(len(knuckles))
        self._goals = np.zeros(len(knuckles))
        self._slew = np.full(len(knuckles), lab.gripper.maximum_velocity)
        self.set_stiffness([lab.gripper.soft] * len(knuckles))
        self._start()

    def _start(self) -> None:
        middle = tuple((size - 1) // 2 for size in self.station.shape)
        flange = self.lab.flange(self.station.pose(middle, retreat=True))
        start = kinematics.nearest(flange, self.station.near)
        assert start is not None, "lab.toml puts the middle of a task out of reach"
        self.data.qpos[self._joints] = start
        self._targets = np.tile(start, (LAG_ROWS, 1))
        self._newest = 0
        self.data.ctrl[self._servos] = start
        mujoco.mj_forward(self.model, self.data)

    # -- the arm --------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated seconds."""
        return float(self.data.time)

    @property
    def joints(self) -> Floats:
        """Measured joint angles (6,)."""
        measured: Floats = self.data.qpos[self._joints]
        return measured

    @property
    def joint_speeds(self) -> Floats:
        """Measured joint speeds (6,)."""
        measured: Floats = self.data.qvel[self._speeds]
        return measured

    @property
    def target(self) -> Floats:
        """Joint angles (6,) the arm is told to have now."""
        told: Floats = self._targets[self._newest]
        return told

    @property
    def target_speeds(self) -> Floats:
        """Joint speeds (6,) the arm is told to have now."""
        told: Floats = (self._targets[self._newest] - self._targets[self._newest - 1]) / STEP
        return told

    @property
    def moving(self) -> bool:
        """Whether a path is being followed."""
        return self._row < len(self._path) or self._extend is not None

    @property
    def flange(self) -> Floats:
        """The flange's transform (4, 4) in the base frame."""
        return kinematics.forward(self.joints)

    def tool_speed(self) -> Floats:
        """Return linear and angular speed (6,) of the flange."""
        speed: Floats = kinematics.jacobian(self.joints) @ self.joint_speeds
        return speed

    def tool_force(self) -> Floats:
        """Return the force (3,) on the tool in the base frame, newtons, from its contacts."""
        return self._force

    def follow(self, path: Floats, extend: Extend | None = None) -> None:
        """Follow joints (n, 6), one row a step; ``extend`` gives more rows after the last one when asked."""
        self._path, self._row, self._extend = path, 0, extend
        self.motions += 1

    def jump(self, joints: Floats) -> None:
        """Put the arm at rest at joint angles (6,) at once, for pictures."""
        self.halt()
        self.data.qpos[self._joints], self.data.qvel[self._speeds] = joints, 0
        self._targets[:] = joints
        self.data.ctrl[self._servos] = joints
        mujoco.mj_forward(self.model, self.data)

    def brake(self, deceleration: float) -> None:
        """Come to rest along the present path; ``deceleration`` is the flange's, in m/s^2."""
        speed = float(np.linalg.norm(kinematics.jacobian(self.target)[:3] @ self.target_speeds))
        rest = self._path[max(0, self._row - 1) :]
        self._extend = None
        if len(rest) < 2 or speed < paths.MINIMUM:
            self.halt()
            return
        self._path, self._row = paths.brake(rest, deceleration / speed, STEP), 0

    def brake_joints(self, deceleration: float) -> None:
        """Come to rest along the present path; ``deceleration`` is the fastest joint's, in rad/s^2."""
        speed = float(np.abs(self.target_speeds).max())
        rest = self._path[max(0, self._row - 1) :]
        self._extend = None
        if len(rest) < 2 or speed < paths.MINIMUM:
            self.halt()
            return
        self._path, self._row = paths.brake(rest, deceleration / speed, STEP), 0

    def halt(self) -> None:
        """Hold the present target at once."""
        self._path, self._row, self._extend = self._path[:0], 0, None

    def cut(self, fraction: float) -> None:
        """Let the present path end early, after that fraction of what is left of it."""
        left = self._path[self._row :]
        self._path, self._row = left[: round(fraction * len(left))], 0

    def advance(self, steps: int) -> None:
        """Let simulated time pass."""
        left = steps
        while left > 0:
            if not self.moving and not self._busy() and self.observer is None:
                mujoco.mj_step(self.model, self.data, nstep=left)
                self._sense()
                return
            self._step()
            left -= 1

    def _busy(self) -> bool:
        """Whether targets or set-points have still to arrive, so that steps cannot be taken in one go."""
        settled = (self._set_points == self._goals).all()
        return not settled or bool((self._targets != self._targets[self._newest]).any())

    def _step(self) -> None:
        if self._row >= len(self._path) and self._extend is not None:
            more = self._extend(self.target)
            self._path, self._row = (self._path[:0], 0) if more is None else (more, 0)
            self._extend = None if more is None else self._extend
        target = self.target
        if self._row < len(self._path):
            target = self._path[self._row]
            self._row += 1
        self._newest = (self._newest + 1) % LAG_ROWS
        self._targets[self._newest] = target
        late = self._newest - self._lag
        goal, before = self._targets[late], self._targets[late - 1]
        self.data.ctrl[self._servos] = goal + (goal - before) / STEP * self._feedforward
        if (self._set_points != self._goals).any():
            most = self._slew * STEP
            self._set_points += np.clip(self._goals - self._set_points, -most, most)
            self.data.ctrl[self._springs] = self._set_points
        mujoco.mj_step(self.model, self.data)
        self._since_sense += 1
        if self._since_sense >= SENSE_EVERY:
            self._sense()
        if self.observer is not None:
            self.observer()

    def _sense(self) -> None:
        self._since_sense = 0
        force = np.zeros(3)
        for i in range(self.data.ncon):
            contact = self.data.contact[i]
            first, second = int(contact.geom[0]), int(contact.geom[1])
            if first in self._tool or second in self._tool:
                wrench = np.zeros(6)
                mujoco.mj_contactForce(self.model, self.data, i, wrench)
                pushed = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geom
                force += pushed if second in self._tool else -pushed
        self._force = self.data.xmat[self._arm].reshape(3, 3).T @ force

    # -- the gripper ----------------------------------------------------------------------------------------

    def angles(self, *, exact: bool = False) -> Floats:
        """Return one sample of the finger's angles, one per hinge, as its encoder gives it or as it is."""
        angles: Floats = self.data.qpos[self._knuckles]
        if exact:
            return angles
        return angles + self.drift + self.rng.normal(0.0, self.noise, len(angles))

    def set_stiffness(self, stiffness: list[float]) -> None:
        """Set the stiffness of every hinge; the damping is critical."""
        for spring, k in zip(self._springs, stiffness, strict=True):
            self.model.actuator_gainprm[spring, 0] = k
            self.model.actuator_biasprm[spring, 1:3] = -k, -2 * math.sqrt(k * FINGER_INERTIA)

    def set_slew(self, speeds: list[float]) -> None:
        """Limit how fast the set-points move, in rad/s."""
        self._slew = np.maximum(np.array(speeds), 0.0)

    def set_goals(self, angles: list[float]) -> None:
        """Move the set-points, as fast as they may."""
        self._goals = np.array(angles)

    # -- what stands before it ------------------------------------------------------------------------------

    def place(self, hidden: int | None) -> None:
        """Put the objects where a hidden part says, or take them away (None)."""
        self.hidden = hidden
        if hidden is None:
            self.objects.clear()
        else:
            self.objects.place(hidden, self.rng.normal(0.0, self.lab.twin.placement_error, 16))
        mujoco.mj_forward(self.model, self.data)

    def block(self, ahead: float) -> None:
        """Put a wall that far ahead of the gripper along its motion; without motion, beside it along the first axis."""
        speed = self.tool_speed()[:3]
        along = (
            speed / np.linalg.norm(speed) if np.linalg.norm(speed) > 1e-3 else np.array(self.station.axes[0])
        )
        turn = self.data.xmat[self._arm].reshape(3, 3)
        self.data.mocap_pos[self._wall] = self.data.geom("housing").xpos + turn @ along * (
            ahead + 0.02 + 0.028
        )

    def unblock(self) -> None:
        """Take the wall away."""
        self.data.mocap_pos[self._wall] = 0, 0, -10
