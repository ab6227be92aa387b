"""Statistics across domains: IQM, performance profiles, probability of improvement, sample efficiency.

Scores are grouped by domain (the strata): a mapping from domain id to one value per seed. Intervals are percentile
intervals of a stratified bootstrap, which draws seeds anew within each domain; every draw is made at once as one
array, from a generator with a fixed seed.

Source: Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice (2021).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Array = NDArray[np.float64]
Strata = Mapping[str, ArrayLike]
"""One value per seed, by domain."""

DRAWS = 2000
SEED = 0
#: Share of the upper reference row's return that counts as learnt.
LEARNT = 0.9
#: Episodes behind a point of a curve; before that its mean is over the few that happened to end soonest.
WINDOW = 100


@dataclass(frozen=True)
class Estimate:
    """A statistic with the 95 % interval of its bootstrap (ends may be infinite)."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return ``0.93 [0.90, 0.95]``."""
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


def iqm(scores: ArrayLike, axis: int = -1) -> Array:
    """Return the interquartile mean: the mean of the middle half (a quarter of the values cut at either end)."""
    return np.asarray(stats.trim_mean(np.asarray(scores, dtype=float), 0.25, axis=axis))


def resample(strata: Strata, draws: int = DRAWS, seed: int = SEED) -> dict[str, Array]:
    """Draw seeds anew within each domain: arrays (draws, seeds of the domain)."""
    generator = np.random.default_rng(seed)
    drawn = {}
    for domain, values in strata.items():
        array = np.asarray(values, dtype=float)
        drawn[domain] = array[generator.integers(len(array), size=(draws, len(array)))]
    return drawn


def interval(draws: ArrayLike, axis: int = 0) -> tuple[Array, Array]:
    """Return the 2.5 % and 97.5 % quantiles of bootstrap draws (a drawn value each: infinities stay themselves)."""
    low, high = np.quantile(np.asarray(draws, dtype=float), [0.025, 0.975], axis=axis, method="nearest")
    return low, high


def bootstrap_iqm(strata: Strata, draws: int = DRAWS, seed: int = SEED) -> Estimate:
    """Return the IQM over all seeds of all domains."""
    joined = np.concatenate([np.asarray(values, dtype=float) for values in strata.values()])
    drawn = np.concatenate(list(resample(strata, draws, seed).values()), axis=1)
    low, high = interval(iqm(drawn))
    return Estimate(float(iqm(joined)), float(low), float(high))


def performance_profile(
    strata: Strata, levels: ArrayLike, draws: int = DRAWS, seed: int = SEED
) -> pd.DataFrame:
    """Return, for each level, the share of runs that score above it (every domain weighs the same).

    Columns level, share, low, high.
    """
    level = np.asarray(levels, dtype=float)

    def shares(values: Array) -> Array:  # (..., seeds) -> (..., levels)
        ordered = np.sort(values, axis=-1)
        return np.asarray((ordered[..., :, None] > level).mean(axis=-2))

    share = np.mean([shares(np.asarray(v, dtype=float)) for v in strata.values()], axis=0)
    drawn = np.mean([shares(values) for values in resample(strata, draws, seed).values()], axis=0)
    low, high = interval(drawn)
    return pd.DataFrame({"level": level, "share": share, "low": low, "high": high})


def improvement_probability(x: Strata, y: Strata, draws: int = DRAWS, seed: int = SEED) -> Estimate:
    """Return the chance that a run of x scores above one of y, averaged over the domains that both have.

    Ties count half (the Mann-Whitney statistic over the number of pairs).
    """
    shared = [domain for domain in x if domain in y]
    ours = {domain: x[domain] for domain in shared}
    theirs = {domain: y[domain] for domain in shared}
    value = np.mean([_wins(np.asarray(ours[d]), np.asarray(theirs[d])) for d in shared])
    drawn_x, drawn_y = resample(ours, draws, seed), resample(theirs, draws, seed + 1)
    drawn = np.mean([_wins(drawn_x[d], drawn_y[d]) for d in shared], axis=0)
    low, high = interval(drawn)
    return Estimate(float(value), float(low), float(high))


def bootstrap(
    strata: Strata, statistic: Callable[[Mapping[str, Array]], Array], draws: int = DRAWS, seed: int = SEED
) -> Estimate:
    """Return a statistic of the strata; it maps arrays (..., seeds) by name to an array (...)."""
    value = statistic({name: np.asarray(values, dtype=float) for name, values in strata.items()})
    low, high = interval(statistic(resample(strata, draws, seed)))
    return Estimate(float(value), float(low), float(high))


def settled(curve: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return the points of a curve that have a full window of episodes behind them, and a value."""
    return curve[(curve["episodes"] >= WINDOW) & curve[column].notna()]


def steps_to(curve: pd.DataFrame, column: str, level: float) -> float:
    """Return the environment steps at which a run's curve first reaches a level, infinite if it never does.

    Between two points of the curve the value is taken to change linearly.
    """
    curve = settled(curve, column)
    steps, values = curve["env_steps"].to_numpy(dtype=float), curve[column].to_numpy(dtype=float)
    reached = np.flatnonzero(values >= level)
    if len(reached) == 0:
        return math.inf
    i = int(reached[0])
    if i == 0:
        return float(steps[0])
    share = (level - values[i - 1]) / (values[i] - values[i - 1])
    return float(steps[i - 1] + share * (steps[i] - steps[i - 1]))


def sample_efficiency(curves: Sequence[pd.DataFrame], column: str, level: float) -> Estimate:
    """Return the median over runs of the steps to a level, with its bootstrap interval.

    A run that never reaches it counts as infinite, and so does a median of which half the runs never do.
    """
    steps = [steps_to(curve, column, level) for curve in curves]
    return bootstrap({"runs": steps}, lambda strata: _median(strata["runs"]))


def _median(values: Array) -> Array:
    """Return the upper median, which is a value of the sample, so that infinities do not become NaN."""
    ordered = np.sort(values, axis=-1)
    return np.asarray(ordered[..., ordered.shape[-1] // 2])


def _wins(x: Array, y: Array) -> Array:
    """Return the share of pairs that x wins: (..., n) and (..., m) to (...)."""
    difference = np.sign(x[..., :, None] - y[..., None, :])
    return np.asarray((difference.mean(axis=(-2, -1)) + 1) / 2)
