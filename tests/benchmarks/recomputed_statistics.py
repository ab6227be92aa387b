"""What the published numbers are recomputed with: rules of the documents, in numpy and scipy alone.

Nothing of the project's analysis is imported: what README and DEVIATIONS.md say is written out again here.
"""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

METRICS = {"hallway": "greedy_return", "hallway-2": "greedy_return"}
METRICS |= dict.fromkeys(("rocksample-4-4", "rocksample-5-5"), "sampled_return")
METRICS |= dict.fromkeys(("top-plate", "two-bumps-1d", "two-bumps-2d"), "sampled_success")
TOLERANCES = {"hallway": 0.05, "hallway-2": 0.05, "rocksample-4-4": 1.0, "rocksample-5-5": 1.0}
TOLERANCES |= dict.fromkeys(("top-plate", "two-bumps-1d", "two-bumps-2d"), 0.01)
#: Environment steps of the paper's runs (DEVIATIONS.md, "Horizons").
HORIZONS = {domain: n * 1_000_000 for domain, n in zip(METRICS, (3, 10, 15, 15, 1, 2, 10), strict=True)}
AGENTS = ("ah-ch", "ah-ch+bgn", "ah-cs", "ab-cb", "ah-cb")
TABLE_6 = {
    "hallway": ((0.50, 0.02), (0.54, 0.01), (0.46, 0.08), (0.53, 0.04), (0.48, 0.03)),
    "hallway-2": ((0.10, 0.02), (0.35, 0.01), (0.26, 0.02), (0.36, 0.01), (0.29, 0.02)),
    "rocksample-4-4": ((7.79, 1.12), (14.14, 0.21), (6.73, 0.15), (13.94, 0.33), (6.1, 2.04)),
    "rocksample-5-5": ((6.23, 0.35), (14.71, 0.5), (6.52, 0.09), (15.22, 0.52), (6.53, 0.08)),
}
SEEDS = 10


class Sample(NamedTuple):
    """Mean, standard deviation (ddof 1, not below the error of a value) and number of seeds."""

    mean: float
    sd: float
    n: int


def of_table_6(domain: str, agent: str) -> Sample:
    """Return a printed mean with its deviation, which the paper takes with ddof 0, over ten seeds."""
    mean, sd = TABLE_6[domain][AGENTS.index(agent)]
    return Sample(mean, sd * np.sqrt(SEEDS / (SEEDS - 1)), SEEDS)


def episodes(runs: pd.DataFrame) -> np.ndarray:
    return np.array([json.loads(spec)["evaluation_episodes"] for spec in runs["spec"]])


def sample(runs: pd.DataFrame, metric: str) -> Sample:
    values = runs[metric].to_numpy()
    if metric.endswith("success"):
        n = episodes(runs)
        moved = (values * n + 0.5) / (n + 1)  # half a success and half a failure more: never an error of zero
        errors = np.sqrt(moved * (1 - moved) / n)
    else:
        errors = runs[f"{metric}_se"].to_numpy()
    return Sample(values.mean(), max(values.std(ddof=1), np.sqrt((errors**2).mean())), len(values))


def welch(a: Sample, b: Sample, tail: str, shift: float = 0.0) -> float:
    """Return p of Welch's test of mean(a) - mean(b) = shift; NaN where neither mean has any error."""
    if a.sd == b.sd == 0:
        return np.nan
    moved = a._replace(mean=a.mean - shift)
    return stats.ttest_ind_from_stats(*moved, *b, equal_var=False, alternative=tail).pvalue


def tost(a: Sample, b: Sample, tolerance: float) -> float:
    return max(welch(a, b, "less", tolerance), welch(a, b, "greater", -tolerance))


def holm(p_values: Sequence[float], family: int) -> list[float]:
    """Return Holm's p-values: the i-th smallest times (family - i), never falling. NaN is a test not done."""
    adjusted, highest = list(p_values), 0.0
    for rank, index in enumerate(i for i in np.argsort(p_values) if not np.isnan(p_values[i])):
        highest = max(highest, min(1.0, p_values[index] * (family - rank)))
        adjusted[index] = highest
    return adjusted


