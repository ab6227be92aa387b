"""Evaluations on the robot, read back from their recordings for a table."""

from __future__ import annotations

import json
import pathlib

import pandas as pd

from bgn.analysis.statistics import binomial_interval
from bgn.analysis.text_table import TextTable

COLUMNS = ("session", "task", "outcome")


def episodes(folder: pathlib.Path) -> pd.DataFrame:
    """Return one row per recorded episode of every session under a folder: session, task, outcome.

    A session is a folder with ``session.json`` and ``episodes/NAME/episode.json``.
    """
    rows = []
    for session in sorted(folder.glob("**/session.json")):
        for path in sorted(session.parent.glob("episodes/*/episode.json")):
            about = json.loads(path.read_text(encoding="utf-8"))
            task = about.get("task") or path.parent.name.rpartition("-")[0]
            rows.append([session.parent.name, task, about.get("outcome", "")])
    return pd.DataFrame(rows, columns=list(COLUMNS))


def success_table(
    found: pd.DataFrame, finished: tuple[str, ...] = ("success", "failure", "out-of-time")
) -> TextTable:
    """Return successes of finished episodes by session and task, with Clopper-Pearson's interval."""
    rows = []
    for (session, task), group in found[found["outcome"].isin(finished)].groupby(["session", "task"]):
        successes, n = int((group["outcome"] == "success").sum()), len(group)
        low, high = binomial_interval(successes, n)
        rows.append([str(session), str(task), f"{successes} of {n}", f"{low:.2f} to {high:.2f}"])
    notes = ["Interrupted episodes are not counted. 95 %: Clopper-Pearson."]
    return TextTable("Episodes on the robot", ["Session", "Task", "Success", "95 %"], rows, notes)
