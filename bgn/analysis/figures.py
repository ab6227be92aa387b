"""Learning curves as the paper draws them: one panel per domain, one line per agent."""

from __future__ import annotations

import io
import math

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from bgn.analysis.cells import DomainRow
from bgn.analysis.evidence import Evidence
from bgn.results.schema import CLEAN

_COLUMNS = 4
_PANEL_INCHES = (3.6, 2.7)
_WINDOW = 100  # episodes behind each mean
_POINTS = 200  # of the common grid of environment steps

#: One colour per agent, told apart by most eyes (Okabe and Ito).
_COLOURS = {
    "ah-ch": "#0072B2",
    "ah-ch+bgn": "#D55E00",
    "ah-cs": "#009E73",
    "ab-cb": "#CC79A7",
    "ah-cb": "#E69F00",
    "ab-cb+bgn": "#56B4E9",
}


def learning_curves(evidence: Evidence, curves: pd.DataFrame) -> bytes:
    """Return a PNG: means of the last 100 training episodes over env steps, ±1 standard deviation shaded."""
    domains = [domain for domain in evidence.domains if (curves["domain"] == domain.id).any()]
    columns = min(_COLUMNS, len(domains))
    rows = math.ceil(len(domains) / columns)
    figure = Figure(figsize=(columns * _PANEL_INCHES[0], rows * _PANEL_INCHES[1] + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for domain, axes in zip(domains, panels, strict=False):
        _draw(axes, domain, evidence, curves[curves["domain"] == domain.id])
    for axes in panels[len(domains) :]:
        axes.set_axis_off()
    legend: dict[str, Artist] = {}
    for axes in panels:
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True):
            legend[label] = line
    figure.legend(
        list(legend.values()),
        list(legend),
        loc="outside lower center",
        ncols=2 * columns,
        frameon=False,
        fontsize=8,
    )
    FigureCanvasAgg(figure)
    image = io.BytesIO()
    figure.savefig(image, dpi=110, metadata={"Software": None})
    return image.getvalue()


def band(curves: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return mean and standard deviation over runs (ddof 0) on a common grid of ``env_steps``."""
    runs = [run.dropna(subset=[column]) for _, run in curves.groupby("run")]
    runs = [run for run in runs if len(run)]
    if not runs:
        return pd.DataFrame({"env_steps": [], "mean": [], "sd": []})
    first = max(run["env_steps"].iloc[0] for run in runs)
    grid = np.linspace(first, max(run["env_steps"].iloc[-1] for run in runs), _POINTS)
    values = np.stack([np.interp(grid, run["env_steps"], run[column]) for run in runs])  # (runs, points)
    return pd.DataFrame({"env_steps": grid, "mean": values.mean(axis=0), "sd": values.std(axis=0)})


def _draw(axes: Axes, domain: DomainRow, evidence: Evidence, curves: pd.DataFrame) -> None:
    # Before that, the mean is over the few episodes that happened to end soonest.
    curves = curves[curves["episodes"] >= _WINDOW]
    quantity = "return" if domain.family == "classic" else "success"
    for agent, title in evidence.agent_titles.items():
        line = band(curves[curves["agent"] == agent], f"{quantity}_100")
        if len(line):
            steps, mean, sd = line["env_steps"], line["mean"], line["sd"]
            colour = _COLOURS.get(agent)
            axes.plot(steps, mean, color=colour, label=title, linewidth=1.4)
            axes.fill_between(steps, mean - sd, mean + sd, color=colour, alpha=0.15, linewidth=0)
    best = evidence.reference(domain.id, "sarsop" if domain.family == "classic" else "perfect", CLEAN)
    if best is not None:
        axes.axhline(
            float(best["return"]), color="black", linestyle="--", linewidth=1, label="SARSOP / perfect"
        )
    axes.set_title(domain.title, fontsize=10)
    axes.set_xlabel("environment steps", fontsize=8)
    axes.set_ylabel(f"{quantity}, last 100 episodes", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.spines[["top", "right"]].set_visible(False)
