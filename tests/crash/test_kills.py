"""``kill -9`` at random moments, parent and workers: nothing is lost, and the end is the same, bit for bit."""

from __future__ import annotations

import contextlib
import pathlib
import random
import subprocess
import time

import pandas as pd
import pytest

from bgn.results import schema
from bgn.results.comparison import TIMINGS
from bgn.results.store import Store
from tests.crash import tiny
from tests.crash.processes import await_death, children, kill
from tests.effort import effort

KILLS = effort(20, 100)
#: What says how a result came about, not what it is: all but the hashes of what determines it.
PROVENANCE = {*schema.PROVENANCE} - {"key", "spec_hash", "code_hash", "data_hash", "spec"}

Files = dict[pathlib.Path, tuple[int, int, bytes]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, float]:
    """Return the store of a run that nobody disturbs, and how long it took."""
    results = tmp_path_factory.mktemp("whole")
    began = time.monotonic()
    run_to_the_end(results)
    return tiny.store_of(results), time.monotonic() - began


def run_to_the_end(results: pathlib.Path) -> None:
    process = tiny.start(tiny.arguments(results))
    output = process.communicate(timeout=300)[0]
    assert process.returncode == 0, output


def finished(store: Store) -> Files:
    """Return the files of all finished runs and rows: inode, time of writing and content."""
    rows = [path for kind in ("runs", "references") for path in (store.root / kind).rglob("[!.]*.parquet")]
    paths = [path for path in rows if not path.name.endswith(".failed.parquet")]
    for path in list(paths):
        run = path.relative_to(store.root / path.relative_to(store.root).parts[0]).with_suffix("").as_posix()
        paths += [one for one in (store.shard("curves", run), store.policy(run)) if one.exists()]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns, path.read_bytes()) for path in paths}


def assert_same_results(store: Store, other: Store) -> None:
    for kind, key in (("runs", ["run"]), ("references", ["run"]), ("curves", ["run", "env_steps"])):
        frames = []
        for one in (store, other):
            frame = one.read(kind)
            assert "status" not in frame or set(frame["status"]) == {"ok"}
            dropped = [*PROVENANCE, *TIMINGS]
            frames.append(frame.drop(columns=dropped, errors="ignore").sort_values(key, ignore_index=True))
        pd.testing.assert_frame_equal(*frames, check_exact=True)
    runs = store.read("runs")["run"]
    assert len(runs) == tiny.RUNS
    for run in runs:
        assert store.policy(run).read_bytes() == other.policy(run).read_bytes()


def wait_until(process: subprocess.Popen[str], moment: float) -> None:
    """Wait until a moment, but no longer than the process runs."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(max(0.0, moment - time.monotonic()))


def disturb(process: subprocess.Popen[str], rng: random.Random, seconds: float) -> int:
    """Kill a worker or two, then the parent, at random moments; return how many died of it."""
    kills = 0
    began = time.monotonic()
    moments = sorted(rng.uniform(0.0, seconds) for _ in range(rng.choice((2, 3, 3))))
    for moment in moments[:-1]:
        wait_until(process, began + moment)
        workers = children(process.pid)
        if workers:
            kills += kill(rng.choice(workers))
    wait_until(process, began + moments[-1])
    workers = children(process.pid)
    if process.poll() is None:
        process.kill()
        kills += 1
    process.communicate(timeout=60)
    await_death(workers)
    return kills


def test_kills(whole: tuple[Store, float], tmp_path: pathlib.Path) -> None:
    reference, seconds = whole
    rng = random.Random(14)
    kills, round_ = 0, 0
    while kills < KILLS:
        results = tmp_path / str(round_)
        store = tiny.store_of(results)
        before: Files = {}
        while kills < KILLS and len(before) < len(finished(reference)):
            kills += disturb(tiny.start(tiny.arguments(results)), rng, seconds)
            after = finished(store)
            assert {path: after.get(path) for path in before} == before
            before = after
        run_to_the_end(results)
        after = finished(store)
        assert {path: after.get(path) for path in before} == before
        assert_same_results(store, reference)
        assert not list(store.root.rglob("*.partial"))
        assert not list(store.root.rglob("*.tmp"))
        assert not list(store.root.rglob("*.checkpoint"))
        assert not (store.root / "quarantine").exists()
        round_ += 1
    print(f"{kills} kills, {round_} stores")
