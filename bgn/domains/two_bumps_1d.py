"""TwoBumps-1D: find the right one of two bumps by touch and push it right (paper, Section 5.2).

x = (finger cell 0 … 14, angle bin), y = cells (b1, b2) of the left and the right bump. Actions: left or
right, each with a soft or a stiff finger. A soft finger that moves onto a bump is deflected against its
motion; a stiff one pushes the bump, which ends the episode and earns 1 iff the right bump went right.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from bgn.domains.domain import Domain, Features
from bgn.domains.factored import (
    REPORT_DISCOUNT,
    TRAINING_DISCOUNT,
    Booleans,
    Floats,
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

CELLS: Final = 15
BINS: Final = 3  # tip deflected to the left, neutral, to the right
NEUTRAL: Final = 1
LEFT_SOFT, LEFT_STIFF, RIGHT_SOFT, RIGHT_STIFF = range(4)
ACTIONS: Final = ("left-soft", "left-stiff", "right-soft", "right-stiff")
BIN_NAMES: Final = ("deflected-left", "neutral", "deflected-right")
RIGHT_BUMP_RIGHT: Final = 2  # the compiled code of the push that earns the reward
EPISODE_LIMIT: Final = 100  # paper, Table 5
AUTHORS_LIMIT: Final = 50  # authors' code
PAIRS: Final = tuple(
    (b1, b2) for b1 in range(2, 11) for b2 in range(4, 13) if 2 <= b2 - b1 <= 7
)  # (left cell, right cell) of the bumps, 39 of them


@register("two-bumps-1d")
def build(*, variant: Variant = "paper") -> Domain:
    """Build TwoBumps-1D.

    ``paper``: pairs and finger cells are jointly uniform. ``authors``: the left bump is drawn first and the
    right one given the left, while the belief still starts uniform; the episode limit is 50.

    Raises
    ------
    ValueError
        The variant is unknown.
    """
    check_variant(variant)
    authors = variant == "authors"
    free = _start_cells()  # (X, Y)
    pairs = _authors_pair_probabilities() if authors else np.full(len(PAIRS), 1 / len(PAIRS))
    observed = np.array([(c / (CELLS - 1), b / (BINS - 1)) for c in range(CELLS) for b in range(BINS)])
    observed = observed.astype(np.float32)
    hidden = (np.array(PAIRS) / (CELLS - 1)).astype(np.float32)
    readings = [f"cell-{c}/{name}" for c in range(CELLS) for name in BIN_NAMES]
    names = Names(
        observed=readings, hidden=[f"bumps-{b1}-{b2}" for b1, b2 in PAIRS], actions=ACTIONS, readings=readings
    )
    return Domain(
        id="two-bumps-1d",
        title="TwoBumps-1D",
        family="robot",
        model=assemble(_rules(free / free.sum(axis=0) * pairs), names),
        episode_limit=AUTHORS_LIMIT if authors else EPISODE_LIMIT,
        training_discount=TRAINING_DISCOUNT,
        report_discount=REPORT_DISCOUNT,
        features=Features(observation=observed, observed=observed, state=join_features(observed, hidden)),
        prior=_uniform_prior(free) if authors else None,
        layout=TouchLayout(
            shape=(1, CELLS),
            finger=np.arange(CELLS * BINS) // BINS,
            objects=("left bump", "right bump"),
            places=np.array(PAIRS),
        ),
    )


def _start_cells() -> Booleans:
    """Return (X, Y): whether an episode with pair y can start at x, a neutral finger beside both bumps."""
    cell, angle = np.divmod(np.arange(CELLS * BINS), BINS)
    pairs = np.array(PAIRS)
    on_bump = (cell[:, None, None] == pairs).any(axis=2)
    return np.asarray(~on_bump & (angle == NEUTRAL)[:, None])


def _authors_pair_probabilities() -> Floats:
    """P(b1, b2) with b1 uniform and b2 uniform given b1."""
    left = np.array([b1 for b1, _ in PAIRS])
    partners = np.bincount(left)[left]
    return np.asarray(1 / (len(set(left.tolist())) * partners))


def _uniform_prior(free: Booleans) -> Floats:
    """Return the (X, Y) belief after seeing x first, as if all pairs were equally likely."""
    possible = np.where(free.any(axis=1, keepdims=True), free, True)
    return np.asarray(possible / possible.sum(axis=1, keepdims=True))


def _rules(start: Floats) -> Rules:
    compiled = load(SHIPPED / "two-bumps-1d")
    return Rules(
        successor=compiled.reading.astype(np.int64),
        ends=compiled.pushed != 0,
        reward=(compiled.pushed == RIGHT_BUMP_RIGHT).astype(np.float64),
        start=start,
        observation=np.arange(CELLS * BINS),
    )
