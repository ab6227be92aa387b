"""``kill -9`` at random moments, parent and workers: nothing is lost, and the end is the same, bit for bit."""

from __future__ import annotations

import pathlib
import random
import subprocess
import time

import pytest

from benchmarks.__main__ import main
from bgn.results.store import Store
from tests.benchmarks import fakes
from tests.benchmarks.test_command import smoke
from tests.crash import tiny
from tests.crash.processes import await_death, children, kill, wait_until
from tests.crash.stores import Files, assert_same_results, assert_untouched, finished, strays
from tests.effort import effort

KILLS = effort(20, 100)


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


def test_only_what_was_not_stored_has_failed_when_a_worker_dies(tmp_path: pathlib.Path) -> None:
    command = ["run", *smoke(tmp_path, "hallway", agents=["ab-cb"]), "--jobs", "1"]
    assert main(command, work=fakes.HALVING) == 1
    store = tiny.store_of(tmp_path)
    before = finished(store)
    assert store.read("runs")[["seed", "status"]].to_numpy().tolist() == [[0, "ok"], [1, "failed"]]
    assert main(command, work=fakes.WORKING) == 0
    assert_untouched(before, finished(store))
    assert set(store.read("runs")["status"]) == {"ok"}
    assert not strays(store)


def test_kills(whole: tuple[Store, float], tmp_path: pathlib.Path) -> None:
    reference, seconds = whole
    rng = random.Random(14)
    kills, round_ = 0, 0
    while kills < KILLS:
        results = tmp_path / str(round_)
        store = tiny.store_of(results)
        before: Files = {}
        while kills < KILLS and len(before) < len(finished(reference)):
            died = disturb(tiny.start(tiny.arguments(results)), rng, seconds)
            kills += died
            # Moments that come too late: the machine has become faster, or little is left to do.
            seconds *= 1.1 if died else 0.5
            after = finished(store)
            assert_untouched(before, after)
            before = after
        run_to_the_end(results)
        assert_untouched(before, finished(store))
        assert_same_results(store, reference)
        assert len(store.read("runs")) == tiny.RUNS
        assert not strays(store)
        round_ += 1
    print(f"{kills} kills, {round_} stores")
