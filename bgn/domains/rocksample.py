"""RockSample[n,k]: sample good rocks, then drive off the east edge (Smith & Simmons 2004; paper, App. C).

State ``(x * n + y) * 2**k + m`` on an n x n grid, x to the east, y to the north; m holds the rocks' quality,
rock 0 in the most significant bit, 1 = good. The last state is terminal. Actions: north, east, south, west,
check_0 ... check_{k-1}, sample. Observations: ``ogood``, ``obad``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist, log

import numpy as np

from bgn.domains.domain import Domain
from bgn.domains.layout import GridLayout
from bgn.domains.registry import register
from bgn.errors import InputError
from bgn.pomdp.model import MOMDP, POMDP, sparse_rows

Cell = tuple[int, int]

MOVES: dict[str, Cell] = {"north": (0, 1), "east": (1, 0), "south": (0, -1), "west": (-1, 0)}
GOOD, BAD = 0, 1  # observations

EXIT_REWARD = 10.0  # leaving over the east edge
SAMPLE_REWARD = 10.0  # sampling a good rock; a bad one costs as much
CRASH_REWARD = -100.0  # leaving elsewhere, or sampling where there is no rock: in the files, not in the paper
DISCOUNT = 0.95  # paper, Table 4


@dataclass(frozen=True, kw_only=True)
class RockSample:
    """An instance: grid size, rock cells, start cell and how fast the sensor's efficiency decays.

    A check is right with probability (1 + 2^(-d / half_efficiency_distance)) / 2, d the Euclidean distance.
    """

    n: int
    rocks: tuple[Cell, ...]
    start: Cell
    half_efficiency_distance: float

    def __post_init__(self) -> None:
        if self.n < 1:
            raise InputError(f"a grid of n = {self.n}; n must be at least 1")
        cells = {(x, y) for x in range(self.n) for y in range(self.n)}
        for what, cell in (*(("rock", rock) for rock in self.rocks), ("start", self.start)):
            if cell not in cells:
                raise InputError(f"{what} cell {cell} is outside the {self.n} x {self.n} grid")
        if len(set(self.rocks)) != len(self.rocks):
            raise InputError(f"two rocks share a cell: {self.rocks}")
        if not self.half_efficiency_distance > 0:
            raise InputError(f"half_efficiency_distance {self.half_efficiency_distance} is not positive")

    @property
    def n_qualities(self) -> int:
        """2^k assignments of good and bad to the rocks."""
        return 1 << len(self.rocks)

    @property
    def terminal(self) -> int:
        """Index of the terminal state."""
        return self.n * self.n * self.n_qualities

    @property
    def action_names(self) -> tuple[str, ...]:
        """north, east, south, west, check_0 ... check_{k-1}, sample."""
        return (*MOVES, *(f"check_{i}" for i in range(len(self.rocks))), "sample")

    @property
    def state_names(self) -> tuple[str, ...]:
        """``s<x><y><bits>`` (``_`` between the parts where n > 10), then ``st``."""
        gap, k = "_" if self.n > 10 else "", len(self.rocks)
        names = []
        for state in range(self.terminal):
            x, y, m = self.unpack(state)
            names.append(gap.join(("s" + str(x), str(y), f"{m:0{k}b}" if k else "")))
        return (*names, "st")

    def unpack(self, state: int) -> tuple[int, int, int]:
        """Return (x, y, qualities) of a non-terminal state."""
        cell, m = divmod(state, self.n_qualities)
        return *divmod(cell, self.n), m

    def pack(self, x: int, y: int, m: int) -> int:
        """Return the index of a non-terminal state."""
        return (x * self.n + y) * self.n_qualities + m

    def bit(self, rock: int) -> int:
        """Return the mask of a rock within the qualities."""
        return 1 << (len(self.rocks) - 1 - rock)

    def outcome(self, state: int, action: str) -> tuple[int, float]:
        """Return the one successor of a non-terminal state and the reward."""
        x, y, m = self.unpack(state)
        if action in MOVES:
            dx, dy = MOVES[action]
            return self._move(x + dx, y + dy, m)
        if action == "sample":
            return self._sample(x, y, m)
        return state, 0.0

    def _move(self, x: int, y: int, m: int) -> tuple[int, float]:
        if x == self.n:
            return self.terminal, EXIT_REWARD
        if not (x >= 0 and 0 <= y < self.n):
            return self.terminal, CRASH_REWARD
        return self.pack(x, y, m), 0.0

    def _sample(self, x: int, y: int, m: int) -> tuple[int, float]:
        if (x, y) not in self.rocks:
            return self.terminal, CRASH_REWARD
        bit = self.bit(self.rocks.index((x, y)))
        return self.pack(x, y, m & ~bit), SAMPLE_REWARD if m & bit else -SAMPLE_REWARD

    def reading(self, state: int, action: str) -> dict[int, float]:
        """O(s', a, .): only a check in a non-terminal state can report anything but ``ogood``."""
        if state == self.terminal or not action.startswith("check_"):
            return {GOOD: 1.0}
        x, y, m = self.unpack(state)
        rock = int(action.removeprefix("check_"))
        efficiency = 2.0 ** (-dist((x, y), self.rocks[rock]) / self.half_efficiency_distance)
        right = 0.5 * (1.0 + efficiency)
        good = right if m & self.bit(rock) else 1.0 - right
        return {GOOD: good, BAD: 1.0 - good}


def build_model(instance: RockSample) -> MOMDP:
    """Return the model of an instance, as a POMDP (nothing is fully observed)."""
    terminal, actions = instance.terminal, instance.action_names
    n_states = terminal + 1
    first = instance.pack(*instance.start, 0)
    start = np.zeros(n_states)
    start[first : first + instance.n_qualities] = 1 / instance.n_qualities
    reset = np.zeros((len(actions), n_states), dtype=np.bool_)
    reset[:, terminal] = True
    restart = dict(enumerate(start))
    rewards = np.zeros((len(actions), n_states, 1, 1))
    transitions = []
    for a, action in enumerate(actions):
        outcomes = [instance.outcome(s, action) for s in range(terminal)]
        rewards[a, :terminal, 0, 0] = [reward for _, reward in outcomes]
        transitions.append(sparse_rows([*({s: 1.0} for s, _ in outcomes), restart], n_states))
    observations = tuple(
        sparse_rows([instance.reading(s, action) for s in range(n_states)], 2) for action in actions
    )
    return MOMDP(
        POMDP(
            transitions=tuple(transitions),
            observations=observations,
            rewards=rewards,
            start=start,
            reset=reset,
            discount=DISCOUNT,
            state_names=instance.state_names,
            action_names=actions,
            observation_names=("ogood", "obad"),
        )
    )


def build_layout(instance: RockSample) -> GridLayout:
    """Return where the states of an instance lie, north up; the terminal state is off the map."""
    n, k = instance.n, len(instance.rocks)
    cell, m = np.divmod(np.arange(instance.terminal), instance.n_qualities)
    positions = np.stack([n - 1 - cell % n, cell // n], axis=1)
    bits = m[:, None] & np.array([instance.bit(rock) for rock in range(k)], dtype=np.int64)
    return GridLayout(
        shape=(n, n),
        cells=tuple((row, column) for row in range(n) for column in range(n)),
        positions=np.concatenate([positions, [[-1, -1]]]),
        headings=None,
        goal=None,
        rocks=tuple((n - 1 - y, x) for x, y in instance.rocks),
        qualities=np.concatenate([bits > 0, np.zeros((1, k), dtype=np.bool_)]),
    )


def rocksample(
    n: int,
    rocks: Sequence[Cell],
    *,
    start: Cell | None = None,
    half_efficiency_distance: float = 4.0,
) -> Domain:
    """Build RockSample[n,k] with k = len(rocks) rocks at the given (x, y) cells.

    The rover starts in the middle of the west edge, cell (0, n // 2), unless told otherwise. The sensor is
    right with probability (1 + 2^(-d / half_efficiency_distance)) / 2 at Euclidean distance d.

    Raises
    ------
    ValueError
        A cell outside the grid, two rocks in one cell, or a distance that is not positive.
    """
    instance = RockSample(
        n=n,
        rocks=tuple(rocks),
        start=(0, n // 2) if start is None else start,
        half_efficiency_distance=half_efficiency_distance,
    )
    return Domain(
        id=f"rocksample-{n}-{len(instance.rocks)}",
        title=f"RockSample[{n},{len(instance.rocks)}]",
        family="classic",
        model=build_model(instance),
        episode_limit=100,  # paper, Table 4
        training_discount=DISCOUNT,
        report_discount=DISCOUNT,
        hidden_first_action=True,
        layout=build_layout(instance),
    )


@register("rocksample-4-4")
def rocksample_4_4() -> Domain:
    """Build the paper's RockSample[4,4]; its sensor's efficiency is e^-d."""
    return rocksample(4, ((3, 1), (2, 1), (1, 3), (1, 0)), half_efficiency_distance=log(2))


@register("rocksample-5-5")
def rocksample_5_5() -> Domain:
    """Build the paper's RockSample[5,5]; its sensor's efficiency is 2^(-d/4)."""
    return rocksample(5, ((2, 4), (0, 4), (3, 3), (2, 2), (4, 1)), half_efficiency_distance=4.0)
