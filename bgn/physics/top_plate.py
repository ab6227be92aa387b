"""TopPlate in MuJoCo: a rack of plates beside a finger on a vertical stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import mujoco
import numpy as np

from bgn.domains.domain import Domain
from bgn.domains.layout import TouchLayout
from bgn.domains.top_plate import BINS, DOWN, GRASP, NEUTRAL, PLATES
from bgn.physics.scene import HERE, SOFT, Measurement, Scene, contact_angle
from bgn.physics.tasks import Finger, Step, Task, register

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

    The rack always has room for ``PLATES`` plates, so that lower stacks share one compiled scene.
    """

    name = "top-plate"
    actions = GRASP
    bins = BINS
    pitch = PITCH
    angle_edges = (-ANGLE_EDGE, ANGLE_EDGE)
    angle_gaps = (CONTACT, CONTACT)
    view = (400, 480)

    def __init__(self, plates: int = PLATES) -> None:
        self.top = plates + 1
        super().__init__(_specify(), ["base"], ["finger"])
        self._plates = [self.model.geom(f"plate-{level}").id for level in range(1, PLATES + 1)]

    def parameters(self) -> dict[str, Any]:
        """Thresholds and the number of plates there is room for."""
        return {"pitch": PITCH, "angle_edge": ANGLE_EDGE, "capacity": PLATES}

    def hidden_parts(self) -> Sequence[int]:
        """Heights 0 … ``PLATES``."""
        return range(PLATES + 1)

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


@register("top-plate")
class TopPlateTask(Task):
    """A grasp succeeds at the top plate; y counts the domain's stack heights."""

    scene = TopPlateScene

    def __init__(self, domain: Domain, finger: Finger) -> None:
        super().__init__(domain, finger)
        assert isinstance(domain.layout, TouchLayout)
        self._heights = domain.layout.places[:, 0].tolist()

    @classmethod
    def make_scene(cls, domain: Domain) -> Scene:
        """Build the scene; a lower stack lets the finger go less high."""
        return cls.scene(domain.model.n_observed // BINS - 2)

    def reset(self, x: int, y: int) -> Step:
        """Begin at x, which is level 0."""
        return Step(self.finger.reset(self._heights[y], x // BINS).reading)

    def act(self, action: int) -> Step:
        """Move or grasp."""
        if action != GRASP:
            return Step(self.finger.act(action).reading)
        level, angle = divmod(self.finger.measurement.reading, BINS)
        touches = angle != NEUTRAL
        return Step(
            self.finger.measurement.reading, ended=True, success=touches and level == self.finger.hidden
        )


def _specify() -> mujoco.MjSpec:
    """Add the plates and a rack and a stage of their height."""
    spec = mujoco.MjSpec.from_file(str(HERE / "top_plate.xml"))
    world, fitting = spec.worldbody, spec.find_default("fitting")
    for level in range(1, PLATES + 1):
        world.add_geom(
            spec.find_default("object"),
            name=f"plate-{level}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[PLATE_RADIUS, PLATE_HALF_HEIGHT, 0],
            pos=[0, 0, PITCH * level],
            rgba=GLAZES[level % 2],
        )
    half = PITCH * (PLATES + 2) / 2
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
