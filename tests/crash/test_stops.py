"""Signals, a second command on the same store, and workers that say nothing."""

from __future__ import annotations

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from benchmarks.__main__ import main
from benchmarks.signals import Stopped, held_back, stoppable
from bgn.training import checkpoint as checkpoints
from bgn.training import trainer
from bgn.training.cell import Interrupted, Progress
from bgn.training.trainer import train_cell
from tests.benchmarks import fakes
from tests.crash.processes import await_death, children
from tests.training.test_trainer import assert_identical, cell

ROOT = pathlib.Path(__file__).parents[2]
CODE = (
    "import sys; from benchmarks.__main__ import main; from tests.benchmarks import fakes;"
    "sys.exit(main(sys.argv[1:], work=fakes.{}))"
)


@contextlib.contextmanager
def running(tools: str, results: pathlib.Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Start a command that never ends by itself; yield it and its worker's process id, once it works."""
    arguments = ["run", "--results", str(results), "--budget", "smoke", "--domain", "hallway", *options]
    process = subprocess.Popen(
        [sys.executable, "-c", CODE.format(tools), *arguments, "--jobs", "1"],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 120
        while not (started := [path for path in results.rglob("*.checkpoint") if path.read_text()]):
            assert time.monotonic() < deadline, "no worker started"
            time.sleep(0.05)
        yield process, int(started[0].read_text())
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_stops_the_command(
    signum: signal.Signals, status: int, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running("HANGING", tmp_path, "--agent", "ah-ch") as (process, worker):
        assert children(process.pid) == [worker]
        if signum == signal.SIGTERM:  # a second command on the same store, meanwhile
            again = ["run", "--results", str(tmp_path), "--budget", "smoke", "--agent", "ah-ch"]
            assert main(again, work=fakes.WORKING) == 2
            assert f"another process ({process.pid}) is writing to {tmp_path}" in capsys.readouterr().err
        os.kill(worker, signum)  # as a terminal does, which signals all processes: theirs not to answer
        process.send_signal(signum)
        error = process.communicate(timeout=60)[1]
        assert process.returncode == status
        assert error == f"stopped by {signum.name}; the same command goes on from here\n"
        await_death([worker])


def test_a_worker_that_says_nothing_dies_with_its_parent(tmp_path: pathlib.Path) -> None:
    with running("SILENT", tmp_path, "--reference", "random") as (process, worker):
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        await_death([worker])


def test_a_signal_while_a_planner_works_stops_it_at_once(tmp_path: pathlib.Path) -> None:
    with running("SILENT", tmp_path, "--reference", "random") as (process, worker):
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=60)
        assert process.returncode == 143
        await_death([worker])
        assert time.monotonic() - began < 9  # sooner than the grace that a cell has


def test_what_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stoppable():
            os.kill(os.getpid(), signal.SIGHUP)
            with pytest.raises(Stopped) as caught:
                signal.raise_signal(signal.SIGTERM)
        assert caught.value.exit_status == 143
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_signals_wait_while_they_are_held_back() -> None:
    """Also where another thread, which does not block them, is given them by the kernel."""
    reached = False
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()

    def work() -> None:
        nonlocal reached
        with held_back():
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.05)
            reached = True

    try:
        with stoppable(), pytest.raises(Stopped) as caught:
            work()
    finally:
        over.set()
        other.join()
    assert reached
    assert caught.value.exit_status == 143
    assert signal.SIGTERM not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.parametrize("reports", [3, 9])  # while training; when it is done, before the evaluation
def test_interrupted_training_leaves_a_checkpoint(
    reports: int, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trainer, "PROGRESS_SECONDS", -1.0)
    path = tmp_path / "stack.checkpoint"
    seen: list[Progress] = []

    def stop(progress: Progress) -> None:
        seen.append(progress)
        if len(seen) == reports:
            raise Interrupted

    spec = cell("ah-cs", "rocksample-4-4", updates=8)
    with pytest.raises(Interrupted):
        train_cell(spec, (0,), checkpoint=path, on_progress=stop)
    content = checkpoints.load(path)
    assert content is not None
    assert content["done"] == min(reports, 8)
    assert_identical(train_cell(spec, (0,), checkpoint=path)[0], train_cell(spec, (0,))[0])
