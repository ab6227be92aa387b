"""Has a cell become worse? A two-stage rule that seldom cries wolf.

A mean over a few seeds moves by itself, and twenty cells are looked at at once. So a first stage only screens: three
fresh seeds whose mean is more than one standard deviation below the reference's send the cell to the second stage,
which trains ten other fresh seeds and asks for p < .001 (Welch, one-sided). :func:`alarm_rates` simulates how often
a rule calls a cell regressed.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bgn.analysis.statistics import Sample, welch_p

#: Fewer reference seeds than this can't carry the second stage.
FEWEST_REFERENCE_SEEDS = 5
#: A second stage that is not significant by the rule, but would be at this level, leaves it open.
DOUBT = 0.01


class Outcome(enum.Enum):
    """What is said of a cell; the value is what is printed."""

    FINE = "fine"
    REGRESSED = "regressed"
    UNCLEAR = "could not tell"


@dataclass(frozen=True)
class Rule:
    """The two stages."""

    screening_seeds: int = 3
    screening_sds: float = 1.0
    """A mean that is lower by more than so many standard deviations of the reference goes on to the second stage."""
    confirming_seeds: int = 10
    level: float = 0.001

    def suspicious(self, reference: Sample, fresh: Sample) -> bool:
        """Say whether the first stage sends a cell on to the second."""
        return fresh.mean < reference.mean - self.screening_sds * reference.unbiased_sd

    def p_value(self, reference: Sample, fresh: Sample) -> float:
        """Return the p-value that the fresh seeds are no worse (Welch, one-sided)."""
        return welch_p(fresh, reference, tail="less")

    def confirm(self, reference: Sample, fresh: Sample) -> Outcome:
        """Judge the seeds of the second stage."""
        p = self.p_value(reference, fresh)
        if p < self.level:
            return Outcome.REGRESSED
        return Outcome.UNCLEAR if math.isnan(p) or p < DOUBT else Outcome.FINE


@dataclass(frozen=True)
class AlarmRates:
    """How often a rule calls regressed what dropped by so many standard deviations."""

    cell: float
    """One cell."""
    any_cell: float
    """At least one of all cells that are looked at: a false alarm if nothing dropped."""
    any_open: float
    """At least one of them regressed or left open."""


def alarm_rates(
    rule: Rule, *, drop: float, cells: int = 20, reference_seeds: int = 10, repeats: int = 2000, seed: int = 0
) -> AlarmRates:
    """Simulate a rule on normal seeds, all at once: every cell's true mean dropped by ``drop`` standard deviations."""
    generator = np.random.default_rng(seed)

    def seeds(n: int, mean: float) -> NDArray[np.float64]:
        return generator.normal(mean, 1.0, size=(repeats, cells, n))

    reference = seeds(reference_seeds, 0.0)
    screening, confirming = seeds(rule.screening_seeds, -drop), seeds(rule.confirming_seeds, -drop)
    limit = reference.mean(-1) - rule.screening_sds * reference.std(-1, ddof=1)
    suspicious = screening.mean(-1) < limit
    p = stats.ttest_ind(confirming, reference, axis=-1, equal_var=False, alternative="less").pvalue
    alarms, doubts = suspicious & (p < rule.level), suspicious & (p < DOUBT)
    return AlarmRates(
        float(alarms.mean()), float(alarms.any(axis=-1).mean()), float(doubts.any(axis=-1).mean())
    )


def worst(outcomes: Sequence[Outcome]) -> Outcome:
    """Return what is said of all cells together: regressed if any is, else open if any is (or there are none)."""
    for outcome in (Outcome.REGRESSED, Outcome.UNCLEAR):
        if outcome in outcomes:
            return outcome
    return Outcome.FINE if outcomes else Outcome.UNCLEAR
