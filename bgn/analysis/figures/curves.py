"""Learning curves: one panel per domain, one line per agent, the reference rows as levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bgn.analysis.aggregate import WINDOW, Array
from bgn.analysis.cells import DomainRow
from bgn.analysis.figures import style
from bgn.analysis.scores import UPPER, Scores
from bgn.domains.episode_opening import CLEAN

BOTTOM = -10.0
"""Of the picture of RockSample, whose untrained returns of -60 would press the rest together."""
POINTS = 160
"""Of the common grid of environment steps."""
_SHADE = "shaded: ±1 standard deviation over runs"
_NONE = "No learning curves are stored for these domains."


def training_curves(scores: Scores, titles: Mapping[str, str]) -> Figure:
    """Return the classic domains' training (paper, Figure "training performance"), with SARSOP and Random as levels.

    Both levels are those of episodes that open as the agents' do.
    """
    domains = _drawn(scores, "classic")
    if not domains:
        return style.nothing(_NONE)
    figure, panels = style.panels(len(domains), columns=2 if len(domains) == 4 else 3)
    for axes, domain in zip(panels, domains, strict=True):
        _draw(axes, scores, domain, tuple(titles), titles, "return_100")
        _levels(axes, scores, domain)
        _include_random(axes, scores, domain)
        style.plain(
            axes, f"{domain.title}  {_n(scores, domain)}", "environment steps", "return, last 100 episodes"
        )
        style.logarithmic(axes)
    style.legend(figure, panels)
    style.caption(figure, f"Mean discounted return of the last {WINDOW} training episodes; {_SHADE}.")
    return figure


def success_curves(scores: Scores, titles: Mapping[str, str], agents: Sequence[str] | None = None) -> Figure:
    """Return the robot domains' success while training (paper, Figures 4 and 7), with the level of perfection."""
    domains = _drawn(scores, "robot")
    if not domains:
        return style.nothing(_NONE)
    figure, panels = style.panels(len(domains), columns=3)
    for axes, domain in zip(panels, domains, strict=True):
        _draw(axes, scores, domain, agents or tuple(titles), titles, "success_100", within=(0.0, 1.0))
        axes.axhline(1.0, color=style.INK, linestyle=":", linewidth=1, label="perfect")
        axes.set_ylim(-0.02, 1.05)
        style.plain(
            axes, f"{domain.title}  {_n(scores, domain)}", "environment steps", "success, last 100 episodes"
        )
        style.logarithmic(axes)
    style.legend(figure, panels)
    style.caption(figure, f"Success in the last {WINDOW} training episodes; {_SHADE}, clipped to [0, 1].")
    return figure


def belief_losses(scores: Scores, titles: Mapping[str, str]) -> Figure:
    """Return how the grounded agents' belief loss falls beside how their score rises."""
    grounded = [agent for agent in titles if agent.endswith("+bgn")]
    domains = [d for d in scores.domains if any(len(scores.cell_curves((d.id, a))) for a in grounded)]
    if not domains:
        return style.nothing("No learning curves of grounded agents are stored.")
    figure, panels = style.panels(len(domains), columns=4)
    for axes, domain in zip(panels, domains, strict=True):
        _draw(axes, scores, domain, grounded, titles, "belief_cross_entropy", within=(0.0, np.inf))
        style.plain(axes, domain.title, "environment steps", r"$H(b, \hat{b})$, nats")
        style.logarithmic(axes)
        axes.set_ylim(bottom=0)
    style.legend(figure, panels)
    style.caption(
        figure,
        f"Cross-entropy of the reconstructed belief, per update; {_SHADE}. Its floor is the belief's H(b).",
    )
    return figure


