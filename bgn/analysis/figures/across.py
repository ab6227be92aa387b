"""Figures across agents and domains: every seed, profiles, beliefs against scores, conventions, cost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bgn.analysis import aggregate, paper
from bgn.analysis.cells import DomainRow
from bgn.analysis.figures import style
from bgn.analysis.scores import UPPER, Scores
from bgn.domains.episode_opening import CLEAN, HIDDEN

FAMILIES = {"classic": "Classic domains", "robot": "Robot domains"}
_NONE = "Nothing is stored to draw this from."


def every_seed(scores: Scores, titles: Mapping[str, str], family: str) -> Figure:
    """Return the judged metric of every seed, with the mean of each agent, the paper's mean ± sd and reference rows."""
    domains = [domain for domain in scores.domains if domain.family == family]
    domains = [domain for domain in domains if any(len(scores.values((domain.id, a))) for a in titles)]
    if not domains:
        return style.nothing(_NONE)
    figure, panels = style.panels(len(domains), columns=2 if len(domains) == 4 else 3, panel=(4.2, 2.4))
    for axes, domain in zip(panels, domains, strict=True):
        for row, agent in enumerate(titles):
            _seeds(axes, scores, domain, agent, row)
        _reference_lines(axes, scores, domain)
        style.plain(axes, domain.title, "return" if family == "classic" else "success rate")
        axes.set_yticks(range(len(titles)), list(titles.values()))
        axes.set_ylim(len(titles) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.grid(axis="x", color=style.RULE, linewidth=0.6)
    style.legend(figure, panels)
    style.caption(
        figure, "A mark per seed, a bar at their mean; grey: the paper's mean ± standard deviation."
    )
    return figure


def performance_profiles(scores: Scores, titles: Mapping[str, str]) -> Figure:
    """Return, for either family of domains, the share of runs above each share of the best."""
    families = [family for family in FAMILIES if any(scores.strata(agent, family) for agent in titles)]
    if not families:
        return style.nothing(_NONE)
    figure, panels = style.panels(len(families), columns=2, panel=(4.6, 3.0))
    for axes, family in zip(panels, families, strict=True):
        levels = np.linspace(0.0, 1.02, 103)
        for agent in titles:
            strata = scores.strata(agent, family)
            if strata:
                profile = aggregate.performance_profile(strata, levels)
                missing = "" if len(strata) == _count(scores, titles, family) else f" ({len(strata)} domains)"
                axes.plot(
                    profile["level"],
                    profile["share"],
                    label=titles[agent] + missing,
                    **style.line(agent, tuple(titles)),
                )
                axes.fill_between(
                    profile["level"],
                    profile["low"],
                    profile["high"],
                    color=style.colour(agent, tuple(titles)),
                    alpha=0.1,
                    linewidth=0,
                )
        axes.set_ylim(-0.02, 1.02)
        style.plain(axes, FAMILIES[family], "share of the best return, τ", "share of runs above τ")
    style.legend(figure, panels)
    style.caption(
        figure,
        "1: SARSOP, its episodes opening as the agents' do, or perfect success; shaded: 95 %, stratified bootstrap.",
    )
    return figure


def aggregates(scores: Scores, titles: Mapping[str, str], family: str) -> pd.DataFrame:
    """Return per agent: domains, runs, IQM, and the probability that Ah-Ch+BGN beats it, with 95 % intervals."""
    rows = []
    grounded = scores.strata("ah-ch+bgn", family)
    for agent, title in titles.items():
        strata = scores.strata(agent, family)
        if not strata:
            continue
        row = {
            "agent": title,
            "domains": len(strata),
            "runs": sum(len(values) for values in strata.values()),
            "IQM [95 %]": str(aggregate.bootstrap_iqm(strata)),
        }
        shared = set(strata) & set(grounded)
        better = (
            aggregate.improvement_probability(grounded, strata) if shared and agent != "ah-ch+bgn" else None
        )
        row["P(Ah-Ch+BGN better) [95 %]"] = "" if better is None else str(better)
        rows.append(row)
    return pd.DataFrame(rows)


def efficiency(scores: Scores, titles: Mapping[str, str]) -> pd.DataFrame:
    """Return per domain and agent the steps to 90 % of the upper reference row: the median run, with its interval."""
    rows = []
    for domain in scores.domains:
        scale = scores.scale(domain.id)
        for agent, title in titles.items():
            curves = scores.cell_curves((domain.id, agent))
            if scale is None or not curves:
                continue
            level = aggregate.LEARNT * scale.upper
            found = aggregate.sample_efficiency(curves, scores.curve_column(domain.id), level)
            rows.append({"domain": domain.title, "agent": title, "steps [95 %]": _steps(found)})
    if not rows:
        return pd.DataFrame()
    order = [domain.title for domain in scores.domains]
    table = pd.DataFrame(rows).pivot_table(
        index="agent", columns="domain", values="steps [95 %]", aggfunc="first"
    )
    return table.reindex(
        index=[t for t in titles.values() if t in table.index], columns=[d for d in order if d in table]
    )


def belief_against_score(scores: Scores, titles: Mapping[str, str]) -> Figure:
    """Return, for every run of a grounded agent, KL(b ‖ b̂) against its normalised score."""
    runs = scores.runs
    domains = []
    if "sampled_belief_kl" in runs:
        known = runs[runs["sampled_belief_kl"].notna()]
        domains = [domain for domain in scores.domains if domain.id in set(known["domain"])]
    if not domains:
        return style.nothing("No run of a grounded agent is stored.")
    figure, panels = style.panels(len(domains), columns=4, panel=(2.9, 2.3))
    for axes, domain in zip(panels, domains, strict=True):
        for agent in titles:
            cell = scores.cell_runs((domain.id, agent))
            if len(cell) and cell["sampled_belief_kl"].notna().any():
                axes.scatter(
                    cell["sampled_belief_kl"].clip(lower=1e-4),
                    cell[domain.metric],
                    label=titles[agent],
                    color=style.colour(agent, tuple(titles)),
                    marker=style.MARKERS.get(agent, "o"),
                    s=32,
                    edgecolor="white",
                    linewidth=0.5,
                )
        axes.set_xscale("log")
        axes.set_xlim(8e-5, 10)
        if domain.family == "robot":
            axes.set_ylim(-0.03, 1.06)
        quantity = "return" if domain.family == "classic" else "success rate"
        style.plain(axes, domain.title, r"KL$(b\,\Vert\,\hat{b})$, nats", quantity)
    style.legend(figure, panels)
    style.caption(
        figure,
        "A mark per run: how far its reconstructed belief is from the exact one, and what it earns.",
    )
    return figure


def openings(scores: Scores, titles: Mapping[str, str], policies: Mapping[str, str]) -> Figure:
    """Return the reference rows of the classic domains from a clean start and after a hidden random action."""
    domains = [
        d
        for d in scores.domains
        if d.family == "classic" and scores.reference(d.id, "sarsop", CLEAN) is not None
    ]
    if not domains:
        return style.nothing("No reference rows of classic domains are stored.")
    figure, panels = style.panels(len(domains), columns=4, panel=(2.9, 2.6))
    for axes, domain in zip(panels, domains, strict=True):
        _opening_lines(axes, scores, domain, titles, policies)
        style.plain(axes, domain.title, "", "return")
        axes.set_xticks([0, 1, 2], ["clean start", "hidden first\naction", "the paper's\nagents"])
        axes.set_xlim(-0.3, 2.4)
    style.legend(figure, panels)
    style.caption(
        figure, "What the same policy is worth under either opening, beside the paper's agents (Table 6)."
    )
    return figure


def cost(scores: Scores, titles: Mapping[str, str]) -> Figure:
    """Return CPU seconds per run and training steps per second, by domain and agent, of runs trained on a CPU."""
    runs = scores.runs
    if len(runs):
        runs = runs[runs["device"] == "cpu"]
    if runs.empty:
        return style.nothing(_NONE)
    domains = [domain for domain in scores.domains if domain.id in set(runs["domain"])]
    figure, (seconds, speed) = style.panels(2, columns=2, panel=(5.2, 0.5 + 0.42 * len(domains)))
    for axes, column in ((seconds, "cpu_seconds"), (speed, "env_steps_per_second")):
        for row, domain in enumerate(domains):
            for agent in titles:
                cell = runs[(runs["domain"] == domain.id) & (runs["agent"] == agent)]
                if len(cell):
                    axes.plot(
                        cell[column].mean(),
                        row,
                        marker=style.MARKERS.get(agent, "o"),
                        color=style.colour(agent, tuple(titles)),
                        linestyle="none",
                        label=titles[agent],
                        markersize=6,
                        markeredgecolor="white",
                    )
        style.logarithmic(axes)
        axes.set_ylim(len(domains) - 0.5, -0.5)
        axes.set_yticks(range(len(domains)), [domain.title for domain in domains])
    style.plain(seconds, "Cost of a run", "CPU seconds (its share of its stack)")
    style.plain(speed, "Speed of a stack", "environment steps per second, all its runs")
    style.legend(figure, [seconds])
    return figure


def _seeds(axes: Axes, scores: Scores, domain: DomainRow, agent: str, row: int) -> None:
    values = scores.values((domain.id, agent))
    printed = paper.RETURNS.get((domain.id, agent))
    if printed:
        axes.barh(row, 2 * printed.sd, left=printed.mean - printed.sd, height=0.72, color="#e3e6eb", zorder=1)
        axes.plot([printed.mean] * 2, [row - 0.36, row + 0.36], color="#8b93a1", linewidth=1.4, zorder=1)
    if len(values):
        spread = np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.zeros(1)
        axes.scatter(
            values,
            row + spread,
            s=18,
            color=style.colour(agent),
            marker=style.MARKERS.get(agent, "o"),
            zorder=3,
        )
        axes.plot(
            [values.mean()] * 2, [row - 0.3, row + 0.3], color=style.colour(agent), linewidth=2, zorder=2
        )


def _reference_lines(axes: Axes, scores: Scores, domain: DomainRow) -> None:
    upper = scores.reference(domain.id, UPPER[domain.family], domain.opening)
    if domain.family == "robot":
        axes.axvline(1.0, color=style.INK, linestyle=":", linewidth=1, label="perfect")
        axes.set_xlim(-0.03, 1.05)
    elif upper is not None:
        axes.axvline(float(upper["return"]), color=style.INK, linestyle=":", linewidth=1, label="SARSOP")
    east = scores.reference(domain.id, "drive-east", domain.opening)
    if east is not None:
        axes.axvline(
            float(east["return"]), color=style.MUTED, linestyle="-.", linewidth=1, label="drive east"
        )


def _opening_lines(
    axes: Axes, scores: Scores, domain: DomainRow, titles: Mapping[str, str], policies: Mapping[str, str]
) -> None:
    for policy in ("sarsop", "qmdp", "drive-east"):
        rows = [scores.reference(domain.id, policy, opening) for opening in (CLEAN, HIDDEN)]
        if all(row is not None for row in rows):
            values = [float(row["return"]) for row in rows if row is not None]
            axes.plot([0, 1], values, color=style.INK, marker="o", markersize=4, linewidth=1.2)
            axes.annotate(
                policies[policy],
                (0, values[0]),
                (2, 4),
                textcoords="offset points",
                fontsize=7,
                color=style.INK,
            )
    for agent in paper.AGENTS:
        printed = paper.RETURNS.get((domain.id, agent))
        if printed:
            look: dict[str, Any] = {
                "marker": style.MARKERS[agent],
                "color": style.COLOURS[agent],
                "linestyle": "none",
            }
            axes.plot(2, printed.mean, markersize=6, label=titles.get(agent, agent), **look)


def _count(scores: Scores, titles: Mapping[str, str], family: str) -> int:
    return max(len(scores.strata(agent, family)) for agent in titles)


def _steps(found: aggregate.Estimate) -> str:
    def short(value: float) -> str:
        return (
            "never" if np.isinf(value) else f"{value / 1e6:.2f} M" if value >= 1e6 else f"{value / 1e3:.0f} k"
        )

    if np.isinf(found.low):
        return "never"
    return f"{short(found.value)} [{short(found.low)}, {short(found.high)}]"
