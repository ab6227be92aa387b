"""The same work over and over: the same results, and no memory, file, thread or process left behind."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import pathlib
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from benchmarks import registry
from benchmarks.__main__ import main
from bgn.training.trainer import train_cell
from tests.crash import tiny
from tests.crash.processes import children
from tests.crash.test_kills import assert_same_results
from tests.effort import effort
from tests.training.test_determinism import assert_identical
from tests.training.test_trainer import cell

pytestmark = pytest.mark.skipif(not effort(False, True), reason="takes minutes: nox -s torture")

WARM_UP = 3
MAX_GROWTH_MEGABYTES = 64.0
CELLS = (("ah-ch+bgn", "hallway"), ("ab-cb", "rocksample-4-4"), ("ah-cs", "top-plate"))


@dataclass(frozen=True)
class Holdings:
    """What a process holds."""

    megabytes: float
    files: int
    threads: int
    workers: int

    @classmethod
    def now(cls) -> Holdings:
        """Look at this process."""
        gc.collect()
        pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
        return cls(
            megabytes=pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
            files=len(os.listdir("/proc/self/fd")),
            threads=threading.active_count(),
            workers=len(children(os.getpid())),
        )


def soak(work: Callable[[], None], seconds: float) -> Iterator[Holdings]:
    """Repeat work for some time; yield what is held after the warm-up, and after every round from then on."""
    for _ in range(WARM_UP):
        work()
    yield Holdings.now()
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        work()
        yield Holdings.now()


def assert_nothing_piles_up(seen: list[Holdings], what: str) -> None:
    first, last = seen[0], seen[-1]
    growth = last.megabytes - first.megabytes
    print(f"{what}: {len(seen) - 1} rounds, {growth:+.1f} MB, {last}")
    assert len(seen) > 2
    assert growth < MAX_GROWTH_MEGABYTES
    assert (last.files, last.threads, last.workers) == (first.files, first.threads, first.workers)


def test_the_command(
    request: pytest.FixtureRequest, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny_registry = tiny.tiny_registry()
    monkeypatch.setattr(registry, "load", lambda *_: tiny_registry)
    first, again = tmp_path / "first", tmp_path / "again"

    def run(results: pathlib.Path) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            assert main(tiny.arguments(results), work=tiny.WORK) == 0

    run(first)

    def work() -> None:
        shutil.rmtree(again, ignore_errors=True)
        run(again)
        assert_same_results(tiny.store_of(again), tiny.store_of(first))

    seen = list(soak(work, request.config.getoption("--soak") / 2))
    assert_nothing_piles_up(seen, "command")


def test_training(request: pytest.FixtureRequest) -> None:
    specs = [cell(agent, domain, updates=40) for agent, domain in CELLS]
    first = [train_cell(spec, (0, 1)) for spec in specs]

    def work() -> None:
        for spec, results in zip(specs, first, strict=True):
            for one, other in zip(results, train_cell(spec, (0, 1)), strict=True):
                assert_identical(one, other)

    assert_nothing_piles_up(list(soak(work, request.config.getoption("--soak") / 2)), "training")