def band(
    curves: Sequence[pd.DataFrame], column: str, within: tuple[float, float] | None = None
) -> pd.DataFrame:
    """Return mean, low and high (one standard deviation, ddof 0) over runs, on a common grid of ``env_steps``.

    The grid is even in the logarithm of the steps and spans what all runs have; ``within`` clips low and high.
    """
    known = [curve for curve in curves if column in curve]  # not every algorithm reports everything
    runs = [curve[(curve["episodes"] >= WINDOW) & curve[column].notna()] for curve in known]
    runs = [run for run in runs if len(run)]
    if not runs:
        return pd.DataFrame({"env_steps": [], "mean": [], "low": [], "high": []})
    first = max(float(run["env_steps"].iloc[0]) for run in runs)
    last = max(first, min(float(run["env_steps"].iloc[-1]) for run in runs))
    grid = np.geomspace(first, last, POINTS)
    values = np.stack([np.interp(grid, run["env_steps"], run[column]) for run in runs])  # (runs, points)
    mean, sd = values.mean(axis=0), values.std(axis=0)
    low, high = (np.clip(mean + side * sd, *(within or (-np.inf, np.inf))) for side in (-1, 1))
    return pd.DataFrame({"env_steps": grid, "mean": mean, "low": low, "high": high})


def _drawn(scores: Scores, family: str) -> list[DomainRow]:
    present = set(scores.curves["domain"]) if len(scores.curves) else set()
    return [domain for domain in scores.domains if domain.family == family and domain.id in present]


def _draw(
    axes: Axes,
    scores: Scores,
    domain: DomainRow,
    agents: Sequence[str],
    titles: Mapping[str, str],
    column: str,
    within: tuple[float, float] | None = None,
) -> None:
    for agent in agents:
        line = band(scores.cell_curves((domain.id, agent)), column, within)
        if len(line):
            look = style.line(agent, agents)
            axes.plot(line["env_steps"], line["mean"], label=titles[agent], **look)
            axes.fill_between(
                line["env_steps"],
                line["low"],
                line["high"],
                color=style.colour(agent, agents),
                alpha=0.13,
                linewidth=0,
            )


def _levels(axes: Axes, scores: Scores, domain: DomainRow) -> None:
    best = scores.reference(domain.id, UPPER[domain.family], domain.opening)
    if best is not None:
        label = "SARSOP (opening as the agents)" if domain.opening != CLEAN else "SARSOP"
        axes.axhline(float(best["return"]), color=style.INK, linestyle=":", linewidth=1, label=label)
    east = scores.reference(domain.id, "drive-east", domain.opening)
    if east is not None:
        axes.axhline(
            float(east["return"]), color=style.MUTED, linestyle="-.", linewidth=0.9, label="drive east"
        )


def _include_random(axes: Axes, scores: Scores, domain: DomainRow) -> None:
    random = scores.reference(domain.id, "random", domain.opening)
    if random is None:
        return
    level, (low, high) = float(random["return"]), axes.get_ylim()
    if domain.id.startswith("rocksample") or level < low - (high - low):
        axes.set_ylim(bottom=max(low, BOTTOM))
        above = [steps[0] for line in axes.lines if len(steps := _steps_above(line, BOTTOM)) > 1]
        if above:
            axes.set_xlim(left=0.9 * min(above))
        axes.text(
            0.98,
            0.03,
            f"Random: {level:.0f}",
            transform=axes.transAxes,
            ha="right",
            fontsize=7,
            color=style.MUTED,
        )
    else:
        axes.axhline(level, color=style.MUTED, linestyle=(0, (1, 3)), linewidth=1, label="Random")


def _steps_above(line: Line2D, level: float) -> Array:
    steps, values = (np.asarray(data, dtype=float) for data in line.get_data())
    found: Array = steps[values > level] if len(steps) > 2 else steps[:0]
    return found


def _n(scores: Scores, domain: DomainRow) -> str:
    """Return how many runs each agent has, as ``n = 3`` or ``n = 3 to 10``."""
    counts = [n for agent in set(scores.runs["agent"]) if (n := len(scores.cell_runs((domain.id, agent))))]
    if not counts:
        return ""
    return f"n = {min(counts)}" if min(counts) == max(counts) else f"n = {min(counts)} to {max(counts)}"
