"""What this machine can do, measured now: speeds drift, so every figure is stored beside these."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable

import torch

from bgn.results.environment import processor

PEAK_SIZE = 768


def peak_flops() -> float:
    """FLOP per CPU second of a large square float32 product on one thread: the best of a few."""
    a, b = torch.randn(PEAK_SIZE, PEAK_SIZE), torch.randn(PEAK_SIZE, PEAK_SIZE)
    out = torch.empty(PEAK_SIZE, PEAK_SIZE)
    best = min(_cpu_seconds(lambda: torch.mm(a, b, out=out)) for _ in range(6))
    return 2 * PEAK_SIZE**3 / best


def info() -> dict[str, str | int]:
    """Say what the figures were measured on."""
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "threads": torch.get_num_threads(),
    }


def _cpu_seconds(work: Callable[[], object]) -> float:
    torch.set_num_threads(1)
    start = time.process_time()
    work()
    return time.process_time() - start
