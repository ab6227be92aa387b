"""What an evaluation leaves behind: one folder a session, one folder an episode, written as it goes.

``session.json``        what was evaluated: policies with hashes, robot, laboratory, plan
``episodes/NAME/``      one attempt at an episode, or a first lap
    ``episode.json``    start, outcome and reason; the outcome of an episode that never ended is ``incomplete``
    ``steps.parquet``   one row a step: observation, action, angle, hinge, and how long it took
    ``raw*.parquet``    every sample of the robot: joints, pose, speed, wrench, states, and the finger's last reading
    ``events*.parquet`` commands and what happened
``summary.parquet``     one row a task

Parts (``raw-0000.parquet``, ...) are joined when an episode ends; after a crash the parts are there, and
:func:`read_raw` reads either.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from bgn.robot.errors import UsageError
from bgn.robot.worker import COLUMNS, Row

FORMAT: Final = "bgn-robot-session-1"
FLUSH: Final = 2.0  # s between two parts
INCOMPLETE: Final = "incomplete"
#: How a finished episode can end; every other outcome marks one that was interrupted.
FINISHED: Final = ("success", "failure", "out-of-time")
RAW_COLUMNS: Final = (*COLUMNS, "angle_0", "angle_1", "angle_age")


@dataclass(frozen=True)
class Start:
    """Where an episode of the plan begins."""

    task: str
    number: int
    x: int
    y: int

    @property
    def name(self) -> str:
        """Its folder, before the number of the attempt."""
        return f"{self.task}-{self.number:03d}"


class Recording:
    """One attempt at an episode; it is a ``Log`` of the arm."""

    def __init__(self, folder: Path, about: Mapping[str, Any]) -> None:
        folder.mkdir(parents=True)
        self.folder = folder
        self._about = {**about, "started": time.time(), "outcome": INCOMPLETE, "reason": ""}
        self._raw: list[tuple[float, ...]] = []
        self._events: list[tuple[float, str, str]] = []
        self._steps: list[dict[str, Any]] = []
        self._angles, self._heard = (float("nan"),) * 2, time.monotonic()
        self._parts, self._flushed = 0, time.monotonic()
        _write_json(folder / "episode.json", self._about)

    def samples(self, rows: Iterable[Row]) -> None:
        """Keep samples of the robot, each with the finger's last reading and its age."""
        self._raw.extend((*row, *self._angles, row[0] - self._heard) for row in rows)
        if time.monotonic() - self._flushed > FLUSH:
            self.flush()

    def angles(self, pair: tuple[float, float]) -> None:
        """Keep a reading of the finger for the samples that follow."""
        self._angles, self._heard = pair, time.monotonic()

    def event(self, kind: str, text: str) -> None:
        """Keep something that happened."""
        self._events.append((time.monotonic(), kind, text))

    def step(self, **values: Any) -> None:
        """Keep one step; the table is on disk when this returns."""
        self._steps.append(values)
        _write_table(self.folder / "steps.parquet", pd.DataFrame(self._steps))

    def flush(self) -> None:
        """Write what has come since the last part."""
        self._flushed = time.monotonic()
        if self._raw:
            _write_table(
                self.folder / f"raw-{self._parts:04d}.parquet", pd.DataFrame(self._raw, columns=RAW_COLUMNS)
            )
        if self._events:
            events = pd.DataFrame(self._events, columns=["wall", "kind", "text"])
            _write_table(self.folder / f"events-{self._parts:04d}.parquet", events)
        self._parts += 1
        self._raw, self._events = [], []

    def finish(self, outcome: str, reason: str = "", **values: Any) -> None:
        """Mark how it ended and join the parts."""
        self.event("outcome", f"{outcome} {reason}".strip())
        self.flush()
        for kind in ("raw", "events"):
            parts = sorted(self.folder.glob(f"{kind}-*.parquet"))
            if parts:
                _write_table(self.folder / f"{kind}.parquet", _read_parts(self.folder, kind))
                for part in parts:
                    part.unlink()
        self._about |= {"outcome": outcome, "reason": reason, "ended": time.time(), **values}
        _write_json(self.folder / "episode.json", self._about)


