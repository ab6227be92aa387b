"""A call that has a time limit ends cleanly, with checkpoints, and the next one goes on."""

from __future__ import annotations

import argparse
import pathlib
import time

import pytest

from benchmarks.__main__ import main, parse_duration
from benchmarks.registry import load
from bgn.results.store import Store
from tests.benchmarks import fakes

CHOSEN = ["--budget", "smoke", "--domain", "top-plate", "--agent", "ah-ch", "--jobs", "1"]


def test_time_is_up_and_the_next_call_goes_on(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begin = time.monotonic()
    arguments = ["run", "--results", str(tmp_path), *CHOSEN]
    assert main([*arguments, "--time-limit", "4"], work=fakes.HANGING) == 1
    assert time.monotonic() - begin < 30
    captured = capsys.readouterr()
    assert "time is up; the same command goes on from here" in captured.err
    assert "missing" in captured.out
    store = Store(tmp_path / "smoke" / load().defaults.preset)
    assert store.read("runs").empty
    assert list(store.root.rglob("*.checkpoint"))
    assert main(arguments, work=fakes.HANGING) == 0
    assert not store.read("runs").empty


@pytest.mark.parametrize(
    ("text", "seconds"), [("540", 540), ("9m", 540), ("1.5h", 5400), ("30s", 30), ("0.5", 0.5)]
)
def test_durations(text: str, seconds: float) -> None:
    assert parse_duration(text) == seconds


@pytest.mark.parametrize("text", ["", "0", "-3", "9x", "m", "nan", "inf"])
def test_what_is_not_a_duration(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="is not a time"):
        parse_duration(text)
