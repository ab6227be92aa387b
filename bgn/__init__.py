"""Belief-Grounded Networks (CoRL 2020) as a reproducibility benchmark under partial observability."""

from bgn import _gymnasium

_gymnasium.register()
