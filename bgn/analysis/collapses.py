"""Collapses: a run that succeeded often, and at some later point of its curve no longer does at all.

They decide what a fixed evaluation of the final policy finds: of two runs that learnt the same one may end between a
collapse and the recovery. Between two points of a curve more may happen than it shows, so counts are lower bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bgn.analysis.aggregate import settled

#: Success in the last 100 training episodes at which a task counts as learnt in part, and at which it counts as lost.
#: A random policy succeeds in at most .15 of them (TwoBumps-1D).
LEARNT = 0.2
LOST = 0.01


@dataclass(frozen=True)
class Collapses:
    """What happens to the success of one run."""

    count: int
    """How often success falls from ``LEARNT`` or more to ``LOST`` or less."""
    recoveries: int
    """How often it comes back to ``LEARNT`` after that."""
    entropy: float
    """Mean entropy of the policy at the points at which success is lost, in nats; NaN without one
    or where curves do not show it."""
    episode_steps: float
    """Environment steps to an episode there, mean over these points; NaN without one."""

    @property
    def ends_lost(self) -> bool:
        """Whether training ends between a collapse and a recovery."""
        return self.count > self.recoveries


def collapses(curve: pd.DataFrame) -> Collapses:
    """Return the collapses of one run's curve (points with fewer than 100 episodes behind them do not count)."""
    curve = settled(curve, "success_100")
    count = recoveries = 0
    learnt = False
    lost = np.zeros(len(curve), dtype=bool)
    for i, success in enumerate(curve["success_100"]):
        if success >= LEARNT:
            recoveries += count > recoveries
            learnt = True
        elif success <= LOST and learnt:
            count, learnt = count + 1, False
        lost[i] = count > recoveries and success <= LOST
    lengths = curve["env_steps"].diff() / curve["episodes"].diff()
    entropy = _mean(curve["entropy"][lost]) if "entropy" in curve else math.nan  # not every learner logs it
    return Collapses(count, recoveries, entropy, _mean(lengths[lost]))


def late_success(curve: pd.DataFrame, share: float = 0.2) -> float:
    """Return the mean success over the last ``share`` of a run's steps, weighed by steps; NaN for an empty curve."""
    curve = settled(curve, "success_100")
    if curve.empty:
        return math.nan
    steps, values = (curve[c].to_numpy(dtype=float) for c in ("env_steps", "success_100"))
    late = steps >= (1 - share) * steps[-1]
    if late.sum() < 2:
        return float(values[-1])
    return float(np.trapezoid(values[late], steps[late]) / np.ptp(steps[late]))


def _mean(values: pd.Series) -> float:
    return float(values[np.isfinite(values)].mean())
