"""Where things lie: the states of a grid domain on its map, finger and objects of a robot domain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cell = tuple[int, int]  # (row, column), row 0 at the top


@dataclass(frozen=True, eq=False, kw_only=True)
class GridLayout:
    """A map of open cells, and for every state the agent's cell, its heading and the quality of the rocks."""

    shape: Cell
    """(rows, columns) of the drawing."""
    cells: tuple[Cell, ...]
    """The open cells; all others are walls."""
    positions: NDArray[np.int64]  # (S, 2) the agent's (row, column); -1 off the map
    headings: NDArray[np.int64] | None  # (S,) 0 north, clockwise; None: the agent has no heading
    goal: Cell | None
    rocks: tuple[Cell, ...]
    qualities: NDArray[np.bool_]  # (S, rocks): which are good

    def marginal(self, belief: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the belief over the map, (rows, columns, 4 headings or 1)."""
        turns = 1 if self.headings is None else 4
        heading = np.zeros(len(belief), dtype=np.int64) if self.headings is None else self.headings
        on_map = self.positions[:, 0] >= 0
        total = np.zeros((*self.shape, turns))
        row, column = self.positions[on_map].T
        np.add.at(total, (row, column, heading[on_map]), belief[on_map])
        return total


@dataclass(frozen=True, eq=False, kw_only=True)
class TouchLayout:
    """The cells a finger moves between, where it is at each x, and where the hidden objects are for each y."""

    shape: Cell
    """(rows, columns) of the cells, numbered row by row; row 0 is the lowest or nearest."""
    finger: NDArray[np.int64]  # (X,) the finger's cell
    objects: tuple[str, ...]
    """What is hidden, such as ``("left bump", "right bump")``."""
    places: NDArray[np.int64]  # (Y, objects) the cell of each object

    def marginal(self, belief: NDArray[np.floating[Any]], which: int) -> NDArray[np.float64]:
        """Return the probability of each cell for one object, shape ``shape``."""
        total = np.zeros(self.shape)
        np.add.at(total.reshape(-1), self.places[:, which], belief)
        return total
