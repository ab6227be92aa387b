"""The objects before the twin: where a hidden part puts them, and whether one was pushed."""

from __future__ import annotations

from typing import Final, Protocol

import mujoco
import numpy as np

from bgn.domains import two_bumps_1d as bumps_1d
from bgn.domains import two_bumps_2d as bumps_2d
from bgn.domains.top_plate import PLATES
from bgn.physics import top_plate as plates_scene
from bgn.physics import two_bumps_1d as scene_1d
from bgn.physics import two_bumps_2d as scene_2d
from bgn.robot.kinematics import Floats


class Objects(Protocol):
    """What stands in one task's scene."""

    def count(self) -> int:
        """Return how many hidden parts there are."""
        ...

    def place(self, hidden: int, errors: Floats) -> None:
        """Put everything where the hidden part says, each object off by one of ``errors`` (metres)."""
        ...

    def clear(self) -> None:
        """Take everything away."""
        ...

    def pushed(self) -> int:
        """Return 0, or the 1-based index of the bump that was pushed, negative if towards smaller cells."""
        ...


class Plates:
    """A stack; the hidden part is its height."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model = model
        self._geoms = [model.geom(f"plate-{level}").id for level in range(1, PLATES + 1)]
        self.clear()

    def count(self) -> int:
        """Return how many heights there are, 0 included."""
        return len(self._geoms) + 1

    def place(self, hidden: int, errors: Floats) -> None:
        """Stack plates; an error is one of height."""
        for level, geom in enumerate(self._geoms, start=1):
            there = level <= hidden
            self._model.geom_contype[geom] = 2 * there
            self._model.geom_conaffinity[geom] = 1 * there
            self._model.geom_rgba[geom, 3] = float(there)
            self._model.geom_pos[geom, 2] = plates_scene.PITCH * level + errors[level % len(errors)]

    def clear(self) -> None:
        """Take all plates away."""
        self.place(0, np.zeros(1))

    def pushed(self) -> int:
        """Return 0: plates are not pushed."""
        return 0


class Ridges:
    """Two sliding bumps; the hidden part is an index into ``two_bumps_1d.PAIRS``."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        joints = [model.joint(f"bump-{i}") for i in range(2)]
        self._positions, self._speeds = [j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]
        self._geoms = [model.geom(f"bump-{i}").id for i in range(2)]
        self._starts = np.zeros(2)
        self.clear()

    def count(self) -> int:
        """Return how many pairs of cells there are."""
        return len(bumps_1d.PAIRS)

    def place(self, hidden: int, errors: Floats) -> None:
        """Put both bumps at rest into their cells; an error is one along the table."""
        self._show(True)
        self._starts = scene_1d.PITCH * np.array(bumps_1d.PAIRS[hidden]) + np.resize(errors, 2)
        self._data.qpos[self._positions] = self._starts
        self._data.qvel[self._speeds] = 0

    def clear(self) -> None:
        """Take both bumps away."""
        self._show(False)

    def pushed(self) -> int:
        """Return which bump moved, and which way."""
        shifts = self._data.qpos[self._positions] - self._starts
        furthest = int(np.abs(shifts).argmax())
        if abs(shifts[furthest]) <= scene_1d.MOVED:
            return 0
        return (furthest + 1) * (1 if shifts[furthest] > 0 else -1)

    def _show(self, there: bool) -> None:
        for geom in self._geoms:
            self._model.geom_contype[geom], self._model.geom_conaffinity[geom] = 2 * there, 1 * there
            self._model.geom_rgba[geom, 3] = float(there)


class Domes:
    """Two fixed bumps; the hidden part is an index into ``two_bumps_2d.PAIRS``."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._data = data
        self._bodies = [int(model.body(f"bump-{i}").mocapid[0]) for i in range(2)]
        self.clear()

    def count(self) -> int:
        """Return how many pairs of cells there are."""
        return len(bumps_2d.PAIRS)

    def place(self, hidden: int, errors: Floats) -> None:
        """Put both bumps into their cells; errors are along both directions of the table."""
        centre = scene_2d.PITCH * (bumps_2d.SIDE - 1) / 2
        off = np.resize(errors, 4).reshape(2, 2)
        for bump, cell in enumerate(bumps_2d.PAIRS[hidden]):
            row, column = divmod(cell, bumps_2d.SIDE)
            x, y = scene_2d.PITCH * np.array([column, row]) - centre + off[bump]
            self._data.mocap_pos[self._bodies[bump]] = x, y, 0

    def clear(self) -> None:
        """Sink both bumps below the table."""
        for body in self._bodies:
            self._data.mocap_pos[body] = 0, 0, -5

    def pushed(self) -> int:
        """Return 0: these bumps do not move."""
        return 0


OBJECTS: Final[dict[str, type[Plates] | type[Ridges] | type[Domes]]] = {
    "top-plate": Plates,
    "two-bumps-1d": Ridges,
    "two-bumps-2d": Domes,
}
