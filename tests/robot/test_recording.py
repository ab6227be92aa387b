"""Recordings: flushed as they go, joined at the end, marked when incomplete, and read back."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pandas as pd
import pytest

from bgn import domains
from bgn.domains import two_bumps_1d
from bgn.robot.errors import UsageError
from bgn.robot.film import beliefs
from bgn.robot.recording import (
    RAW_COLUMNS,
    Recording,
    SessionFolder,
    read_events,
    read_raw,
    read_steps,
    read_summaries,
)
from bgn.robot.statistics import clopper_pearson
from bgn.robot.worker import COLUMNS

ABOUT = {"kind": "episode", "task": "two-bumps-1d", "number": 0, "x": 1, "y": 2, "attempt": 1}


PUBLISHED = Path(__file__).parents[2] / "results" / "published" / "robot"


@pytest.mark.parametrize(
    "session", sorted(PUBLISHED.glob("*/session.json")), ids=lambda path: path.parent.name
)
def test_published_sessions_name_policies_that_are_there(session: Path) -> None:
    policies = json.loads(session.read_text())["policies"]
    assert policies
    for task, policy in policies.items():
        content = (PUBLISHED.parents[2] / policy["path"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == policy["sha256"], task


def row(number: int) -> tuple[float, ...]:
    return tuple(float(number) for _ in COLUMNS)


def test_an_episode_from_beginning_to_end(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "episode", ABOUT)
    recording.samples([row(1), row(2)])
    recording.angles((0.1, 0.2))
    recording.samples([row(3)])
    recording.event("move", "somewhere")
    recording.step(step=0, angle=0.0)
    recording.step(step=1, angle=0.1)
    recording.finish("success", steps=1)
    raw = read_raw(tmp_path / "episode")
    assert tuple(raw.columns) == RAW_COLUMNS
    assert raw.x.tolist() == [1, 2, 3]
    assert raw.angle_1.isna().tolist() == [True, True, False]
    assert read_steps(tmp_path / "episode").step.tolist() == [0, 1]
    assert read_events(tmp_path / "episode").kind.tolist() == ["move", "outcome"]
    assert json.loads((tmp_path / "episode" / "episode.json").read_text())["outcome"] == "success"
    assert not list(tmp_path.glob("episode/*.partial"))


def test_what_was_flushed_survives_a_crash(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "episode", ABOUT)
    for part in range(3):
        recording.samples([row(part)])
        recording.event("part", str(part))
        recording.flush()
    recording.step(step=0)
    # The process dies here: no finish.
    assert read_raw(tmp_path / "episode").x.tolist() == [0, 1, 2]
    assert read_events(tmp_path / "episode").text.tolist() == ["0", "1", "2"]
    assert len(read_steps(tmp_path / "episode")) == 1
    assert json.loads((tmp_path / "episode" / "episode.json").read_text())["outcome"] == "incomplete"


def test_a_session_counts_attempts_and_forgets_none(tmp_path: Path) -> None:
    folder = SessionFolder(tmp_path / "session")
    folder.create({"plan": []})
    about = {"kind": "episode", "task": "top-plate", "x": 0, "y": 0}
    folder.begin("top-plate-000", {**about, "number": 0}).finish("lost", "gone")
    folder.begin("top-plate-000", {**about, "number": 0}).finish("success", steps=3)
    folder.begin("top-plate-001", {**about, "number": 1})
    folder.begin("top-plate-lap", {"kind": "lap", "task": "top-plate"}).finish("done")
    table = folder.episodes()
    assert table.outcome.tolist() == ["lost", "success", "incomplete"]
    assert table.attempt.tolist() == [1, 2, 1]
    assert folder.finished() == {("top-plate", 0)}


def test_summaries_are_found_below_a_folder(tmp_path: Path) -> None:
    assert read_summaries(tmp_path).empty
    for name in ("a", "b"):
        folder = SessionFolder(tmp_path / "robot" / name)
        folder.create({})
        folder.save_summary(pd.DataFrame([{"domain": "top-plate", "evidence": "twin"}]))
    table = read_summaries(tmp_path)
    assert table.session.tolist() == [str(tmp_path / "robot" / name) for name in ("a", "b")]


def test_a_session_never_overwrites(tmp_path: Path) -> None:
    folder = SessionFolder(tmp_path)
    folder.create({})
    with pytest.raises(UsageError, match="--resume"):
        folder.create({})
    (tmp_path / "session.json").write_text("{}")
    with pytest.raises(UsageError, match="not of the format"):
        folder.about()


def test_beliefs_are_computed_from_the_recording_alone() -> None:
    """By hand: one soft move right from cell 3 onto a bump leaves the pairs with the left bump at 4, and none at 3."""
    domain = domains.get("two-bumps-1d")
    bins, neutral = two_bumps_1d.BINS, two_bumps_1d.NEUTRAL
    start, onto = 3 * bins + neutral, 4 * bins + neutral - 1  # the tip is bent against the motion
    steps = pd.DataFrame(
        [
            (0, -1, start, start),
            (1, two_bumps_1d.RIGHT_SOFT, onto, onto),
            (2, two_bumps_1d.RIGHT_STIFF, onto, onto),
        ],
        columns=["step", "action", "observation", "observed"],
    )
    first, second, last = beliefs(domain, steps)
    possible = {two_bumps_1d.PAIRS[y] for y in first.nonzero()[0]}
    assert possible == {pair for pair in two_bumps_1d.PAIRS if 3 not in pair}
    possible = {two_bumps_1d.PAIRS[y] for y in second.nonzero()[0]}
    assert possible == {pair for pair in two_bumps_1d.PAIRS if 4 in pair and 3 not in pair}
    assert (last == second).all()


def test_clopper_pearson_by_hand() -> None:
    # All of ten: the lower bound is 0.025^(1/10).
    low, high = clopper_pearson(10, 10)
    assert low == pytest.approx(0.025**0.1)
    assert high == 1
    assert clopper_pearson(0, 0) == (0.0, 1.0)
