"""The tests behind the verdicts, as pure functions of means, standard deviations and counts.

A value is what one seed yields. Two things bound how sure a sample of them can be: how much seeds differ, and how
exactly each was measured. A hundred successes in a hundred episodes are not certainty, so a sample carries the
standard error of its values as a floor: their spread contains it, and is never taken for less.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Tail = Literal["two-sided", "less", "greater"]


@dataclass(frozen=True)
class Sample:
    """A sample by its summary; ``sd`` is the population's formula (ddof 0), as the paper prints it."""

    mean: float
    sd: float
    n: int
    error: float = 0.0
    """Standard error of measuring one value (root mean square over the values)."""

    @classmethod
    def of(cls, values: Sequence[float], errors: Sequence[float] = ()) -> Sample:
        """Summarise one value per seed, with the standard error of each where it is known."""
        error = math.sqrt(float(np.mean(np.square(errors)))) if len(errors) else 0.0
        return cls(float(np.mean(values)), float(np.std(values)), len(values), error)

    @property
    def unbiased_sd(self) -> float:
        """Standard deviation of one value (ddof 1), not below the error of measuring it; NaN for one value."""
        return max(self.sd * math.sqrt(self.n / (self.n - 1)), self.error) if self.n > 1 else math.nan

    @property
    def mean_variance(self) -> float:
        """Estimated variance of the mean."""
        return self.unbiased_sd**2 / self.n


def rate_error(rate: float, episodes: int) -> float:
    """Return the standard error of a success rate, positive for rates of 0 and 1 too.

    The rate is moved by half a success and half a failure towards one half (Jeffreys' prior).
    """
    moved = (rate * episodes + 0.5) / (episodes + 1)
    return math.sqrt(moved * (1 - moved) / episodes)


def welch_p(a: Sample, b: Sample, *, shift: float = 0.0, tail: Tail = "two-sided") -> float:
    """Return the p-value of Welch's test that mean(a) - mean(b) is ``shift``, against ``tail``.

    NaN where there is nothing to judge by: fewer than two values, or no spread and no known error.
    """
    variance = a.mean_variance + b.mean_variance
    if math.isnan(variance) or variance == 0:
        return math.nan
    first, second = (a.mean - shift, a.unbiased_sd, a.n), (b.mean, b.unbiased_sd, b.n)
    return float(stats.ttest_ind_from_stats(*first, *second, equal_var=False, alternative=tail).pvalue)


def equivalence_p(a: Sample, b: Sample, *, tolerance: float) -> float:
    """Return the p-value of two one-sided tests (TOST): small where means are within ``tolerance``."""
    below = welch_p(a, b, shift=tolerance, tail="less")
    above = welch_p(a, b, shift=-tolerance, tail="greater")
    return max(below, above) if not math.isnan(below) else math.nan


def welch_freedom(a: Sample, b: Sample) -> float:
    """Return the Welch-Satterthwaite degrees of freedom of the difference of two means."""
    parts = [(sample.mean_variance, sample.n - 1) for sample in (a, b)]
    return sum(v for v, _ in parts) ** 2 / sum(v**2 / df for v, df in parts)


def detectable_gap(a: Sample, b: Sample, *, level: float, power: float = 0.8) -> float:
    """Return the true difference of means that a two-sided test at ``level`` sees with chance ``power``.

    (t(1 - level/2) + t(power)) standard errors of the difference; NaN where there is no test.
    """
    variance = a.mean_variance + b.mean_variance
    if math.isnan(variance) or variance == 0:
        return math.nan
    freedom = welch_freedom(a, b)
    reach = sum(float(stats.t.ppf(chance, freedom)) for chance in (1 - level / 2, power))
    return reach * math.sqrt(variance)


def equivalence_power(a: Sample, b: Sample, *, tolerance: float, level: float) -> float:
    """Return the chance that TOST at ``level`` finds two equal means equivalent: 2 T(δ/se - t(1 - level)) - 1."""
    variance = a.mean_variance + b.mean_variance
    if math.isnan(variance) or variance == 0:
        return math.nan
    freedom = welch_freedom(a, b)
    reach = tolerance / math.sqrt(variance) - float(stats.t.ppf(1 - level, freedom))
    return max(0.0, 2 * float(stats.t.cdf(reach, freedom)) - 1)


def holm(p_values: Sequence[float], *, family: int) -> list[float]:
    """Adjust p-values by Holm's step-down method for a family of tests, of which some may not be done yet.

    NaN, a test that could not be done, stays NaN and counts as not done yet.
    """
    if family < len(p_values):
        raise ValueError(f"a family of {family} tests cannot hold {len(p_values)}")
    adjusted = [math.nan] * len(p_values)
    highest = 0.0
    done = [index for index in np.argsort(p_values) if not math.isnan(p_values[index])]
    for rank, index in enumerate(done):
        highest = max(highest, min(1.0, (family - rank) * p_values[index]))
        adjusted[index] = highest
    return adjusted


