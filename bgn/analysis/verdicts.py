"""Judges a cell against what the paper offers for it: numbers, a claim, or nothing.

A number is judged by two questions at once. Does ours differ (Welch's test, Holm-corrected over all
numbers of Table 7)? Is it equivalent within a tolerance fixed beforehand (two one-sided tests)? The
paper's values are rounded, so each test is put to the least favourable values that print the same.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from bgn.analysis import paper
from bgn.analysis.paper import Printed
from bgn.analysis.statistics import Sample, binomial_interval, equivalence_p, holm, welch_p

SIGNIFICANCE = 0.05
_HALF_UNIT_SLACK = 1 + 1e-9  # a mean on the edge of its rounding interval is inside


class Verdict(enum.Enum):
    """The outcome for one cell; the value is what tables print."""

    REPRODUCED = "reproduced"
    NEGLIGIBLE_SHIFT = "reproduced, negligible shift"
    EXCEEDS = "not reproduced: exceeds"
    FALLS_SHORT = "not reproduced: falls short"
    INCONCLUSIVE = "inconclusive"
    TOO_FEW_RUNS = "too few runs"
    NO_REFERENCE = "no reference"


@dataclass(frozen=True)
class Judgement:
    """A verdict and the p-values it rests on (NaN where a test does not apply)."""

    verdict: Verdict
    p_difference: float = math.nan
    """Holm-corrected."""
    p_equivalence: float = math.nan


def judge_numbers(
    ours: Mapping[tuple[str, str], Sample], tolerances: Mapping[str, float]
) -> dict[tuple[str, str], Judgement]:
    """Judge every (domain, agent) of Table 7 for which there are runs; ``tolerances`` are by domain."""
    judged = {cell: sample for cell, sample in ours.items() if cell in paper.RETURNS and sample.n > 1}
    p_values = [difference_p(sample, paper.RETURNS[cell]) for cell, sample in judged.items()]
    adjusted = dict(zip(judged, holm(p_values, family=len(paper.RETURNS)), strict=True))
    judgements = {}
    for cell, sample in judged.items():
        printed = paper.RETURNS[cell]
        p_equivalence = rounded_equivalence_p(sample, printed, tolerance=tolerances[cell[0]])
        verdict = _decide(adjusted[cell], p_equivalence, exceeds=sample.mean > printed.mean)
        judgements[cell] = Judgement(verdict, adjusted[cell], p_equivalence)
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


def judge_perfection(successes: int, episodes: int, *, tolerance: float) -> Judgement:
    """Judge the claim of a perfect success rate by the Clopper-Pearson interval of the pooled episodes."""
    low, high = binomial_interval(successes, episodes)
    if low >= 1 - tolerance:
        return Judgement(Verdict.REPRODUCED)
    return Judgement(Verdict.FALLS_SHORT if high < 1 - tolerance else Verdict.INCONCLUSIVE)


def judge_below(
    ours: Mapping[tuple[str, str], Sample],
    better: Mapping[str, Sample],
    tolerances: Mapping[str, float],
) -> dict[tuple[str, str], Judgement]:
    """Judge the claims that cells do worse than their domain's ``better`` agent (one-sided Welch tests).

    A cell that does significantly better, or as well within its domain's tolerance (TOST), refutes its claim.
    """
    claims = [cell for cell, claim in paper.CLAIMS.items() if claim.kind == "below-bgn"]
    pairs = {cell: (ours[cell], better[cell[0]]) for cell in claims if cell in ours and cell[0] in better}
    pairs = {cell: (a, b) for cell, (a, b) in pairs.items() if min(a.n, b.n) > 1}
    less = holm([welch_p(a, b, tail="less") for a, b in pairs.values()], family=len(claims))
    greater = holm([welch_p(a, b, tail="greater") for a, b in pairs.values()], family=len(claims))
    equal = holm(
        [equivalence_p(a, b, tolerance=tolerances[cell[0]]) for cell, (a, b) in pairs.items()],
        family=len(claims),
    )
    judgements = {}
    for cell, p_less, p_greater, p_equal in zip(pairs, less, greater, equal, strict=True):
        refuted = min(p_greater, p_equal) < SIGNIFICANCE
        verdict = Verdict.EXCEEDS if refuted else Verdict.INCONCLUSIVE
        judgements[cell] = Judgement(
            Verdict.REPRODUCED if p_less < SIGNIFICANCE else verdict, p_less, p_equal
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
