"""Belief-Grounded Networks (CoRL 2020) as a reproducibility benchmark under partial observability."""
