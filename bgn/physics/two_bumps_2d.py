"""TwoBumps-2D in MuJoCo: a large and a small dome on a table under a finger on an x-y gantry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import mujoco
import numpy as np

from bgn.domains.domain import Domain
from bgn.domains.two_bumps_2d import BINS, CELLS, FLAGS, GRASP, NEUTRAL, PAIRS, SIDE
from bgn.physics.scene import HERE, SOFT, Measurement, Scene, contact_angle
from bgn.physics.tasks import Finger, Step, Task, register

PITCH: Final = 0.16
HINGE_HEIGHT: Final = 0.156
LARGE_RADIUS: Final = 0.04
SMALL_RADIUS: Final = 0.03
MILD_EDGE: Final = 0.07
STRONG_EDGE: Final = 0.19
MILD: Final = contact_angle(HINGE_HEIGHT, SMALL_RADIUS)
STRONG: Final = contact_angle(HINGE_HEIGHT, LARGE_RADIUS)
STEPS: Final = ((0, -1), (0, 1), (1, -1), (1, 1))  # (axis, direction) of left, right, backward, forward


class TwoBumps2DScene(Scene):
    """The hidden part is an index into ``PAIRS``."""

    name = "two-bumps-2d"
    actions = GRASP
    bins = BINS
    pitch = PITCH
    angle_edges = (-STRONG_EDGE, -MILD_EDGE, MILD_EDGE, STRONG_EDGE)
    angle_gaps = (STRONG - MILD, MILD, MILD, STRONG - MILD)
    view = (560, 460)

    def __init__(self) -> None:
        spec = mujoco.MjSpec.from_file(str(HERE / "two_bumps_2d.xml"))
        super().__init__(spec, ["base-x", "base-y"], ["finger-x", "finger-y"])

    def parameters(self) -> dict[str, Any]:
        """Thresholds and the pairs of cells."""
        return {"pitch": PITCH, "angle_edges": self.angle_edges, "side": SIDE, "pairs": PAIRS}

    def hidden_parts(self) -> Sequence[int]:
        """All pairs of bump cells."""
        return range(len(PAIRS))

    def starts(self, hidden: int) -> Sequence[int]:
        """Return all cells beside the bumps."""
        return [cell for cell in range(CELLS) if cell not in PAIRS[hidden]]

    def act(self, action: int) -> Measurement:
        """Move one cell with a soft finger; the angle read is the one along the motion."""
        axis, direction = STEPS[action]
        if not 0 <= self._measured_coordinates()[axis] + direction < SIDE:
            return self.measurement
        self._move(axis, direction, SOFT)
        column, row = self._measured_coordinates()
        angle = self._angle(axis)
        reading = (row * SIDE + column) * BINS + self._bin(angle)
        self.measurement = Measurement(reading, angle, margin=self._angle_margin(angle))
        return self.measurement

    def _place(self, hidden: int) -> None:
        for bump, cell in enumerate(PAIRS[hidden]):
            row, column = divmod(cell, SIDE)
            centre = PITCH * (SIDE - 1) / 2
            self.data.mocap_pos[bump] = np.array([column * PITCH - centre, row * PITCH - centre, 0.0])

    def _coordinates(self, cell: int) -> tuple[int, ...]:
        row, column = divmod(cell, SIDE)
        return column, row


@register("two-bumps-2d")
class TwoBumps2DTask(Task):
    """A grasp succeeds at the large bump once both were felt."""

    scene = TwoBumps2DScene

    def __init__(self, domain: Domain, finger: Finger) -> None:
        super().__init__(domain, finger)
        self._felt = 0

    def reset(self, x: int, y: int) -> Step:
        """Begin with a neutral finger at x's cell and nothing felt."""
        self._felt = 0
        cell = x // FLAGS // BINS
        return self._step(self.finger.reset(y, cell).reading)

    def act(self, action: int) -> Step:
        """Move or grasp."""
        if action != GRASP:
            return self._step(self.finger.act(action).reading)
        size = abs(self.finger.measurement.reading % BINS - NEUTRAL)
        success = size == 2 and self._felt == FLAGS - 1
        return Step(self._step(self.finger.measurement.reading).x, ended=True, success=success)

    def _step(self, reading: int) -> Step:
        size = abs(reading % BINS - NEUTRAL)
        self._felt |= (0, 2, 1)[size]  # bit 0: the large bump, bit 1: the small one
        return Step(reading * FLAGS + self._felt)
