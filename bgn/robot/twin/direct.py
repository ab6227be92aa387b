"""The twin's physics without its protocols: the same finger code on it, as fast as the machine can step.

For the noise sweep and for tests of the finger; everything else talks to the twin as to a robot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bgn.robot import kinematics, paths
from bgn.robot.errors import MotionError
from bgn.robot.finger import ArmFinger
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab
from bgn.robot.twin.plant import STEP, Plant

SETTLE_STEPS = 100  # after a path, until the joints have caught up with their targets


class DirectArm:
    """The arm of a plant."""

    def __init__(self, plant: Plant) -> None:
        self._plant, self._lab = plant, plant.lab

    def move_line(self, pose: Floats, speed: float) -> None:
        """Move the hinge straight to a pose (6,)."""
        plant = self._plant
        start = kinematics.forward(plant.target)
        path = paths.line(
            start, self._lab.flange(pose), plant.target, speed, self._lab.arm.acceleration, STEP
        )
        if path is None:
            raise MotionError(f"the straight line to {np.round(pose, 3)} leaves what the arm can reach")
        plant.follow(path)
        plant.advance(len(path) + SETTLE_STEPS)

    def pose(self) -> Floats:
        """Return the hinge's measured pose (6,)."""
        return kinematics.to_pose(self._plant.flange @ self._lab.tool)

    def zero_force(self) -> None:
        """Nothing to do: the plant's force has no offset."""

    def settle(self, seconds: float) -> None:
        """Stay at rest for so long."""
        self._plant.advance(round(seconds / STEP))


class DirectGripper:
    """The gripper of a plant."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._hinges = plant.station.fingers

    def set_stiffness(self, stiffness: Sequence[float]) -> None:
        """Set both fingers' stiffness."""
        self._plant.set_stiffness([stiffness[finger] for finger in self._hinges])

    def set_positions(self, angles: Sequence[float]) -> None:
        """Set both fingers' set-points."""
        self._plant.set_goals([angles[finger] for finger in self._hinges])

    def set_max_velocities(self, speeds: Sequence[float]) -> None:
        """Limit how fast both set-points move."""
        self._plant.set_slew([speeds[finger] for finger in self._hinges])

    def read_positions(self) -> tuple[float, float]:
        """Return both fingers' angles; a finger the task does not read stays where it is."""
        pair = [0.0, 0.0]
        for finger, angle in zip(self._hinges, self._plant.angles(), strict=True):
            pair[finger] = float(angle)
        return pair[0], pair[1]

    def read_origins(self) -> tuple[float, float]:
        """Return where both fingers were homed."""
        return 0.0, 0.0


def direct_finger(lab: Lab, task: str, seed: int = 0) -> tuple[ArmFinger, Plant]:
    """Return a finger on the twin's physics, and that physics."""
    plant = Plant(lab, task, seed)
    finger = ArmFinger(lab, task, DirectArm(plant), DirectGripper(plant), plant.place, plant.objects.pushed)
    return finger, plant
