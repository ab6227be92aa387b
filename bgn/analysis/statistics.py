"""The tests behind the verdicts, as pure functions of means, standard deviations and counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats


@dataclass(frozen=True)
class Sample:
    """A sample by its summary; ``sd`` is the population's formula (ddof 0), as the paper prints it."""

    mean: float
    sd: float
    n: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Sample:
        """Summarise one value a seed."""
        return cls(float(np.mean(values)), float(np.std(values)), len(values))

    @property
    def mean_variance(self) -> float:
        """Estimated variance of the mean, from the unbiased variance: sd²/(n-1)."""
        return self.sd**2 / (self.n - 1) if self.n > 1 else math.nan


def welch_p(
    a: Sample, b: Sample, *, shift: float = 0.0, tail: Literal["two-sided", "less", "greater"] = "two-sided"
) -> float:
    """Return the p-value of Welch's test that mean(a) - mean(b) is ``shift``, against ``tail``.

    NaN if a sample has fewer than two values. Without any spread the difference is certain: p is 0 or 1.
    """
    difference = a.mean - b.mean - shift
    variance = a.mean_variance + b.mean_variance
    if math.isnan(variance):
        return math.nan
    if variance == 0:
        against = {"two-sided": difference != 0, "less": difference < 0, "greater": difference > 0}
        return 0.0 if against[tail] else 1.0
    freedom = variance**2 / (a.mean_variance**2 / (a.n - 1) + b.mean_variance**2 / (b.n - 1))
    t = difference / math.sqrt(variance)
    if tail == "two-sided":
        return float(2 * stats.t.sf(abs(t), freedom))
    return float(stats.t.cdf(t, freedom) if tail == "less" else stats.t.sf(t, freedom))


def equivalence_p(a: Sample, b: Sample, *, tolerance: float) -> float:
    """Return the p-value of two one-sided tests (TOST): small where means are within ``tolerance``."""
    below = welch_p(a, b, shift=tolerance, tail="less")
    above = welch_p(a, b, shift=-tolerance, tail="greater")
    return max(below, above) if not math.isnan(below) else math.nan


def holm(p_values: Sequence[float], *, family: int) -> list[float]:
    """Adjust p-values by Holm's step-down method for a family of tests, of which some may not be done yet."""
    if family < len(p_values):
        raise ValueError(f"a family of {family} tests cannot hold {len(p_values)}")
    adjusted = [0.0] * len(p_values)
    highest = 0.0
    for rank, index in enumerate(np.argsort(p_values)):
        highest = max(highest, min(1.0, (family - rank) * p_values[index]))
        adjusted[index] = highest
    return adjusted


def binomial_interval(successes: int, trials: int, *, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a success probability."""
    interval = stats.binomtest(successes, trials).proportion_ci(confidence, method="exact")
    return float(interval.low), float(interval.high)


def prediction_interval(sample: Sample, *, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval in which the mean of ``n`` new values falls.

    For 10 values and 10 new ones: mean ± 1.012 unbiased standard deviations, 1.066 times the population's.
    """
    deviation = math.sqrt(sample.mean_variance * (1 + sample.n / n))
    reach = float(stats.t.ppf((1 + confidence) / 2, sample.n - 1)) * deviation
    return sample.mean - reach, sample.mean + reach
