from __future__ import annotations

import json
import pathlib

from bgn.analysis import recordings


def record(folder: pathlib.Path, name: str, **about: str) -> None:
    path = folder / "episodes" / name
    path.mkdir(parents=True)
    (path / "episode.json").write_text(json.dumps(about), encoding="utf-8")


def test_finished_episodes_are_counted_by_task(tmp_path: pathlib.Path) -> None:
    session = tmp_path / "monday"
    session.mkdir()
    (session / "session.json").write_text('{"evidence": "twin"}', encoding="utf-8")
    for number in range(9):
        record(session, f"top-plate-{number:03d}.1", kind="episode", task="top-plate", outcome="success")
    record(session, "top-plate-009.1", kind="episode", task="top-plate", outcome="stopped")
    record(session, "top-plate-009.2", kind="episode", task="top-plate", outcome="failure")
    record(session, "lap-000.1", kind="lap", task="top-plate", outcome="success")
    found = recordings.episodes(tmp_path)
    assert len(found) == 11
    # Clopper-Pearson's interval of 9 in 10.
    assert list(recordings.success_table(found).rows) == [
        ["monday", "twin", "top-plate", "9 of 10", "0.55 to 1.00"]
    ]


def test_nothing_recorded(tmp_path: pathlib.Path) -> None:
    assert recordings.episodes(tmp_path).empty
    assert list(recordings.success_table(recordings.episodes(tmp_path)).rows) == []