class SessionFolder:
    """A session's folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def create(self, about: Mapping[str, Any]) -> None:
        """Begin a new session.

        Raises
        ------
        UsageError
            There is something in the folder already.
        """
        if self.path.exists() and any(self.path.iterdir()):
            raise UsageError(
                f"{self.path} is not empty; go on with a session there by --resume, or choose another --out"
            )
        self.path.mkdir(parents=True, exist_ok=True)
        _write_json(self.path / "session.json", {"format": FORMAT, **about})

    def about(self) -> dict[str, Any]:
        """Return what the session evaluates.

        Raises
        ------
        UsageError
            The folder holds no session.
        """
        try:
            about: dict[str, Any] = json.loads((self.path / "session.json").read_text(encoding="utf-8"))
        except (OSError, json.JSONDecodeError) as error:
            raise UsageError(f"{self.path} holds no session of a robot: {error}") from error
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise UsageError(f"{self.path}/session.json is not of the format {FORMAT}")
        return about

    def begin(self, name: str, about: Mapping[str, Any]) -> Recording:
        """Begin another attempt at an episode or lap."""
        attempt = len(list((self.path / "episodes").glob(f"{name}.*"))) + 1
        return Recording(self.path / "episodes" / f"{name}.{attempt}", {**about, "attempt": attempt})

    def episodes(self) -> pd.DataFrame:
        """Return one row for every attempt at an episode, laps left out."""
        rows = [
            json.loads(file.read_text(encoding="utf-8"))
            for file in sorted(self.path.glob("episodes/*/episode.json"))
        ]
        table = pd.DataFrame([row for row in rows if row.get("kind") == "episode"])
        return table.sort_values(["task", "number", "attempt"], ignore_index=True) if len(table) else table

    def finished(self) -> set[tuple[str, int]]:
        """Return (task, number) of the episodes that came to their end."""
        table = self.episodes()
        done = table[table.outcome.isin(FINISHED)] if len(table) else table
        return {(str(row.task), int(row.number)) for row in rows(done)}

    def save_summary(self, table: pd.DataFrame) -> None:
        """Write the summary."""
        _write_table(self.path / "summary.parquet", table)


def read_summaries(root: Path) -> pd.DataFrame:
    """Return the summaries of all sessions below a folder, one row a session and task, with the session's folder."""
    found = [(path.parent, pd.read_parquet(path)) for path in sorted(root.rglob("summary.parquet"))]
    tables = [
        table.assign(session=str(folder)) for folder, table in found if (folder / "session.json").exists()
    ]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def read_raw(episode: Path) -> pd.DataFrame:
    """Return all samples of an episode's folder, whether it came to its end or not."""
    return _read(episode, "raw")


def read_events(episode: Path) -> pd.DataFrame:
    """Return all events of an episode's folder."""
    return _read(episode, "events")


def read_steps(episode: Path) -> pd.DataFrame:
    """Return the steps of an episode's folder."""
    return pd.read_parquet(episode / "steps.parquet")


def rows(table: pd.DataFrame) -> list[Any]:
    """Return a table's rows, each with its columns as attributes."""
    return list(table.itertuples())


def _read(episode: Path, kind: str) -> pd.DataFrame:
    joined = episode / f"{kind}.parquet"
    return pd.read_parquet(joined) if joined.exists() else _read_parts(episode, kind)


def _read_parts(folder: Path, kind: str) -> pd.DataFrame:
    return pd.concat(
        [pd.read_parquet(part) for part in sorted(folder.glob(f"{kind}-*.parquet"))], ignore_index=True
    )


def _write_table(path: Path, table: pd.DataFrame) -> None:
    partial = path.with_suffix(".partial")
    table.to_parquet(partial, index=False, compression="zstd")
    os.replace(partial, path)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=1), encoding="utf-8")
    os.replace(partial, path)
