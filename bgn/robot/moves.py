"""What each move of a task asks of a finger; further actions of a domain are grasps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from bgn.domains import top_plate, two_bumps_1d


@dataclass(frozen=True)
class Move:
    """One cell along an axis of the grid."""

    axis: int
    direction: int
    stiff: bool = False


MOVES: Final = {
    "top-plate": {top_plate.DOWN: Move(0, -1), top_plate.UP: Move(0, 1)},
    "two-bumps-1d": {
        two_bumps_1d.LEFT_SOFT: Move(0, -1),
        two_bumps_1d.LEFT_STIFF: Move(0, -1, stiff=True),
        two_bumps_1d.RIGHT_SOFT: Move(0, 1),
        two_bumps_1d.RIGHT_STIFF: Move(0, 1, stiff=True),
    },
    "two-bumps-2d": {0: Move(0, -1), 1: Move(0, 1), 2: Move(1, -1), 3: Move(1, 1)},
}
