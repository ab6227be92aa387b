"""Policies written by hand: those the paper says its agents learned (Section 5.3).

They see what any history agent sees, the readings and their own actions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import numpy as np

from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d
from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.simulation.policy import Policy

_SCRIPTS: dict[str, Callable[[Domain], Policy]] = {}
AnyPolicy = TypeVar("AnyPolicy", bound=Callable[[Domain], Policy])


def describes(domain_id: str) -> Callable[[AnyPolicy], AnyPolicy]:
    """Register the decorated class as what the paper describes for a domain."""

    def decorate(policy: AnyPolicy) -> AnyPolicy:
        _SCRIPTS[domain_id] = policy
        return policy

    return decorate


@describes("top-plate")
class TopPlatePolicy:
    """Go up until no plate is felt, one level down, grasp; at the highest possible plate grasp at once."""

    def __init__(self, domain: Domain) -> None:
        self._last_level = domain.model.n_observed // top_plate.BINS - 1
        self.reset()

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Begin anew; nothing is drawn."""
        self._above = False

    def act(self, observation: int, last_action: int | None) -> int:
        """Return the next action."""
        level, angle = divmod(observation, top_plate.BINS)
        felt = angle != top_plate.NEUTRAL
        if felt and (self._above or level == self._last_level - 1):
            return top_plate.GRASP
        self._above = not felt and level > 0
        return top_plate.DOWN if self._above else top_plate.UP


@describes("two-bumps-1d")
class TwoBumps1DPolicy:
    """Right until past a bump, then stiff; failing that, back left past a bump, then right stiffly.

    The bump that is pushed is then the right one: either the second one met, or the last one on the way.
    """

    def __init__(self, domain: Domain) -> None:
        self._last_cell = domain.model.n_observed // two_bumps_1d.BINS - 1
        self.reset()

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Begin anew; nothing is drawn."""
        self._rightwards = True
        self._met = False

    def act(self, observation: int, last_action: int | None) -> int:
        """Return the next action."""
        cell, angle = divmod(observation, two_bumps_1d.BINS)
        if angle != two_bumps_1d.NEUTRAL:  # on a bump: leave it softly, the way the finger was going
            self._met = True
            return two_bumps_1d.RIGHT_SOFT if self._rightwards else two_bumps_1d.LEFT_SOFT
        if self._rightwards and cell == self._last_cell:
            self._rightwards = self._met = False
        elif not self._rightwards and self._met:
            self._rightwards = True
        if not self._rightwards:
            return two_bumps_1d.LEFT_SOFT
        return two_bumps_1d.RIGHT_STIFF if self._met else two_bumps_1d.RIGHT_SOFT


@describes("two-bumps-2d")
class TwoBumps2DPolicy:
    """Follow a closed tour of the grid until both bumps were felt, then go straight to the large one."""

    #: The next cell of a tour through all sixteen: up the first column, then to and fro along the others.
    _TOUR: Final = (0, 4, 8, 12, 13, 14, 15, 11, 10, 9, 5, 6, 7, 3, 2, 1)

    def __init__(self, domain: Domain) -> None:
        self.reset()

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Begin anew; nothing is drawn."""
        self._large: int | None = None
        self._small: int | None = None

    def act(self, observation: int, last_action: int | None) -> int:
        """Return the next action."""
        cell, angle = divmod(observation, two_bumps_2d.BINS)
        size = abs(angle - two_bumps_2d.NEUTRAL)
        if size == 2:
            self._large = cell
        elif size == 1:
            self._small = cell
        if self._large is None or self._small is None:
            tour = self._TOUR
            return self._towards(cell, tour[(tour.index(cell) + 1) % len(tour)])
        return two_bumps_2d.GRASP if cell == self._large else self._towards(cell, self._large)

    @staticmethod
    def _towards(cell: int, target: int) -> int:
        (row, column), (to_row, to_column) = (divmod(c, two_bumps_2d.SIDE) for c in (cell, target))
        if column != to_column:
            return two_bumps_2d.LEFT if to_column < column else two_bumps_2d.RIGHT
        return two_bumps_2d.BACKWARD if to_row < row else two_bumps_2d.FORWARD


def scripted_policy(domain: Domain) -> Policy:
    """Return the policy that the paper describes for a robot domain; it succeeds in every episode.

    Raises
    ------
    ValueError
        The paper describes none for this domain.
    """
    if domain.id not in _SCRIPTS:
        raise InputError(
            f"no scripted policy for {domain.id!r}; there is one for {', '.join(sorted(_SCRIPTS))}"
        )
    return _SCRIPTS[domain.id](domain)
