"""What settings are worth: the same cells under several presets, side by side."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from bgn.agents.hyperparameters import Hyperparameters
from bgn.analysis.evidence import Evidence
from bgn.analysis.text_table import BLANK, TextTable, plus_minus


def differing_settings(settings: Mapping[str, Hyperparameters]) -> pd.DataFrame:
    """Return the settings in which presets differ on one domain: a row per setting, a column per preset."""
    rows = {name: dataclasses.asdict(values) for name, values in settings.items()}
    frame = pd.DataFrame(rows)
    if frame.empty:
        return frame
    texts = frame.map(_text)
    return texts[texts.nunique(axis=1) > 1]


def by_preset(evidences: Sequence[Evidence], names: Sequence[str], domain: str, quantity: str) -> TextTable:
    """Return a table of one domain: a row per preset and budget, a column per agent, mean ± sd (runs).

    ``names`` are the rows' labels; ``quantity`` is a column of ``runs``.
    """
    titles = evidences[0].agent_titles if evidences else {}
    rows = []
    for name, evidence in zip(names, evidences, strict=True):
        runs = evidence.runs
        runs = runs[runs["domain"] == domain] if len(runs) else runs
        if runs.empty:
            continue
        cells = [_cell(runs, agent, quantity) for agent in titles]
        steps = sorted(
            {int(steps) for steps in evidence.cells.loc[evidence.cells["domain"] == domain, "env_steps"]}
        )
        rows.append([name, f"{steps[0] / 1e6:g} M" if steps else "", *cells])
    known = {row.id: row.title for evidence in evidences for row in evidence.domains}
    return TextTable(known.get(domain, domain), ["Preset, budget", "steps", *titles.values()], rows)


def _cell(runs: pd.DataFrame, agent: str, quantity: str) -> str:
    values = (
        runs.loc[runs["agent"] == agent, quantity].dropna() if quantity in runs else pd.Series(dtype=float)
    )
    if values.empty:
        return BLANK
    return f"{plus_minus(float(values.mean()), float(values.std(ddof=0)))} ({len(values)})"


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
