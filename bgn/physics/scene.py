"""A finger on a position-controlled base, moved one cell at a time in MuJoCo; what the three scenes share.

SI units and radians. A move drives the base by one cell at constant velocity, then holds it until the
finger has settled; the finger is a joint impedance whose stiffness an action chooses. A reading is (cell,
angle bin): the angle is positive where the tip is deflected towards the positive axis.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

HERE: Final = Path(__file__).parent
TIMESTEP: Final = 0.002
MOVE_STEPS: Final = 200
SETTLE_STEPS: Final = 50
FRAME_STEPS: Final = 10  # an observer sees every 20 ms of a move
FINGER_LENGTH: Final = 0.12  # hinge to tip centre
TIP_RADIUS: Final = 0.01
FINGER_INERTIA: Final = 1.96e-4  # about the hinge, with the armature
SOFT: Final = 0.2  # N m / rad
STIFF: Final = 20.0

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Measurement:
    """What one action did, measured in the scene."""

    reading: int
    """cell * bins + angle bin."""
    angle: float
    """Raw finger angle along the axis last moved, in radians."""
    pushed: int = 0
    """0, or the 1-based index of the bump that was pushed, negative if it went left."""
    margin: float = math.inf
    """Smallest distance of a measured quantity to its threshold, as a fraction of the gap it splits."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Everything the rest of an episode depends on."""

    physics: Floats
    hidden: int
    measurement: Measurement


class Scene(ABC):
    """One force-feedback scene; ``actions`` of it are moves, further actions of the domain are grasps."""

    name: str
    actions: int
    bins: int
    pitch: float  # metres between neighbouring cells
    angle_edges: tuple[float, ...]  # radians, between the bins
    angle_gaps: tuple[float, ...]  # radians between the angles an edge separates
    view: tuple[int, int]  # pixels (width, height) of a picture that shows all of it

    def __init__(self, spec: mujoco.MjSpec, drives: Sequence[str], knuckles: Sequence[str]) -> None:
        self.xml: str = spec.to_xml()
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.observer: Callable[[], None] | None = None
        self.hidden = -1
        self.measurement = Measurement(reading=-1, angle=0.0)
        self._drives = [self.model.actuator(name).id for name in drives]
        self._knuckles = [self.model.actuator(name).id for name in knuckles]
        self._drive_joints = [self.model.joint(name).qposadr[0] for name in drives]
        self._knuckle_joints = [self.model.joint(name).qposadr[0] for name in knuckles]

    # -- what a scene defines -------------------------------------------------------------------------------

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Everything beside the XML that its table depends on, as JSON."""

    @abstractmethod
    def starts(self, hidden: int) -> Sequence[int]:
        """Return the cells at which an episode with that hidden part can start."""

    @abstractmethod
    def hidden_parts(self) -> Sequence[int]:
        """Return the hidden parts that the scene can realise, in the table's order."""

    @abstractmethod
    def act(self, action: int) -> Measurement:
        """Take one action; a move out of range is refused and leaves everything as it is."""

    @abstractmethod
    def _place(self, hidden: int) -> None:
        """Put the objects where the hidden part says."""

    @abstractmethod
    def _coordinates(self, cell: int) -> tuple[int, ...]:
        """Return the cell's grid coordinate along each drive."""

    # -- what they share ------------------------------------------------------------------------------------

    def reset(self, hidden: int, cell: int) -> Measurement:
        """Begin an episode: place the objects and a neutral soft finger at ``cell``."""
        mujoco.mj_resetData(self.model, self.data)
        self.hidden = hidden
        self._place(hidden)
        for joint, drive, coordinate in zip(
            self._drive_joints, self._drives, self._coordinates(cell), strict=True
        ):
            self.data.qpos[joint] = coordinate * self.pitch
            self._set_point(drive, coordinate * self.pitch)
        self._set_stiffness(SOFT)
        mujoco.mj_forward(self.model, self.data)
        self._run(SETTLE_STEPS)
        self.measurement = Measurement(reading=cell * self.bins + self.bins // 2, angle=0.0)
        return self.measurement

    def save(self) -> Snapshot:
        """Return a snapshot from which ``restore`` continues bit for bit."""
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION)
        physics = np.empty(size)
        mujoco.mj_getState(self.model, self.data, physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        return Snapshot(physics, self.hidden, self.measurement)

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot of this scene."""
        if snapshot.hidden != self.hidden:
            self._place(snapshot.hidden)
        mujoco.mj_setState(self.model, self.data, snapshot.physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        self.hidden, self.measurement = snapshot.hidden, snapshot.measurement

    def _move(self, axis: int, direction: int, stiffness: float) -> None:
        """Drive the base one cell along ``axis`` and let the finger settle."""
        self._set_stiffness(stiffness)
        drive, knuckle = self._drives[axis], self._knuckles[axis]
        origin = round(self.data.qpos[self._drive_joints[axis]] / self.pitch)
        self._set_point(drive, origin * self.pitch)
        angle = self.data.qpos[self._knuckle_joints[axis]] if stiffness == STIFF else 0.0
        self._set_point(knuckle, angle)
        half = MOVE_STEPS // 2
        self.data.ctrl[drive] = direction * self.pitch / (MOVE_STEPS * TIMESTEP)
        self.data.ctrl[knuckle] = -angle / (half * TIMESTEP)  # a stiff finger straightens over the first half
        self._run(half)
        self.data.ctrl[knuckle] = 0
        self._set_point(knuckle, 0)
        self._run(MOVE_STEPS - half)
        self.data.ctrl[drive] = 0
        self._set_point(drive, (origin + direction) * self.pitch)
        self._run(SETTLE_STEPS)

    def _measured_coordinates(self) -> tuple[int, ...]:
        return tuple(round(self.data.qpos[joint] / self.pitch) for joint in self._drive_joints)

    def _angle(self, axis: int) -> float:
        return float(self.data.qpos[self._knuckle_joints[axis]])

    def _bin(self, angle: float) -> int:
        return int(np.searchsorted(self.angle_edges, angle))

    def _angle_margin(self, angle: float) -> float:
        pairs = zip(self.angle_edges, self.angle_gaps, strict=True)
        return min(abs(angle - edge) / gap for edge, gap in pairs)

    def _set_stiffness(self, stiffness: float) -> None:
        damping = 2 * math.sqrt(stiffness * FINGER_INERTIA)  # critical
        for knuckle in self._knuckles:
            self.model.actuator_gainprm[knuckle, 0] = stiffness
            self.model.actuator_biasprm[knuckle, 1:3] = -stiffness, -damping

    def _set_point(self, actuator: int, value: float) -> None:
        self.data.act[self.model.actuator_actadr[actuator]] = value

    def _run(self, steps: int) -> None:
        if self.observer is None:
            mujoco.mj_step(self.model, self.data, nstep=steps)
            return
        for _ in range(0, steps, FRAME_STEPS):
            mujoco.mj_step(self.model, self.data, nstep=FRAME_STEPS)
            self.observer()


def contact_angle(distance: float, radius: float) -> float:
    """Return the angle at the hinge between a round object's centre and the tip that rests on the object.

    The law of cosines in the triangle of hinge, tip and object centre, ``distance`` metres from the hinge.
    """
    reach = radius + TIP_RADIUS
    return math.acos((FINGER_LENGTH**2 + distance**2 - reach**2) / (2 * FINGER_LENGTH * distance))
