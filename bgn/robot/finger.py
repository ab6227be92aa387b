"""A finger at the end of an arm: the same ``reset`` and ``act -> reading`` as a MuJoCo scene, from pose and angle.

Baseline, thresholds and stiffness belong to this finger: they come from the laboratory's file. It knows neither
what ends an episode nor what earns a reward; that is the task's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np

from bgn.physics.scene import Measurement
from bgn.robot.errors import BaselineError, MotionError
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab
from bgn.robot.moves import MOVES

OFF_CELL: Final = 0.1  # of a cell that the finger may be away from its centre when it is read


class Arm(Protocol):
    """What a finger needs of an arm; every call returns when the arm is at rest, or raises what happened."""

    def move_line(self, pose: Floats, speed: float) -> None:
        """Move the hinge straight to a pose (6,)."""
        ...

    def pose(self) -> Floats:
        """Return the hinge's measured pose (6,)."""
        ...

    def zero_force(self) -> None:
        """Call the present force at the tool zero."""
        ...

    def settle(self, seconds: float) -> None:
        """Stay at rest for so long, in the robot's own time."""
        ...


class Gripper(Protocol):
    """What a finger needs of a gripper: two fingers, angles in rad, stiffness in N m/rad."""

    def set_stiffness(self, stiffness: Sequence[float]) -> None:
        """Set both fingers' stiffness."""
        ...

    def set_positions(self, angles: Sequence[float]) -> None:
        """Set both fingers' set-points."""
        ...

    def set_max_velocities(self, speeds: Sequence[float]) -> None:
        """Limit how fast both set-points move, in rad/s."""
        ...

    def read_positions(self) -> tuple[float, float]:
        """Return both fingers' angles."""
        ...

    def read_origins(self) -> tuple[float, float]:
        """Return where both fingers were homed."""
        ...


