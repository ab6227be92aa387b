"""TwoBumps-1D in MuJoCo: two ridges that slide on a table under a finger on a linear stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import mujoco

from bgn.domains.two_bumps_1d import ACTIONS, BINS, CELLS, PAIRS, RIGHT_BUMP_RIGHT
from bgn.physics.scene import HERE, SOFT, STIFF, Measurement, Scene, contact_angle
from bgn.physics.tasks import Step, Task, register

PITCH: Final = 0.08
HINGE_HEIGHT: Final = 0.154
BUMP_RADIUS: Final = 0.03
ANGLE_EDGE: Final = 0.08
CONTACT: Final = contact_angle(HINGE_HEIGHT, BUMP_RADIUS)
MOVED: Final = 0.01  # metres from where the episode began
PUSH: Final = 0.022  # metres a stiff finger pushes a bump at least; a soft one leaves it where it is


class TwoBumps1DScene(Scene):
    """The hidden part is an index into ``PAIRS``."""

    name = "two-bumps-1d"
    actions = len(ACTIONS)
    bins = BINS
    pitch = PITCH
    angle_edges = (-ANGLE_EDGE, ANGLE_EDGE)
    angle_gaps = (CONTACT, CONTACT)
    view = (820, 440)

    def __init__(self) -> None:
        super().__init__(mujoco.MjSpec.from_file(str(HERE / "two_bumps_1d.xml")), ["base"], ["finger"])
        self._bumps = [self.model.joint(f"bump-{i}").qposadr[0] for i in range(2)]

    def parameters(self) -> dict[str, Any]:
        """Thresholds and the pairs of cells."""
        return {"pitch": PITCH, "angle_edge": ANGLE_EDGE, "moved": MOVED, "cells": CELLS, "pairs": PAIRS}

    def hidden_parts(self) -> Sequence[int]:
        """All pairs of bump cells."""
        return range(len(PAIRS))

    def starts(self, hidden: int) -> Sequence[int]:
        """Return all cells beside the bumps."""
        return [cell for cell in range(CELLS) if cell not in PAIRS[hidden]]

    def act(self, action: int) -> Measurement:
        """Move one cell to the left or right with a soft or stiff finger."""
        direction, stiff = (-1 if action < 2 else 1), action % 2 == 1
        (cell,) = self._measured_coordinates()
        if not 0 <= cell + direction < CELLS:
            return self.measurement
        self._move(0, direction, STIFF if stiff else SOFT)
        self.measurement = self._measure()
        return self.measurement

    def _measure(self) -> Measurement:
        (cell,), angle = self._measured_coordinates(), self._angle(0)
        shifts = [
            float(self.data.qpos[joint] - start * PITCH)
            for joint, start in zip(self._bumps, PAIRS[self.hidden], strict=True)
        ]
        furthest = max(range(2), key=lambda i: abs(shifts[i]))
        shift = shifts[furthest]
        pushed = (furthest + 1) * (1 if shift > 0 else -1) if abs(shift) > MOVED else 0
        margin = min(abs(abs(s) - MOVED) / PUSH for s in shifts)
        # The angle after a push is of no consequence: the episode is over.
        margin = margin if pushed else min(margin, self._angle_margin(angle))
        return Measurement(cell * BINS + self._bin(angle), angle, pushed, margin)

    def _place(self, hidden: int) -> None:
        for joint, cell in zip(self._bumps, PAIRS[hidden], strict=True):
            self.data.qpos[joint] = cell * PITCH

    def _coordinates(self, cell: int) -> tuple[int, ...]:
        return (cell,)


@register("two-bumps-1d")
class TwoBumps1DTask(Task):
    """Any push ends the episode; it succeeds if the right bump went right."""

    scene = TwoBumps1DScene

    def reset(self, x: int, y: int) -> Step:
        """Begin with a neutral finger at x's cell."""
        return Step(self.finger.reset(y, x // BINS).reading)

    def act(self, action: int) -> Step:
        """Move softly or stiffly."""
        measurement = self.finger.act(action)
        success = measurement.pushed == RIGHT_BUMP_RIGHT
        return Step(measurement.reading, ended=measurement.pushed != 0, success=success)
