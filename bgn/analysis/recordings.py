"""Evaluations on the robot, read back from their recordings for a table."""

from __future__ import annotations

import json
import pathlib

import pandas as pd

from bgn.analysis.statistics import binomial_interval
from bgn.analysis.text_table import TextTable

COLUMNS = ("session", "evidence", "task", "outcome")


def episodes(folder: pathlib.Path) -> pd.DataFrame:
    """Return one row per recorded episode of every session under a folder: session, evidence, task, outcome.

    A session is a folder with ``session.json`` and ``episodes/NAME/episode.json``; what is not an episode (such as a
    first lap) says so by its ``kind`` and is left out. ``evidence`` is ``robot``, or ``twin`` for the simulated arm.
    """
    rows = []
    for session in sorted(folder.glob("**/session.json")):
        evidence = json.loads(session.read_text(encoding="utf-8")).get("evidence", "")
        for path in sorted(session.parent.glob("episodes/*/episode.json")):
            about = json.loads(path.read_text(encoding="utf-8"))
            if about.get("kind", "episode") == "episode":
                rows.append([session.parent.name, evidence, about.get("task", ""), about.get("outcome", "")])
    return pd.DataFrame(rows, columns=list(COLUMNS))


def success_table(
    found: pd.DataFrame, finished: tuple[str, ...] = ("success", "failure", "out-of-time")
) -> TextTable:
    """Return successes of finished episodes by session and task, with Clopper-Pearson's interval."""
    rows = []
    for (session, evidence, task), group in found[found["outcome"].isin(finished)].groupby(
        ["session", "evidence", "task"]
    ):
        successes, n = int((group["outcome"] == "success").sum()), len(group)
        low, high = binomial_interval(successes, n)
        rows.append(
            [str(session), str(evidence), str(task), f"{successes} of {n}", f"{low:.2f} to {high:.2f}"]
        )
    notes = ["Interrupted episodes are not counted. 95 %: Clopper-Pearson."]
    return TextTable("Recorded episodes", ["Session", "Evidence", "Task", "Success", "95 %"], rows, notes)
