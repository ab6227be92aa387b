"""TopPlate in MuJoCo: a rack of plates beside a finger on a vertical stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import mujoco
import numpy as np

from bgn.domains.top_plate import BINS, DOWN, GRASP, PLATES
from bgn.physics.scene import HERE, SOFT, Measurement, Scene, contact_angle

PITCH: Final = 0.08
HINGE_DISTANCE: Final = 0.219  # from the stack's axis
PLATE_RADIUS: Final = 0.095
PLATE_HALF_HEIGHT: Final = 0.005
ANGLE_EDGE: Final = 0.06
_REACH: Final = HINGE_DISTANCE - PLATE_RADIUS
#: The tip rests on the plate's rim, which lies half a plate's height beside the finger's own height.
CONTACT: Final = contact_angle(math.hypot(_REACH, PLATE_HALF_HEIGHT), 0.0) + math.atan2(
    PLATE_HALF_HEIGHT, _REACH
)
GLAZES: Final = ((0.95, 0.95, 0.93, 1.0), (0.36, 0.55, 0.72, 1.0))


class TopPlateScene(Scene):
    """Levels 0 … plates + 1; the hidden part is the height of the stack.

    The rack always has room for at least ``PLATES`` plates, so that lower stacks share one compiled scene.
    """

    name = "top-plate"
    actions = GRASP
    bins = BINS
    pitch = PITCH
    angle_edges = (-ANGLE_EDGE, ANGLE_EDGE)
    angle_gaps = (CONTACT, CONTACT)

    def __init__(self, plates: int = PLATES) -> None:
        self.capacity = max(plates, PLATES)
        self.top = plates + 1
        super().__init__(_specify(self.capacity), ["base"], ["finger"])
        self._plates = [self.model.geom(f"plate-{level}").id for level in range(1, self.capacity + 1)]

    def parameters(self) -> dict[str, Any]:
        """Thresholds and the number of plates there is room for."""
        return {"pitch": PITCH, "angle_edge": ANGLE_EDGE, "capacity": self.capacity}

    def hidden_parts(self) -> Sequence[int]:
        """Heights 0 … capacity."""
        return range(self.capacity + 1)

    def starts(self, hidden: int) -> Sequence[int]:
        """Return the level below the stack."""
        return [0]

    def act(self, action: int) -> Measurement:
        """Move one level down or up with a soft finger."""
        direction = -1 if action == DOWN else 1
        (level,) = self._measured_coordinates()
        if not 0 <= level + direction <= self.top:
            return self.measurement
        self._move(0, direction, SOFT)
        (level,), angle = self._measured_coordinates(), self._angle(0)
        reading = level * BINS + self._bin(angle)
        self.measurement = Measurement(reading, angle, margin=self._angle_margin(angle))
        return self.measurement

    def _place(self, hidden: int) -> None:
        for level, geom in enumerate(self._plates, start=1):
            there = level <= hidden
            self.model.geom_contype[geom] = 2 * there
            self.model.geom_conaffinity[geom] = 1 * there
            self.model.geom_rgba[geom] = np.array(GLAZES[level % 2]) * (1, 1, 1, there)

    def _coordinates(self, cell: int) -> tuple[int, ...]:
        return (cell,)


def _specify(capacity: int) -> mujoco.MjSpec:
    """Add the plates and a rack and a stage of their height."""
    spec = mujoco.MjSpec.from_file(str(HERE / "top_plate.xml"))
    world, fitting = spec.worldbody, spec.find_default("fitting")
    for level in range(1, capacity + 1):
        world.add_geom(
            spec.find_default("object"),
            name=f"plate-{level}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[PLATE_RADIUS, PLATE_HALF_HEIGHT, 0],
            pos=[0, 0, PITCH * level],
            rgba=GLAZES[level % 2],
        )
    half = PITCH * (capacity + 2) / 2
    posts = [(-0.06, -0.088), (0.06, -0.088), (-0.1065, 0.0)]
    for x, y in posts:
        world.add_geom(
            fitting,
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[0.006, half, 0],
            pos=[x, y, half - 0.03],
            material="steel",
        )
    for y, width, material in ((0.345, 0.028, "steel"), (0.3165, 0.006, "accent")):
        world.add_geom(
            fitting,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[width, 0.004 if material == "accent" else 0.028, half + 0.02],
            pos=[0, y, half - 0.02],
            material=material,
        )
    return spec
