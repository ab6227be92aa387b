"""TopPlate: find the top of a stack of unknown height by touch, then grasp it (paper, Section 5.2).

x = (finger level 0 … n + 1, angle bin), y = height of the stack k ~ U{1 … n}; plates lie at levels 1 … k.
Actions: down, up, grasp. A compliant finger that moves onto a plate's level is deflected against its motion.
A grasp ends the episode and earns 1 iff the finger is at the top plate.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from bgn.domains.domain import Domain, Features
from bgn.domains.factored import (
    REPORT_DISCOUNT,
    TRAINING_DISCOUNT,
    Floats,
    Integers,
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
from bgn.errors import InputError

PLATES: Final = 10  # paper, Section 5.2: k ~ U([1, 10])
EPISODE_LIMIT: Final = 50  # paper, Table 5
BINS: Final = 3  # deflected down, neutral, deflected up
NEUTRAL: Final = 1
DOWN, UP, GRASP = range(3)
ACTIONS: Final = ("down", "up", "grasp")
BIN_NAMES: Final = ("deflected-down", "neutral", "deflected-up")

# Authors' code: five plates, a belief vector of eight slots (heights 0 … 7), uniform over 1 … 6 at first.
AUTHORS_PLATES: Final = 5
AUTHORS_HEIGHTS: Final = np.arange(8)
AUTHORS_BELIEVED: Final = slice(1, 7)
AUTHORS_LIMIT: Final = 100


@register("top-plate")
def build(*, plates: int = PLATES, variant: Variant = "paper") -> Domain:
    """Build TopPlate with stacks of 1 to ``plates`` plates.

    ``variant="authors"`` is the authors' code: five plates (whatever ``plates`` says must be left at its
    default), an episode limit of 100 and a start belief that also holds the impossible height 6.

    Raises
    ------
    ValueError
        ``plates`` is not within 1 to 10, or the variant is unknown or fixes ``plates``.
    """
    check_variant(variant)
    if not 1 <= plates <= PLATES:
        raise InputError(f"top-plate has 1 to {PLATES} plates, not {plates}")
    authors = variant == "authors"
    if authors and plates not in (PLATES, AUTHORS_PLATES):
        raise InputError(f"top-plate's authors variant has {AUTHORS_PLATES} plates, not {plates}")
    n = AUTHORS_PLATES if authors else plates
    heights = AUTHORS_HEIGHTS if authors else np.arange(1, plates + 1)
    levels = n + 2
    X, Y = levels * BINS, len(heights)
    start = np.zeros((X, Y))
    start[NEUTRAL, (heights >= 1) & (heights <= n)] = 1 / n  # level 0
    observed = np.array([(level / (n + 1), b / (BINS - 1)) for level in range(levels) for b in range(BINS)])
    hidden = np.minimum(heights / (n + 1), 1)[:, None]  # a plate's height on the scale of the finger's level
    readings = [f"level-{level}/{name}" for level in range(levels) for name in BIN_NAMES]
    names = Names(
        observed=readings, hidden=[f"height-{k}" for k in heights], actions=ACTIONS, readings=readings
    )
    observed = observed.astype(np.float32)
    return Domain(
        id="top-plate",
        title="TopPlate",
        family="robot",
        model=assemble(_rules(n, heights, start), names),
        episode_limit=AUTHORS_LIMIT if authors else EPISODE_LIMIT,
        training_discount=TRAINING_DISCOUNT,
        report_discount=REPORT_DISCOUNT,
        features=Features(
            observation=observed,
            observed=observed,
            state=join_features(observed, hidden.astype(np.float32)),
        ),
        prior=_authors_prior(X) if authors else None,
        layout=TouchLayout(
            shape=(levels, 1), finger=np.arange(X) // BINS, objects=("top plate",), places=heights[:, None]
        ),
    )


def _rules(n: int, heights: Integers, start: Floats) -> Rules:
    levels, Y = n + 2, len(heights)
    X = levels * BINS
    successor = np.empty((X, len(ACTIONS), Y), dtype=np.int64)
    successor[:, :GRASP] = _moves(n, heights)
    successor[:, GRASP] = np.arange(X)[:, None]
    ends = np.zeros(successor.shape, dtype=np.bool_)
    ends[:, GRASP] = True
    at_top = np.repeat(np.arange(levels), BINS)[:, None] == heights  # (X, Y)
    reward = np.zeros(successor.shape)
    reward[:, GRASP] = at_top & (heights >= 1)
    return Rules(successor=successor, ends=ends, reward=reward, start=start, observation=np.arange(X))


def _moves(n: int, heights: Integers) -> Integers:
    """Return the compiled reading after each move, shape (X, 2, Y), cut to n plates."""
    x = np.arange((n + 2) * BINS)
    moves = load(SHIPPED / "top-plate").reading[: len(x), :, heights].astype(np.int64)
    at_the_end = x // BINS == n + 1
    moves[at_the_end, UP] = x[at_the_end, None]  # a move out of range is refused
    return moves


def _authors_prior(X: int) -> Floats:
    prior = np.zeros((X, len(AUTHORS_HEIGHTS)))
    prior[:, AUTHORS_BELIEVED] = 1 / 6
    return prior