def binomial_interval(successes: int, trials: int, *, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a success probability."""
    interval = stats.binomtest(successes, trials).proportion_ci(confidence, method="exact")
    return float(interval.low), float(interval.high)


def mean_interval(sample: Sample, *, confidence: float = 0.95) -> tuple[float, float]:
    """Return Student's interval of the mean of a seed, from one value per seed (NaN for one seed)."""
    reach = float(stats.t.ppf((1 + confidence) / 2, sample.n - 1)) * math.sqrt(sample.mean_variance)
    return sample.mean - reach, sample.mean + reach


def rate_interval(rates: Sequence[float], episodes: Sequence[int]) -> tuple[float, float]:
    """Return the 95 % interval of the success rate of a seed, clipped to [0, 1].

    The wider, at either end, of Student's interval over seeds and of Clopper-Pearson's over all their episodes: pooled
    episodes hide that seeds differ, and seeds without any spread hide that episodes are finite.
    """
    successes = sum(round(rate * n) for rate, n in zip(rates, episodes, strict=True))
    pooled = binomial_interval(successes, sum(episodes))
    seeds = mean_interval(Sample.of(rates)) if len(rates) > 1 else (0.0, 1.0)
    return max(0.0, min(pooled[0], seeds[0])), min(1.0, max(pooled[1], seeds[1]))


def mean_p(sample: Sample, value: float, *, tail: Tail) -> float:
    """Return the p-value of Student's test that the mean of a seed is ``value``, against ``tail``.

    NaN where there is nothing to judge by: fewer than two values, or no spread and no known error.
    """
    variance = sample.mean_variance if sample.n > 1 else math.nan
    if math.isnan(variance) or variance == 0:
        return math.nan
    t, freedom = (sample.mean - value) / math.sqrt(variance), sample.n - 1
    less = float(stats.t.cdf(t, freedom))
    return {"less": less, "greater": 1 - less, "two-sided": 2 * min(less, 1 - less)}[tail]


def rate_p(rates: Sequence[float], episodes: Sequence[int], value: float, *, tail: Tail) -> float:
    """Return the p-value that the success rate of a seed is ``value``, against ``tail``: of :func:`rate_interval`.

    The larger of Student's over seeds and of the exact binomial one over all their episodes.
    """
    successes = sum(round(rate * n) for rate, n in zip(rates, episodes, strict=True))
    pooled = float(stats.binomtest(successes, sum(episodes), value, alternative=tail).pvalue)
    seeds = mean_p(Sample.of(rates), value, tail=tail) if len(rates) > 1 else 1.0
    return pooled if math.isnan(seeds) else max(pooled, seeds)


def at_least_p(p_values: Sequence[float], at_least: int) -> float:
    """Return the p-value that at least u of m null hypotheses are false: (m - u + 1) times the u-th smallest.

    A partial conjunction by Bonferroni's method (Benjamini and Heller 2008). NaN, a test not done, counts as 1.
    """
    known = sorted(1.0 if math.isnan(p) else p for p in p_values)
    return min(1.0, (len(known) - at_least + 1) * known[at_least - 1])


def prediction_interval(sample: Sample, *, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the interval in which the mean of ``n`` new values falls.

    For 10 values and 10 new ones: mean ± 1.012 unbiased standard deviations, 1.066 times the population's.
    """
    deviation = math.sqrt(sample.mean_variance * (1 + sample.n / n))
    reach = float(stats.t.ppf((1 + confidence) / 2, sample.n - 1)) * deviation
    return sample.mean - reach, sample.mean + reach


def spearman_within(strata: Iterable[tuple[ArrayLike, ArrayLike]]) -> tuple[float, float]:
    """Return Spearman's correlation within strata, and its two-sided p-value (NaN where there is none to speak of).

    Ranks are taken within each stratum, centred, and divided by its number of values, so that strata of any size span
    alike; the correlation is Pearson's of all of them. Besides the slope, a mean is estimated in each stratum: of n
    values in k strata n - 1 - k degrees of freedom are left to t (n - 2 in a single one, as usual).
    """
    pairs = [(np.asarray(x, dtype=float), np.asarray(y, dtype=float)) for x, y in strata]
    pairs = [(x, y) for x, y in pairs if len(x)]
    if not pairs:
        return math.nan, math.nan
    x, y = (np.concatenate([_centred_ranks(values) for values in side]) for side in zip(*pairs, strict=True))
    freedom = len(x) - 1 - len(pairs)
    if freedom < 1 or not x.any() or not y.any():
        return math.nan, math.nan
    rho = float(np.clip(x @ y / math.sqrt((x @ x) * (y @ y)), -1, 1))
    t = rho * math.sqrt(freedom / (1 - rho**2)) if abs(rho) < 1 else math.copysign(math.inf, rho)
    return rho, float(2 * stats.t.sf(abs(t), freedom))


def _centred_ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((stats.rankdata(values) - (len(values) + 1) / 2) / len(values))


def rank_sum_p(lower: Sequence[float], higher: Sequence[float]) -> float:
    """Return the exact one-sided p-value of the Mann-Whitney test that ``lower`` is lower; ties share their ranks.

    Scipy's is exact only without ties and for up to eight values: of three runs against three that never get there, all
    tied, it says .03, where no order of six values is rarer than 1 in 20.
    """
    ranks = stats.rankdata([*lower, *higher])
    doubled = np.rint(2 * ranks).astype(int)  # whole numbers: shared ranks may be halves
    observed, total = int(doubled[: len(lower)].sum()), int(doubled.sum())
    ways = np.zeros((len(lower) + 1, total + 1))  # to choose so many of the ranks, by their sum
    ways[0, 0] = 1
    for rank in doubled:
        ways[1:, rank:] += ways[:-1, : total + 1 - rank].copy()
    return float(ways[-1, : observed + 1].sum() / ways[-1].sum())
