"""The three tasks on their MuJoCo scenes: what an action means, what ends an episode, what earns the reward.

Everything is judged by what the scene measures, never by the tables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d
from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.physics.scene import Scene
from bgn.physics.top_plate import TopPlateScene
from bgn.physics.two_bumps_1d import TwoBumps1DScene
from bgn.physics.two_bumps_2d import TwoBumps2DScene


@dataclass(frozen=True)
class Step:
    """What one action led to."""

    x: int
    """Index of the observed part, as the domain's tables count it."""
    ended: bool = False
    success: bool = False


class Task(Protocol):
    """A domain's rules on its scene."""

    scene: Scene

    def reset(self, x: int, y: int) -> Step:
        """Begin an episode in the domain's state (x, y)."""
        ...

    def act(self, action: int) -> Step:
        """Take one of the domain's actions."""
        ...


class TopPlateTask:
    """A grasp succeeds at the top plate; y counts the domain's stack heights."""

    def __init__(self, domain: Domain) -> None:
        levels = domain.model.n_observed // top_plate.BINS
        names = domain.model.joint.state_names[: domain.model.n_hidden]  # "reading|height-k" of the first x
        self._heights = [int(name.rpartition("-")[2]) for name in names]
        self.scene: Scene = TopPlateScene(levels - 2)

    def reset(self, x: int, y: int) -> Step:
        """Begin at x, which is level 0."""
        return Step(self.scene.reset(self._heights[y], x // top_plate.BINS).reading)

    def act(self, action: int) -> Step:
        """Move or grasp."""
        if action != top_plate.GRASP:
            return Step(self.scene.act(action).reading)
        level, angle = divmod(self.scene.measurement.reading, top_plate.BINS)
        touches = angle != top_plate.NEUTRAL
        return Step(
            self.scene.measurement.reading, ended=True, success=touches and level == self.scene.hidden
        )


class TwoBumps1DTask:
    """Any push ends the episode; it succeeds if the right bump went right."""

    def __init__(self, domain: Domain) -> None:
        self.scene: Scene = TwoBumps1DScene()

    def reset(self, x: int, y: int) -> Step:
        """Begin with a neutral finger at x's cell."""
        return Step(self.scene.reset(y, x // two_bumps_1d.BINS).reading)

    def act(self, action: int) -> Step:
        """Move softly or stiffly."""
        measurement = self.scene.act(action)
        success = measurement.pushed == two_bumps_1d.RIGHT_BUMP_RIGHT
        return Step(measurement.reading, ended=measurement.pushed != 0, success=success)


class TwoBumps2DTask:
    """A grasp succeeds at the large bump once both were felt."""

    def __init__(self, domain: Domain) -> None:
        self.scene: Scene = TwoBumps2DScene()
        self._felt = 0

    def reset(self, x: int, y: int) -> Step:
        """Begin with a neutral finger at x's cell and nothing felt."""
        self._felt = 0
        cell = x // two_bumps_2d.FLAGS // two_bumps_2d.BINS
        return self._step(self.scene.reset(y, cell).reading)

    def act(self, action: int) -> Step:
        """Move or grasp."""
        if action != two_bumps_2d.GRASP:
            return self._step(self.scene.act(action).reading)
        size = abs(self.scene.measurement.reading % two_bumps_2d.BINS - two_bumps_2d.NEUTRAL)
        success = size == 2 and self._felt == two_bumps_2d.FLAGS - 1
        return Step(self._step(self.scene.measurement.reading).x, ended=True, success=success)

    def _step(self, reading: int) -> Step:
        size = abs(reading % two_bumps_2d.BINS - two_bumps_2d.NEUTRAL)
        self._felt |= (0, 2, 1)[size]  # bit 0: the large bump, bit 1: the small one
        return Step(reading * two_bumps_2d.FLAGS + self._felt)


_TASKS: Final[dict[str, Callable[[Domain], Task]]] = {
    "top-plate": TopPlateTask,
    "two-bumps-1d": TwoBumps1DTask,
    "two-bumps-2d": TwoBumps2DTask,
}


def make_task(domain: Domain) -> Task:
    """Return the task of a robot domain.

    Raises
    ------
    ValueError
        The domain has no physics.
    """
    if domain.id not in _TASKS:
        raise InputError(f"domain {domain.id!r} has no physics; those that have: {', '.join(_TASKS)}")
    return _TASKS[domain.id](domain)


def draw_start(domain: Domain, rng: np.random.Generator) -> tuple[int, int]:
    """Draw (x, y) from the domain's start distribution."""
    start = domain.model.joint.start
    support = np.flatnonzero(start)
    s = int(rng.choice(support, p=start[support] / start[support].sum()))
    return divmod(s, domain.model.n_hidden)
