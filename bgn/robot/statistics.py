"""What a number of successes says about a success rate."""

from __future__ import annotations

from scipy.stats import binomtest

CONFIDENCE = 0.95


def clopper_pearson(successes: int, episodes: int) -> tuple[float, float]:
    """Return the exact two-sided 95 % interval of a success rate; (0, 1) of no episodes."""
    if episodes == 0:
        return 0.0, 1.0
    interval = binomtest(successes, episodes).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)
