"""The published stores as the product reads them, each read once for all tests of a process."""

from __future__ import annotations

import functools

from benchmarks import evidence, pooled
from benchmarks.evidence import StoredEvidence
from tests.benchmarks.published_rows import RESULTS

Store = tuple[str, str]
"""Budget and preset."""
POOLED = ("pooled", "longest")
"""What README and CLAIMS.md show."""


@functools.cache
def stored(store: Store) -> StoredEvidence:
    budget, preset = store
    return pooled.load(RESULTS) if store == POOLED else evidence.load(RESULTS, budget=budget, preset=preset)
