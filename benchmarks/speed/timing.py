"""Timing by pytest-benchmark's fixture, with types."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pytest_benchmark.fixture import BenchmarkFixture


def measure(
    benchmark: BenchmarkFixture,
    work: Callable[[], object],
    *,
    rounds: int,
    warm_up: int = 0,
    setup: Callable[[], None] | None = None,
) -> NDArray[np.float64]:
    """Time ``rounds`` calls, with ``setup`` untimed before each; returns the seconds of each (rounds,)."""
    benchmark.pedantic(work, setup=setup, rounds=rounds, warmup_rounds=warm_up)  # type: ignore[no-untyped-call]
    stats = benchmark.stats
    assert stats is not None
    return np.array(stats.stats.data)
