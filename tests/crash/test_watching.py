"""What looks for leaks and leftovers finds them."""

from __future__ import annotations

import itertools
import pathlib

import pytest

from bgn.results.store import Store
from tests.benchmarks import fakes
from tests.crash.holdings import Holdings, assert_nothing_piles_up
from tests.crash.stores import assert_unlocked, assert_untouched, done, finished, strays

STRAYS = (
    "runs/hallway/ab-cb/.seed-0.parquet.7.partial",
    "runs/hallway/ab-cb/seed-0.failed.parquet",
    "references/hallway/random/clean.failed.parquet",
    ".work/hallway/ab-cb/key-0-2.checkpoint",
    ".work/hallway/ab-cb/key-2.checkpoint.damaged",
    "quarantine/runs/hallway/ab-cb/seed-0.parquet",
)
WORK_TO_DO = (
    "runs/hallway/ab-cb/seed-2.failed.parquet",
    "policies/hallway/ab-cb/seed-2.safetensors",
    ".work/hallway/ab-cb/key-2-3.checkpoint",
    ".work/lock",
)


def test_strays(tmp_path: pathlib.Path) -> None:
    store = fakes.fill(tmp_path, fakes.WORKING, domain="hallway", agent="ab-cb", reference="random")
    assert {"hallway/ab-cb/seed-0", "hallway/random/clean"} < done(store)
    for name in (*STRAYS, *WORK_TO_DO):
        (store.root / name).parent.mkdir(parents=True, exist_ok=True)
        (store.root / name).touch()
    assert strays(store) == {*STRAYS}


@pytest.mark.parametrize("kind", ["runs", "curves", "policies", "references"])
def test_what_is_written_again_is_not_untouched(kind: str, tmp_path: pathlib.Path) -> None:
    store = fakes.fill(tmp_path, fakes.WORKING, domain="hallway", agent="ab-cb", reference="random")
    before = finished(store)
    assert_untouched(before, finished(store))
    path = next(path for path in before if path.is_relative_to(store.root / kind))
    copy = path.with_suffix(".copy")
    copy.write_bytes(path.read_bytes())
    copy.replace(path)
    with pytest.raises(AssertionError):
        assert_untouched(before, finished(store))


def test_a_lock_that_is_held(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    assert_unlocked(store)
    with store.lock(), pytest.raises(BlockingIOError):
        assert_unlocked(store)
    assert_unlocked(store)


@pytest.mark.parametrize("leak", [(1.0, 0, 0, 0), (0.0, 1, 0, 0), (0.0, 0, 1, 0), (0.0, 0, 0, 1)])
def test_leaks(leak: tuple[float, int, int, int]) -> None:
    noise = itertools.cycle((0.0, 90.0, 3.0))
    steady = [Holdings(500.0 + next(noise), 12, 4, 0) for _ in range(200)]
    assert_nothing_piles_up(steady)
    leaking = [
        Holdings(one.megabytes + i * leak[0], 12 + i * leak[1], 4 + i * leak[2], i * leak[3])
        for i, one in enumerate(steady)
    ]
    with pytest.raises(AssertionError):
        assert_nothing_piles_up(leaking)