def student(values: Sequence[float]) -> tuple[float, float]:
    """Return Student's 95 % interval of the mean."""
    return mean_interval(Sample(np.mean(values), np.std(values, ddof=1), len(values)))


def mean_interval(of: Sample) -> tuple[float, float]:
    """Return Student's 95 % interval of a sample's mean."""
    reach = stats.t.ppf(0.975, of.n - 1) * of.sd / np.sqrt(of.n)
    return of.mean - reach, of.mean + reach


def seed_rate(rates: np.ndarray, n: np.ndarray) -> tuple[float, float]:
    """Return the wider of Student's interval over seeds and Clopper-Pearson's over all episodes, in [0, 1]."""
    pooled = stats.binomtest(round(sum(rates * n)), sum(n)).proportion_ci(0.95, "exact")
    low, high = student(rates)
    return max(0.0, min(pooled.low, low)), min(1.0, max(pooled.high, high))


def sides(of: Sample, value: float) -> tuple[float, float]:
    """Return the p-values of Student's tests that a mean is above, and that it is below, a value."""
    if of.sd == 0:
        return np.nan, np.nan
    t = stats.t(of.n - 1, loc=of.mean, scale=of.sd / np.sqrt(of.n))
    return t.cdf(value), t.sf(value)


def sides_of_rate(rates: np.ndarray, n: np.ndarray, value: float) -> tuple[float, float]:
    """Return the same of a seed's rate: the larger of Student's p over seeds and the binomial one over all episodes."""
    trials = stats.binom(sum(n), value)
    successes = round(sum(rates * n))
    pooled = trials.sf(successes - 1), trials.cdf(successes)
    seeds = sides(Sample(np.mean(rates), np.std(rates, ddof=1), len(rates)), value)
    return tuple(np.fmax(pooled, seeds))


def rank_sum(lower: Sequence[float], higher: Sequence[float]) -> float:
    """Return the exact chance that ranks are as low as those of ``lower``, ties sharing theirs (Mann-Whitney)."""
    ranks = stats.rankdata([*lower, *higher])
    sums = ranks[_choices(len(ranks), len(lower))].sum(axis=1)
    return float(np.mean(sums <= ranks[: len(lower)].sum()))


def within_groups(x: Sequence[float], y: Sequence[float], groups: Sequence[str]) -> tuple[float, float]:
    """Return the correlation of what two columns have left once each group's mean is regressed out, and its p.

    Without any correlation r is distributed as Pearson's of n - (groups - 1) values. NaN where nothing is left.
    """
    dummies = pd.get_dummies(pd.Series(groups)).to_numpy(dtype=float)
    left = [np.asarray(column) - dummies @ np.linalg.lstsq(dummies, column)[0] for column in (x, y)]
    freedom = len(groups) - 1 - dummies.shape[1]
    if freedom < 1 or min(np.abs(column).max() for column in left) < 1e-9:
        return np.nan, np.nan
    r = np.corrcoef(*left)[0, 1]
    return r, 2 * stats.beta.sf(abs(r), freedom / 2, freedom / 2, loc=-1, scale=2)


@functools.cache
def _choices(n: int, size: int) -> np.ndarray:
    """Return all ways to choose so many of n."""
    return np.array(list(itertools.combinations(range(n), size)))


def bootstrap(
    values: dict[str, np.ndarray], statistic: Callable[[dict[str, np.ndarray]], np.ndarray]
) -> np.ndarray:
    """Return a statistic of 4,000 samples whose seeds are drawn anew within each cell."""
    generator = np.random.default_rng(2020)
    drawn = {name: generator.choice(v, size=(4000, len(v))).mean(axis=1) for name, v in values.items()}
    return statistic(drawn)
