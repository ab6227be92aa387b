"""Noisy navigation in a corridor map: what Hallway and Hallway-2 share (Littman et al. 1995; paper, App. C).

A map is drawn as rows of characters: ``*`` a cell, ``+`` the goal cell, anything else a wall. Cells are
numbered row by row; a state is ``4 * cell + heading`` with headings clockwise from north.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import prod

import numpy as np

from bgn.domains.layout import GridLayout
from bgn.pomdp.model import MOMDP, POMDP, sparse_rows

HEADINGS = ("N", "E", "S", "W")
STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))  # (row, column) moved by one step north, east, south, west
SOUTH = 2

ACTIONS = ("stay", "forward", "turn-right", "turn-around", "turn-left")
FORWARD = 1

#: Where "forward" goes: (direction moved, turn of the heading) in quarter turns clockwise, probability.
#: The remaining .05 is no motion at all.
DRIFT = (
    ((0, 0), 0.8),  # ahead
    ((1, 1), 0.05),  # right-hand cell, turned right
    ((3, 3), 0.05),  # left-hand cell, turned left
    ((2, 0), 0.025),  # back, keeping the heading
    ((2, 2), 0.025),  # back, turned round
)
NO_MOTION = 0.05

#: Probability of turning by 0, 1, 2, 3 quarter turns clockwise.
TURNS = {
    "stay": (1.0, 0.0, 0.0, 0.0),
    "turn-right": (0.1, 0.7, 0.1, 0.1),
    "turn-around": (0.1, 0.15, 0.6, 0.15),
    "turn-left": (0.1, 0.1, 0.1, 0.7),
}

WALL_SEEN = 0.9  # P(sensor reports a wall | wall)
FALSE_ALARM = 0.05  # P(sensor reports a wall | free)

DISCOUNT = 0.95  # paper, Table 4
GOAL_REWARD = 1.0


@dataclass(frozen=True)
class CorridorMap:
    """A drawn map: its cells (row, column) in reading order, and the index of the goal cell among them."""

    rows: tuple[str, ...]

    @cached_property
    def cells(self) -> tuple[tuple[int, int], ...]:
        """(row, column) of every cell, in reading order."""
        return tuple(
            (r, c) for r, row in enumerate(self.rows) for c, character in enumerate(row) if character in "*+"
        )

    @cached_property
    def goal(self) -> int:
        """Index of the goal cell."""
        return next(i for i, (r, c) in enumerate(self.cells) if self.rows[r][c] == "+")

    @cached_property
    def index(self) -> Mapping[tuple[int, int], int]:
        """Cell index by (row, column)."""
        return {cell: i for i, cell in enumerate(self.cells)}

    def neighbour(self, cell: int, direction: int) -> int | None:
        """Return the cell one step away in an absolute direction (0 north, clockwise), or None for a wall."""
        row, column = self.cells[cell]
        d_row, d_column = STEPS[direction % 4]
        return self.index.get((row + d_row, column + d_column))


def build_model(corridors: CorridorMap, landmarks: Sequence[int] = ()) -> MOMDP:
    """Return the model of a map; ``landmarks`` are cells recognised with certainty when facing south.

    Observations: 16 wall patterns (bits front 8, right 4, back 2, left 1), the landmarks, the goal.
    """
    n_cells, n_states = len(corridors.cells), 4 * len(corridors.cells)
    n_observations = 16 + len(landmarks) + 1
    goals = range(4 * corridors.goal, 4 * corridors.goal + 4)
    start = np.full(n_states, 1 / (n_states - 4))
    start[goals] = 0.0
    reset = np.zeros((len(ACTIONS), n_states), dtype=np.bool_)
    reset[:, goals] = True
    restart = dict(enumerate(start))
    transitions = tuple(
        sparse_rows(
            [restart if s in goals else _successors(corridors, s, a) for s in range(n_states)], n_states
        )
        for a in ACTIONS
    )
    sight = [_sight(corridors, s, landmarks) for s in range(n_states)]
    rewards = np.zeros((1, 1, n_states, 1))
    rewards[0, 0, goals, 0] = GOAL_REWARD
    return MOMDP(
        POMDP(
            transitions=transitions,
            observations=(sparse_rows(sight, n_observations),) * len(ACTIONS),
            rewards=rewards,
            start=start,
            reset=reset,
            discount=DISCOUNT,
            state_names=tuple(
                f"{'goal' if cell == corridors.goal else f'c{cell}'}{heading}"
                for cell, heading in product(range(n_cells), HEADINGS)
            ),
            action_names=ACTIONS,
            observation_names=observation_names(len(landmarks)),
        )
    )


def build_layout(corridors: CorridorMap) -> GridLayout:
    """Return where the states of a map lie."""
    n_states = 4 * len(corridors.cells)
    return GridLayout(
        shape=(len(corridors.rows), max(map(len, corridors.rows))),
        cells=corridors.cells,
        positions=np.repeat(np.array(corridors.cells), 4, axis=0),
        headings=np.tile(np.arange(4), len(corridors.cells)),
        goal=corridors.cells[corridors.goal],
        rocks=(),
        qualities=np.zeros((n_states, 0), dtype=np.bool_),
    )


def observation_names(n_landmarks: int) -> tuple[str, ...]:
    """Name wall patterns by the sides that show a wall (F, R, B, L), then the landmarks, then the goal."""
    patterns = (
        "".join(side for bit, side in zip((8, 4, 2, 1), "FRBL", strict=True) if pattern & bit)
        for pattern in range(16)
    )
    walls = (f"wall{'-' + sides if sides else 's-none'}" for sides in patterns)
    return (*walls, *(f"landmark{i}" for i in range(n_landmarks)), "goal")


def _successors(corridors: CorridorMap, state: int, action: str) -> dict[int, float]:
    """T(s, a, .) of a state outside the goal."""
    cell, heading = divmod(state, 4)
    if action != ACTIONS[FORWARD]:
        return {4 * cell + (heading + turn) % 4: p for turn, p in enumerate(TURNS[action]) if p}
    mass: dict[int, float] = defaultdict(float)
    blocked = NO_MOTION
    for (direction, turn), p in DRIFT:
        destination = corridors.neighbour(cell, heading + direction)
        if destination is None:
            blocked += p
        else:
            mass[4 * destination + (heading + turn) % 4] += p
    mass[state] += blocked
    return {s: _decimal(p) for s, p in mass.items()}


def _sight(corridors: CorridorMap, state: int, landmarks: Sequence[int]) -> dict[int, float]:
    """O(s', ., .): what is seen on arrival in a state."""
    cell, heading = divmod(state, 4)
    if cell == corridors.goal:
        return {16 + len(landmarks): 1.0}
    if heading == SOUTH and cell in landmarks:
        return {16 + landmarks.index(cell): 1.0}
    walls = [
        corridors.neighbour(cell, heading + side) is None for side in range(4)
    ]  # front, right, back, left
    alarms = [WALL_SEEN if wall else FALSE_ALARM for wall in walls]
    return {
        pattern: _decimal(
            prod(p if pattern & bit else 1 - p for p, bit in zip(alarms, (8, 4, 2, 1), strict=True))
        )
        for pattern in range(16)
    }


def _decimal(p: float) -> float:
    """Undo the rounding of sums and products: every probability here is a decimal of at most 8 digits."""
    return round(p, 12)
