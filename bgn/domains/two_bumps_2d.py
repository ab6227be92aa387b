"""TwoBumps-2D: touch two bumps on a 4 x 4 grid, then grasp the large one (paper, Section 5.2).

x = (finger cell, angle bin, whether each bump was touched), y = cells (large, small), never adjacent.
Actions: left, right, backward, forward, grasp. A compliant finger that moves onto a bump is deflected
against its motion, strongly by the large one and mildly by the small one. A grasp ends the episode and
earns 1 iff the finger is at the large bump and both were touched. The agents observe cell and angle bin;
the touched flags follow from the history.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from bgn.domains.domain import Domain, Features
from bgn.domains.factored import (
    REPORT_DISCOUNT,
    TRAINING_DISCOUNT,
    Booleans,
    Names,
    Rules,
    Variant,
    assemble,
    check_variant,
    join_features,
)
from bgn.domains.layout import TouchLayout
from bgn.domains.outcome_table import SHIPPED, load
from bgn.domains.registry import register

SIDE: Final = 4
CELLS: Final = SIDE * SIDE  # cell = row * SIDE + column; right is +column, forward is +row
BINS: Final = 5  # strongly and mildly against the axis, neutral, mildly and strongly along it
NEUTRAL: Final = 2
FLAGS: Final = 4  # bit 0: the large bump was touched, bit 1: the small one
READINGS: Final = CELLS * BINS
LEFT, RIGHT, BACKWARD, FORWARD, GRASP = range(5)
ACTIONS: Final = ("left", "right", "backward", "forward", "grasp")
BIN_NAMES: Final = ("strong-minus", "mild-minus", "neutral", "mild-plus", "strong-plus")
EPISODE_LIMIT: Final = 100  # paper, Table 5


def _adjacent(a: int, b: int) -> bool:
    return abs(a // SIDE - b // SIDE) + abs(a % SIDE - b % SIDE) == 1


PAIRS: Final = tuple(
    (large, small)
    for large in range(CELLS)
    for small in range(CELLS)
    if large != small and not _adjacent(large, small)
)  # 192 of them


@register("two-bumps-2d")
def build(*, variant: Variant = "paper") -> Domain:
    """Build TwoBumps-2D; ``authors`` has an elimination belief and a state input without touched flags.

    Raises
    ------
    ValueError
        The variant is unknown.
    """
    check_variant(variant)
    authors = variant == "authors"
    rules = _rules()
    readings = [f"cell-{c % SIDE}-{c // SIDE}/{name}" for c in range(CELLS) for name in BIN_NAMES]
    touched = ("", "/large", "/small", "/both")
    names = Names(
        observed=[r + flags for r in readings for flags in touched],
        hidden=[f"large-{a % SIDE}-{a // SIDE}/small-{b % SIDE}-{b // SIDE}" for a, b in PAIRS],
        actions=ACTIONS,
        readings=readings,
    )
    return Domain(
        id="two-bumps-2d",
        title="TwoBumps-2D",
        family="robot",
        model=assemble(rules, names),
        episode_limit=EPISODE_LIMIT,
        training_discount=TRAINING_DISCOUNT,
        report_discount=REPORT_DISCOUNT,
        features=_features(flags_in_state=not authors),
        elimination=_elimination() if authors else None,
        layout=TouchLayout(
            shape=(SIDE, SIDE),
            finger=np.arange(READINGS * FLAGS) // FLAGS // BINS,
            objects=("large bump", "small bump"),
            places=np.array(PAIRS),
        ),
    )


def _features(*, flags_in_state: bool) -> Features:
    cell, angle = np.divmod(np.arange(READINGS), BINS)
    row, column = np.divmod(cell, SIDE)
    reading = np.stack([column / (SIDE - 1), row / (SIDE - 1), angle / (BINS - 1)], axis=1).astype(np.float32)
    observed = np.repeat(reading, FLAGS, axis=0)  # (X, 3)
    pairs = np.array(PAIRS)
    hidden = (np.stack([pairs % SIDE, pairs // SIDE], axis=2).reshape(-1, 4) / (SIDE - 1)).astype(np.float32)
    state = join_features(observed, hidden)
    if flags_in_state:
        flags = np.repeat(np.tile([[0, 0], [1, 0], [0, 1], [1, 1]], (READINGS, 1)), len(PAIRS), axis=0)
        state = np.hstack([state, flags.astype(np.float32)])
    return Features(observation=reading, observed=observed, state=state)


def _on_bumps() -> Booleans:
    """Return (READINGS, Y, 2): whether the reading's cell is the large, the small bump's."""
    cell = np.arange(READINGS) // BINS
    return np.asarray(cell[:, None, None] == np.array(PAIRS))


def _elimination() -> Booleans:
    """Return (X, Y): the pairs with no bump in a cell felt neutral. The authors' code removes only those."""
    neutral = np.arange(READINGS) % BINS == NEUTRAL
    keeps = ~(neutral[:, None] & _on_bumps().any(axis=2))
    return np.repeat(keeps, FLAGS, axis=0)


def _rules() -> Rules:
    moves = load(SHIPPED / "two-bumps-2d").reading.astype(np.int64)  # (READINGS, 4, Y)
    X, Y = READINGS * FLAGS, len(PAIRS)
    strong, mild = (np.isin(moves % BINS, bins) & (moves >= 0) for bins in ((0, 4), (1, 3)))
    touches = strong * 1 + mild * 2
    successor = np.empty((X, len(ACTIONS), Y), dtype=np.int64)
    for flags in range(FLAGS):
        successor[flags::FLAGS, :GRASP] = np.where(moves < 0, -1, moves * FLAGS + (touches | flags))
    successor[:, GRASP] = np.arange(X)[:, None]
    on_bumps = _on_bumps()
    ends = np.zeros(successor.shape, dtype=np.bool_)
    ends[:, GRASP] = True
    reward = np.zeros((READINGS, FLAGS, len(ACTIONS), Y))
    reward[:, FLAGS - 1, GRASP] = on_bumps[:, :, 0]
    start = np.zeros((READINGS, FLAGS, Y))
    start[NEUTRAL::BINS, 0] = ~on_bumps[NEUTRAL::BINS].any(axis=2)
    return Rules(
        successor=successor,
        ends=ends,
        reward=reward.reshape(X, len(ACTIONS), Y),
        start=(start / start.sum()).reshape(X, Y),
        observation=np.repeat(np.arange(READINGS), FLAGS),
    )
