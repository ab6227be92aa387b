"""Judges a cell against what the paper offers for it: numbers, a claim, or nothing.

A number is judged by two questions at once. Does ours differ (Welch's test)? Is it equivalent within a tolerance
fixed beforehand (two one-sided tests)? Either family of tests is Holm-corrected over all numbers of Table 6. The
paper's values are rounded, so each test is put to the least favourable values that print the same.

Runs shorter than the horizon of the paper get no verdict: early on, agents that will differ still do the same.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bgn.analysis import paper
from bgn.analysis.paper import Printed
from bgn.analysis.statistics import (
    Sample,
    detectable_gap,
    equivalence_p,
    equivalence_power,
    holm,
    rate_interval,
    welch_p,
)

SIGNIFICANCE = 0.05
_HALF_UNIT_SLACK = 1 + 1e-9  # a mean on the edge of its rounding interval is inside

Cell = tuple[str, str]
"""Domain id and agent id."""


class Verdict(enum.Enum):
    """The outcome for one cell or claim; the value is what tables print."""

    REPRODUCED = "reproduced"
    NEGLIGIBLE_SHIFT = "reproduced, negligible shift"
    EXCEEDS = "not reproduced: exceeds"
    FALLS_SHORT = "not reproduced: falls short"
    INCONCLUSIVE = "inconclusive"
    SHORT = "short"
    """The runs are shorter than the paper's."""
    TOO_FEW_RUNS = "too few runs"
    NO_REFERENCE = "no reference"


@dataclass(frozen=True)
class Judgement:
    """A verdict and the numbers it rests on (NaN where a test does not apply)."""

    verdict: Verdict
    p_difference: float = math.nan
    """Holm-corrected."""
    p_equivalence: float = math.nan
    """Holm-corrected."""
    detectable: float = math.nan
    """The true difference that the test sees in four cases of five, were it the first of its family (Holm)."""
    power: float = math.nan
    """The chance that equal means are found equivalent, were it the first of its family (Holm); as the p-value, it
    takes the least favourable values that print as the paper's."""
    attainable: bool = True
    """Whether ten seeds of the paper's mean and spread would be found equivalent without any correction."""


def judge_numbers(ours: Mapping[Cell, Sample], tolerances: Mapping[str, float]) -> dict[Cell, Judgement]:
    """Judge every (domain, agent) of Table 6 for which there are runs; ``tolerances`` are by domain."""
    judged = {cell: sample for cell, sample in ours.items() if cell in paper.RETURNS and sample.n > 1}
    pairs = [(sample, paper.RETURNS[cell], tolerances[cell[0]]) for cell, sample in judged.items()]
    family = len(paper.RETURNS)
    differ = holm([difference_p(sample, printed) for sample, printed, _ in pairs], family=family)
    equal = holm([rounded_equivalence_p(s, printed, tolerance=t) for s, printed, t in pairs], family=family)
    judgements = {}
    for cell, (sample, printed, tolerance), p_differ, p_equal in zip(
        judged, pairs, differ, equal, strict=True
    ):
        theirs = Sample(printed.mean, printed.sd, paper.SEEDS)
        level = SIGNIFICANCE / family
        judgements[cell] = Judgement(
            _decide(p_differ, p_equal, exceeds=sample.mean > printed.mean),
            p_differ,
            p_equal,
            detectable_gap(sample, theirs, level=level),
            rounded_equivalence_power(sample, printed, tolerance=tolerance, level=level),
            attainable(printed, tolerance=tolerance),
        )
    return judgements


def difference_p(ours: Sample, printed: Printed) -> float:
    """Return the largest Welch p-value over the means and extreme deviations that print as the paper's."""
    low, high = _rounding(printed.mean)
    nearest = min(max(ours.mean, low), high)
    return max(welch_p(ours, Sample(nearest, sd, paper.SEEDS)) for sd in _deviations(printed))


def rounded_equivalence_p(ours: Sample, printed: Printed, *, tolerance: float) -> float:
    """Return the largest TOST p-value over the extreme means and deviations that print as the paper's."""
    corners = itertools.product(_rounding(printed.mean), _deviations(printed))
    theirs = [Sample(mean, sd, paper.SEEDS) for mean, sd in corners]
    return max(equivalence_p(ours, sample, tolerance=tolerance) for sample in theirs)


