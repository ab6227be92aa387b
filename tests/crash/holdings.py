"""What a process holds, and whether it comes to hold more and more."""

from __future__ import annotations

import gc
import os
import pathlib
import statistics
from collections.abc import Sequence
from dataclasses import astuple, dataclass

from tests.crash.processes import others

MAX_GROWTH_MEGABYTES = 64.0
#: Below, medians of quarters say nothing.
FEWEST = 8


@dataclass(frozen=True)
class Holdings:
    """Memory, open files, threads and child processes."""

    megabytes: float
    files: float
    threads: float
    children: float

    @classmethod
    def now(cls) -> Holdings:
        """Look at this process."""
        gc.collect()
        pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
        return cls(
            megabytes=pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
            files=len(os.listdir("/proc/self/fd")),
            threads=len(os.listdir("/proc/self/task")),
            children=len(others(os.getpid())),
        )

    def __str__(self) -> str:
        return (
            f"{self.megabytes:.1f} MB, {self.files:g} files, {self.threads:g} threads, "
            f"{self.children:g} children"
        )


def early_and_late(seen: Sequence[Holdings]) -> tuple[Holdings, Holdings]:
    """Return the medians of the second quarter, when all that is kept on purpose is there, and of the last."""
    quarter = len(seen) // 4
    return _median(seen[quarter : 2 * quarter]), _median(seen[-quarter:])


def growth(seen: Sequence[Holdings]) -> str:
    """Describe how what is held has changed."""
    if len(seen) < FEWEST:
        return f"too few rounds to tell growth; {seen[-1]}"
    early, late = early_and_late(seen)
    return f"{late.megabytes - early.megabytes:+.1f} MB from {early} to {late}"


def assert_nothing_piles_up(seen: Sequence[Holdings]) -> None:
    """Fail if what is held grows."""
    if len(seen) < FEWEST:
        return
    early, late = early_and_late(seen)
    assert late.megabytes - early.megabytes < MAX_GROWTH_MEGABYTES, growth(seen)
    assert late.files <= early.files, growth(seen)
    assert late.threads <= early.threads, growth(seen)
    assert late.children <= early.children, growth(seen)


def _median(seen: Sequence[Holdings]) -> Holdings:
    return Holdings(*map(statistics.median, zip(*map(astuple, seen), strict=True)))
