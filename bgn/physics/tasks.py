"""What a task is: what an action means, what ends an episode, what earns the reward, on any finger.

A finger is a MuJoCo scene, or an arm with its gripper. Everything is judged by what it measures, never by the tables.
The task of each robot domain stands beside its scene.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.physics.scene import Measurement, Scene


@dataclass(frozen=True)
class Step:
    """What one action led to."""

    x: int
    """Index of the observed part, as the domain's tables count it."""
    ended: bool = False
    success: bool = False


class Finger(Protocol):
    """What a task needs of the finger it is done with."""

    @property
    def hidden(self) -> int:
        """The hidden part that the objects were last placed by, as the scene counts it."""
        ...

    @property
    def measurement(self) -> Measurement:
        """What was measured last."""
        ...

    def reset(self, hidden: int, cell: int) -> Measurement:
        """Place the objects, and the finger in a cell, neutral."""
        ...

    def act(self, action: int) -> Measurement:
        """Make a move; one out of range is refused and leaves everything as it is."""
        ...


class Task(ABC):
    """A robot domain's rules on a finger."""

    scene: ClassVar[Callable[..., Scene]]
    """The finger in MuJoCo."""

    def __init__(self, domain: Domain, finger: Finger) -> None:
        self.domain, self.finger = domain, finger

    @classmethod
    def make_scene(cls, domain: Domain) -> Scene:
        """Build the scene of a domain's variant."""
        return cls.scene()

    @abstractmethod
    def reset(self, x: int, y: int) -> Step:
        """Begin an episode in the domain's state (x, y)."""

    @abstractmethod
    def act(self, action: int) -> Step:
        """Take one of the domain's actions."""


_TASKS: dict[str, type[Task]] = {}
AnyTask = TypeVar("AnyTask", bound=type[Task])


def register(domain_id: str) -> Callable[[AnyTask], AnyTask]:
    """Register the decorated class as the task of a robot domain."""

    def decorate(task: AnyTask) -> AnyTask:
        _TASKS[domain_id] = task
        return task

    return decorate


def task_of(domain_id: str) -> type[Task]:
    """Return the task of a robot domain.

    Raises
    ------
    InputError
        The domain has no physics.
    """
    _load_tasks()
    if domain_id not in _TASKS:
        raise InputError(f"domain {domain_id!r} has no physics; those that have: {', '.join(sorted(_TASKS))}")
    return _TASKS[domain_id]


def draw_start(domain: Domain, rng: np.random.Generator) -> tuple[int, int]:
    """Draw (x, y) from the domain's start distribution."""
    start = domain.model.joint.start
    support = np.flatnonzero(start)
    s = int(rng.choice(support, p=start[support] / start[support].sum()))
    return divmod(s, domain.model.n_hidden)


def _load_tasks() -> None:
    """Import the modules that register their task; named, so that the code hash of a run in physics covers them."""
    from bgn.physics import top_plate, two_bumps_1d, two_bumps_2d  # noqa: F401