def rounded_equivalence_power(ours: Sample, printed: Printed, *, tolerance: float, level: float) -> float:
    """Return the power of :func:`rounded_equivalence_p` at ``level``: rounding takes its share of the tolerance."""
    low, high = _rounding(printed.mean)
    widest = Sample(printed.mean, max(_deviations(printed)), paper.SEEDS)
    return equivalence_power(ours, widest, tolerance=tolerance - (high - low) / 2, level=level)


def attainable(printed: Printed, *, tolerance: float) -> bool:
    """Say whether ten seeds of exactly the paper's mean and spread would be found equivalent to it."""
    twin = Sample(printed.mean, printed.sd, paper.SEEDS)
    return rounded_equivalence_p(twin, printed, tolerance=tolerance) < SIGNIFICANCE


def judge_perfection(rates: Sequence[float], episodes: Sequence[int], *, tolerance: float) -> Judgement:
    """Judge the claim of a perfect success rate by the interval of a seed's rate (one rate per seed)."""
    if len(rates) < 2:
        return Judgement(Verdict.TOO_FEW_RUNS)
    low, high = rate_interval(rates, episodes)
    if low >= 1 - tolerance:
        return Judgement(Verdict.REPRODUCED)
    return Judgement(Verdict.FALLS_SHORT if high < 1 - tolerance else Verdict.INCONCLUSIVE)


def judge_below(
    ours: Mapping[Cell, Sample], better: Mapping[str, Sample], tolerances: Mapping[str, float]
) -> dict[Cell, Judgement]:
    """Judge the claims that cells do worse than their domain's ``better`` agent (one-sided Welch tests).

    A cell that does significantly better, or as well within its domain's tolerance (TOST), refutes its claim.
    """
    claimed = [cell for cell, claim in paper.CELL_CLAIMS.items() if claim.kind == "below-bgn"]
    cells = [cell for cell in claimed if cell in ours and cell[0] in better]
    cells = [cell for cell in cells if min(ours[cell].n, better[cell[0]].n) > 1]
    pairs = [(ours[cell], better[cell[0]]) for cell in cells]
    family = len(claimed)

    def corrected(test: Callable[[Cell, Sample, Sample], float]) -> list[float]:
        return holm([test(cell, *pair) for cell, pair in zip(cells, pairs, strict=True)], family=family)

    less = corrected(lambda _, a, b: welch_p(a, b, tail="less"))
    greater = corrected(lambda _, a, b: welch_p(a, b, tail="greater"))
    equal = corrected(lambda cell, a, b: equivalence_p(a, b, tolerance=tolerances[cell[0]]))
    judgements = {}
    for cell, (a, b), p_less, p_greater, p_equal in zip(cells, pairs, less, greater, equal, strict=True):
        verdict = Verdict.INCONCLUSIVE
        if p_less < SIGNIFICANCE:
            verdict = Verdict.REPRODUCED
        elif p_greater < SIGNIFICANCE or p_equal < SIGNIFICANCE:
            verdict = Verdict.EXCEEDS
        level = SIGNIFICANCE / family
        judgements[cell] = Judgement(
            verdict,
            p_less,
            p_equal,
            detectable_gap(a, b, level=2 * level),
            equivalence_power(a, b, tolerance=tolerances[cell[0]], level=level),
        )
    return judgements


def _decide(p_difference: float, p_equivalence: float, *, exceeds: bool) -> Verdict:
    differs, equivalent = p_difference < SIGNIFICANCE, p_equivalence < SIGNIFICANCE
    if equivalent:
        return Verdict.NEGLIGIBLE_SHIFT if differs else Verdict.REPRODUCED
    if differs:
        return Verdict.EXCEEDS if exceeds else Verdict.FALLS_SHORT
    return Verdict.INCONCLUSIVE


def _rounding(value: float) -> tuple[float, float]:
    reach = paper.HALF_UNIT * _HALF_UNIT_SLACK
    return value - reach, value + reach


def _deviations(printed: Printed) -> Iterator[float]:
    low, high = _rounding(printed.sd)
    yield from (max(low, 0.0), high)
