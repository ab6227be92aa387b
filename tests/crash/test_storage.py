"""A full or read-only disk ends the command in its own words; what is stored stays."""

from __future__ import annotations

import datetime
import itertools
import os
import pathlib
import subprocess
from collections.abc import Iterator

import pytest

from benchmarks import tasks
from benchmarks.__main__ import main
from bgn.results.store import StorageError, Store
from tests.benchmarks import fakes
from tests.benchmarks.test_command import smoke, stored

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def small_disk(tmp_path: pathlib.Path) -> Iterator[pathlib.Path]:
    """Return a folder that is a disk of one megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("mounting a small disk takes a Linux and the rights to")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk(small_disk: pathlib.Path, capsys: Capture) -> None:
    command = ["run", *smoke(small_disk, "hallway", agents=["ah-ch", "ab-cb"]), "--jobs", "1"]
    filler = small_disk / "filler"
    with filler.open("wb") as file:
        free = os.statvfs(small_disk)
        file.write(b"x" * (free.f_bavail * free.f_frsize - 100_000))
    assert main(command, work=fakes.WORKING) == 3
    error = capsys.readouterr().err
    assert f"error: cannot write {small_disk}" in error
    assert "No space left on device; make room there" in error
    runs = stored(small_disk).read("runs")
    assert runs.empty or set(runs["status"]) == {"ok"}  # a full disk is nobody's failure
    filler.unlink()
    assert main(command, work=fakes.WORKING) == 0
    assert not list(small_disk.rglob("*.partial"))


def test_a_read_only_disk(small_disk: pathlib.Path, capsys: Capture) -> None:
    command = smoke(small_disk, "hallway", agents=["ab-cb"])
    assert main(["run", *command, "--jobs", "1", "--seeds", "0"], work=fakes.WORKING) == 0
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    capsys.readouterr()
    assert main(["run", *command], work=fakes.WORKING) == 3
    assert "Read-only file system; make room there, or choose another folder" in capsys.readouterr().err
    assert main(["status", *command]) == 0
    assert "1/2" in capsys.readouterr().out
    show = ["tables", "--results", str(small_disk), "--budget", "smoke"]
    assert main(show) == 0
    assert "What the paper claims" in capsys.readouterr().out
    assert main([*show, "--write"]) == 3
    assert "What the paper claims" in capsys.readouterr().out  # printed, though it cannot be kept


def test_other_errors_are_not_the_disks(tmp_path: pathlib.Path) -> None:
    from bgn.results.store import writing_to

    with pytest.raises(StorageError, match="cannot write here: No space left"), writing_to(tmp_path):
        raise OSError(28, "No space left on device", "here")
    with pytest.raises(FileNotFoundError), writing_to(tmp_path):  # type: ignore[unreachable]
        raise FileNotFoundError(2, "No such file", "here")


def test_damaged_results_are_set_aside_and_computed_anew(tmp_path: pathlib.Path, capsys: Capture) -> None:
    command = ["run", *smoke(tmp_path, "hallway", agents=["ab-cb"]), "--jobs", "1"]
    assert main(command, work=fakes.WORKING) == 0
    store = stored(tmp_path)
    whole = store.shard("runs", "hallway/ab-cb/seed-0")
    written = whole.stat().st_mtime_ns
    truncated = store.shard("runs", "hallway/ab-cb/seed-1")
    truncated.write_bytes(truncated.read_bytes()[:500])
    assert main(["status", *command[1:-2]], work=fakes.WORKING) == 2
    assert f"cannot read {truncated}" in capsys.readouterr().err
    assert main(command, work=fakes.WORKING) == 0
    error = capsys.readouterr().err
    assert f"{truncated} is damaged" in error
    assert "its run is computed anew" in error
    assert set(store.read("runs")["status"]) == {"ok"}
    assert len(store.read("runs")) == 2
    assert whole.stat().st_mtime_ns == written


def test_a_clock_that_is_set_back(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = datetime.datetime(2026, 1, 1, 12, tzinfo=datetime.UTC)
    clock = (start - datetime.timedelta(hours=hours) for hours in itertools.count())
    monkeypatch.setattr(tasks, "now", lambda: next(clock))
    from benchmarks.executors import streams  # in this process, where the clock is ours

    monkeypatch.setattr("benchmarks.executors.processes.run_tasks", streams.run_tasks)
    assert (
        main(["run", *smoke(tmp_path, "hallway", agents=["ab-cb"]), "--jobs", "1"], work=fakes.WORKING) == 0
    )
    runs = Store(stored(tmp_path).root).read("runs")
    assert (runs["finished_at"] >= runs["started_at"]).all()
