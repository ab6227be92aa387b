"""The three force-feedback domains as they are defined, move by move, independently of any physics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d

IMPOSSIBLE = -1


def top_plate_moves(plates: int, heights: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reading (level, bin) after down and up, shape (X, 2, heights)."""
    levels = plates + 2
    out = np.full((levels * 3, 2, len(heights)), IMPOSSIBLE)
    for x in range(levels * 3):
        level, angle = divmod(x, 3)
        for h, height in enumerate(heights):
            on_plate = 1 <= level <= height
            if on_plate == (angle == 1):
                continue
            if on_plate and angle == 2 and level == levels - 1:
                continue  # nothing is above, from where the finger could come down onto it
            for action, step in ((0, -1), (1, 1)):
                to = level + step
                if not 0 <= to < levels:
                    out[x, action, h] = x
                else:
                    out[x, action, h] = to * 3 + (1 - step if 1 <= to <= height else 1)
    return out


def two_bumps_1d_moves() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Reading after each action, and the signed 1-based bump that it pushes (then the reading stays)."""
    out = np.full((45, 4, 39), IMPOSSIBLE)
    pushed = np.zeros_like(out)
    for x in range(45):
        cell, angle = divmod(x, 3)
        for y, pair in enumerate(two_bumps_1d.PAIRS):
            if (cell in pair) == (angle == 1):
                continue  # a finger is deflected exactly on the bumps
            for a, (step, stiff) in enumerate(((-1, False), (-1, True), (1, False), (1, True))):
                to = cell + step
                if not 0 <= to <= 14:
                    out[x, a, y] = x
                elif stiff and to in pair:
                    pushed[x, a, y] = step * (1 + pair.index(to))
                    out[x, a, y] = x
                elif stiff and angle == 1 - step:  # it leaves a bump through the bump
                    pushed[x, a, y] = step * (1 + pair.index(cell))
                    out[x, a, y] = x
                else:
                    out[x, a, y] = to * 3 + (1 - step if to in pair else 1)
    return out, pushed


def two_bumps_2d_moves() -> NDArray[np.int64]:
    """Reading (cell, bin) after each of the four moves, shape (80, 4, 192)."""
    out = np.full((80, 4, 192), IMPOSSIBLE)
    steps = ((0, -1), (0, 1), (-1, 0), (1, 0))  # (rows, columns)
    for x in range(80):
        cell, angle = divmod(x, 5)
        row, column = divmod(cell, 4)
        for y, (large, small) in enumerate(two_bumps_2d.PAIRS):
            size = {large: 2, small: 1}.get(cell, 0)
            cornered = (cell == 0 and angle < 2) or (cell == 15 and angle > 2)
            if abs(angle - 2) != size or cornered:
                continue
            for a, (rows, columns) in enumerate(steps):
                if not (0 <= row + rows <= 3 and 0 <= column + columns <= 3):
                    out[x, a, y] = x
                    continue
                to = (row + rows) * 4 + column + columns
                out[x, a, y] = to * 5 + 2 - {large: 2, small: 1}.get(to, 0) * (rows + columns)
    return out


def definition(domain_id: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Reading and push of every move, as the shipped tables hold them."""
    if domain_id == "two-bumps-1d":
        return two_bumps_1d_moves()
    if domain_id == "two-bumps-2d":
        moves = two_bumps_2d_moves()
    else:
        moves = top_plate_moves(top_plate.PLATES, np.arange(top_plate.PLATES + 1))
    return moves, np.zeros_like(moves)