class ArmFinger:
    """One task's finger on an arm.

    Parameters
    ----------
    lab, task
        Stations, thresholds and stiffness.
    arm, gripper
        What carries it and what it is part of.
    place
        Puts the objects where a hidden part says; called while the finger is out of the way.
    pushed
        Says after a stiff move which bump was pushed: 0, or its 1-based index, negative if to the left.
    """

    def __init__(
        self,
        lab: Lab,
        task: str,
        arm: Arm,
        gripper: Gripper,
        place: Callable[[int], None],
        pushed: Callable[[], int],
    ) -> None:
        self.lab, self.task, self.station = lab, task, lab.station(task)
        self.arm, self.gripper = arm, gripper
        self.speed = lab.arm.speed
        self.hidden = -1
        self.measurement = Measurement(reading=-1, angle=0.0)
        self.baseline = (0.0, 0.0)
        self.based: Callable[[], None] = lambda: None
        """Called when a baseline was taken."""
        self._place, self._pushed = place, pushed
        self._bins = len(self.station.angle_edges) + 1
        self._cell: tuple[int, ...] = ()

    def reset(self, hidden: int, cell: int) -> Measurement:
        """Begin an episode: objects placed with the finger out of the way, then a neutral soft finger at ``cell``."""
        self._soften()
        self.withdraw()
        start = self.coordinates(cell)
        self.arm.move_line(self.station.pose(start, retreat=True), self.speed)
        self._place(hidden)
        self.begin_at(start)
        self.hidden = hidden
        self.measurement = Measurement(reading=cell * self._bins + self._bins // 2, angle=0.0)
        return self.measurement

    def act(self, action: int) -> Measurement:
        """Move one cell; a move out of range is refused and leaves everything as it is."""
        move = MOVES[self.task][action]
        if not self._cell:
            raise MotionError("the finger is in no cell; an episode begins with reset")
        goal = list(self._cell)
        goal[move.axis] += move.direction
        if not 0 <= goal[move.axis] < self.station.shape[move.axis]:
            return self.measurement
        if move.stiff:
            self._stiffen(move.axis)
        else:
            self._soften()
        angle = self.step_to(tuple(goal), move.axis)
        reading = self._number(self._cell) * self._bins + int(
            np.searchsorted(self.station.angle_edges, angle)
        )
        pushed = self._pushed() if move.stiff else 0
        self.measurement = Measurement(reading, angle, pushed)
        return self.measurement

    def begin_at(self, start: tuple[int, ...]) -> None:
        """In free air beside a cell: zero the force, read the baseline; then bring the soft finger into the cell."""
        self.arm.move_line(self.station.pose(start, retreat=True), self.speed)
        self.arm.settle(self.lab.arm.settle)
        self.arm.zero_force()
        self.baseline = self.measure_baseline()
        self.based()
        self._soften()
        self.arm.move_line(self.station.pose(start), self.speed)
        self._cell = start

    def step_to(self, cell: tuple[int, ...], axis: int) -> float:
        """Move to a neighbouring cell along an axis, settle, and return the angle along it."""
        self.arm.move_line(self.station.pose(cell), self.speed)
        self.arm.settle(self.lab.arm.settle)
        self._cell = cell
        self._check_cell()
        return self._angle(axis)

    def grasp(self) -> None:
        """Close both fingers gently where they are, then let go; the task has judged the grasp already."""
        self.gripper.set_positions(self.gripper.read_positions())
        self.gripper.set_stiffness(self._pair(self.lab.gripper.stiff))
        self.arm.settle(self.lab.arm.settle)
        self._soften()

    def withdraw(self) -> None:
        """Bring the finger from where it is to where nothing is in its way."""
        if self._cell:
            self.arm.move_line(self.station.pose(self._cell, retreat=True), self.speed)
        self.forget_cell()

    def forget_cell(self) -> None:
        """Note that the finger is in no cell."""
        self._cell = ()

    def rest(self) -> None:
        """Make the finger soft, wherever it is."""
        self._soften()

    def measure_baseline(self) -> tuple[float, float]:
        """Return the angles of the free soft finger: medians of samples.

        Raises
        ------
        BaselineError
            The samples scatter too much, or the finger rests too far from its origin.
        """
        settings = self.lab.gripper
        samples = np.array([self.gripper.read_positions() for _ in range(settings.baseline_samples)])
        middle = np.median(samples, axis=0)
        spread = np.median(np.abs(samples - middle), axis=0)
        away = np.abs(middle - np.array(self.gripper.read_origins()))
        for finger in self.station.fingers:
            if spread[finger] > settings.baseline_spread:
                raise BaselineError(
                    f"finger {finger} does not rest: its angle scatters by {spread[finger]:.3f} rad (median absolute "
                    f"deviation), at most {settings.baseline_spread} is accepted; is something touching it?"
                )
            if away[finger] > settings.baseline_offset:
                raise BaselineError(
                    f"finger {finger} rests {away[finger]:.3f} rad from its origin, at most "
                    f"{settings.baseline_offset} is accepted; home the gripper and look for obstacles"
                )
        return float(middle[0]), float(middle[1])

    def coordinates(self, cell: int) -> tuple[int, ...]:
        """Return the grid coordinate along each axis of a cell."""
        if len(self.station.shape) == 1:
            return (cell,)
        row, column = divmod(cell, self.station.shape[0])
        return column, row

    def _number(self, coordinates: tuple[int, ...]) -> int:
        return coordinates[0] + (self.station.shape[0] * coordinates[1] if len(coordinates) == 2 else 0)

    def _check_cell(self) -> None:
        measured = self.station.coordinates(self.arm.pose()[:3])
        if np.abs(measured - np.array(self._cell)).max() > OFF_CELL:
            raise MotionError(f"the finger is at cell {np.round(measured, 2)} instead of {self._cell}")

    def _angle(self, axis: int) -> float:
        samples = [self.gripper.read_positions() for _ in range(self.lab.gripper.reading_samples)]
        finger = self.station.fingers[axis]
        angle = float(np.median([sample[finger] for sample in samples])) - self.baseline[finger]
        return self.station.signs[axis] * angle

    def _soften(self) -> None:
        self.gripper.set_stiffness(self._pair(self.lab.gripper.soft))
        self.gripper.set_max_velocities([self.lab.gripper.maximum_velocity] * 2)
        self.gripper.set_positions(self._set_points())

    def _stiffen(self, axis: int) -> None:
        """Make the finger stiff at its present angle, and let it straighten over the first half of the move."""
        present = self.gripper.read_positions()
        finger = self.station.fingers[axis]
        turn = abs(present[finger] - self.baseline[finger])
        speeds = [self.lab.gripper.maximum_velocity] * 2
        self.gripper.set_max_velocities(speeds)
        self.gripper.set_positions(present)
        self.gripper.set_stiffness(self._pair(self.lab.gripper.stiff))
        speeds[finger] = max(turn / (self.station.pitch / self.speed / 2), SLOWEST)
        self.gripper.set_max_velocities(speeds)
        self.gripper.set_positions(self._set_points())

    def _pair(self, stiffness: float) -> list[float]:
        """Return the stiffness of both fingers: of those this task reads, and of the other one."""
        return [stiffness if finger in self.station.fingers else self.lab.gripper.fixed for finger in (0, 1)]

    def _set_points(self) -> list[float]:
        return [
            self.baseline[finger] if finger in self.station.fingers else self.lab.gripper.fixed_position
            for finger in (0, 1)
        ]


SLOWEST: Final = 0.02  # rad/s, so that a set-point always arrives
