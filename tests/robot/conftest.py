"""A twin in a process of its own, and sessions of the command on it."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bgn.__main__ import main
from bgn.robot.recording import read_events, read_raw
from bgn.robot.twin.client import TwinProcess

#: Every twin of a test run has an address of its own.
ADDRESSES = itertools.count(101)


def needs_client() -> None:
    """Skip where the field's client is missing or loopback has one address only."""
    pytest.importorskip("rtde_control", reason="ur_rtde is not installed (extra `robot`)")
    if not sys.platform.startswith("linux"):
        pytest.skip("twins side by side need several loopback addresses, which Linux has")


@pytest.fixture(scope="module")
def twin() -> Iterator[TwinProcess]:
    """A twin in real time, before the bench of TwoBumps-1D; used again by every test of a module."""
    needs_client()
    with TwinProcess("two-bumps-1d", f"127.0.0.{next(ADDRESSES)}") as running:
        yield running


@dataclass
class Outcome:
    """What a session left."""

    code: int
    said: str
    folder: Path
    episodes: pd.DataFrame

    @property
    def last(self) -> Any:
        """The last attempt at an episode."""
        return self.episodes.iloc[-1]

    def raw(self, attempt: int = -1) -> pd.DataFrame:
        return read_raw(self._episode(attempt))

    def events(self, attempt: int = -1) -> pd.DataFrame:
        return read_events(self._episode(attempt))

    def _episode(self, attempt: int) -> Path:
        return sorted(self.folder.glob("episodes/two-bumps-1d-0*"))[attempt]


class Evaluation:
    """Runs ``bgn robot evaluate`` on a twin: one episode of TwoBumps-1D that takes ten steps without a fault."""

    def __init__(self, twin: TwinProcess, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.twin, self.folder, self._capsys = twin, folder, capsys

    def run(
        self, *options: str, faults: tuple[str, ...] = (), scale: float = 1.0, operator: bool = True
    ) -> Outcome:
        client = self.twin.client
        client.ask("heal")
        client.ask("scale", scale=scale)
        client.ask("task", task="two-bumps-1d")  # the arm back at its middle, no stop left over
        for fault in faults:
            client.ask("fault", fault=fault)
        arguments = [
            "robot", "evaluate", "--host", self.twin.host, "--execute", "--no-lap", "--task", "two-bumps-1d",
            "--episodes", "1", "--seed", "1", "--stale-after", "0.4",
        ]  # fmt: skip
        arguments += ["--twin-operator"] if operator else []
        arguments += [] if "--resume" in options else ["--out", str(self.folder)]
        code = main([*arguments, *options])
        captured = self._capsys.readouterr()
        files = sorted(self.folder.glob("episodes/two-bumps-1d-0*/episode.json"))
        episodes = pd.DataFrame([json.loads(file.read_text()) for file in files])
        return Outcome(code, captured.out + captured.err, self.folder, episodes)


@pytest.fixture
def evaluation(twin: TwinProcess, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Evaluation:
    return Evaluation(twin, tmp_path / "session", capsys)
