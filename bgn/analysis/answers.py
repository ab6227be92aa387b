"""Each notebook's question answered in one sentence, made from what is stored."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bgn.analysis import criteria
from bgn.analysis.cells import env_steps
from bgn.analysis.criteria import Answer
from bgn.analysis.evidence import Evidence
from bgn.analysis.scores import Scores
from bgn.analysis.verdicts import Verdict

GROUNDED, PLAIN = "ah-ch+bgn", "ah-ch"


def numbers(evidence: Evidence) -> str:
    """Say how many of Table 7's numbers come out again."""
    cells = evidence.cells[evidence.cells["reference_kind"] == "numeric"]
    counts = cells["verdict"].value_counts()
    same = int(counts.get(Verdict.REPRODUCED.value, 0) + counts.get(Verdict.NEGLIGIBLE_SHIFT.value, 0))
    rest = {
        Verdict.EXCEEDS: "exceed the paper's",
        Verdict.FALLS_SHORT: "fall short",
        Verdict.INCONCLUSIVE: "are inconclusive",
        Verdict.SHORT: "come from runs shorter than the paper's and are not judged",
        Verdict.TOO_FEW_RUNS: "have too few runs",
    }
    parts = [f"{counts[v.value]} {text}" for v, text in rest.items() if v.value in counts]
    tail = f"; {', '.join(parts)}" if parts else ""
    return f"Of the paper's 20 numbers {len(cells)} are stored here and {same} are reproduced{tail}."


def claims_verdicts(claims: pd.DataFrame, notebook: str | None = None) -> str:
    """Say how many of a notebook's claims hold."""
    chosen = claims if notebook is None else claims[claims["notebook"] == notebook]
    counts = chosen["verdict"].value_counts()
    parts = [f"{counts[a.value]} {_COUNTED[a]}" for a in Answer if a.value in counts]
    return f"Of {len(chosen)} claims: {', '.join(parts)}." if parts else "No claim is judged here."


def speed_of_learning(scores: Scores) -> str:
    """Say how much sooner the grounded agent learns than the plain one."""
    parts = []
    for domain in scores.domains:
        steps = [criteria.learning_steps(scores, (domain.id, agent)) for agent in (GROUNDED, PLAIN)]
        if all(steps):
            ours, theirs = (float(np.sort(s)[len(s) // 2]) for s in steps)
            parts.append(f"{domain.title} {_amount(ours)} against {_amount(theirs)}")
    if not parts:
        return "No two agents are stored whose curves could be compared."
    return "Steps to 90 % of the best return, Ah-Ch+BGN against Ah-Ch (median run): " + "; ".join(parts) + "."


def grounding(scores: Scores) -> str:
    """Say how well beliefs are reconstructed, and what the grounded agent gains by it."""
    parts = []
    for domain in scores.domains:
        runs = scores.cell_runs((domain.id, GROUNDED))
        if len(runs) and "sampled_belief_kl" in runs and runs["sampled_belief_kl"].notna().any():
            gain = ""
            plain = scores.values((domain.id, PLAIN))
            if len(plain):
                gain = f", {scores.values((domain.id, GROUNDED)).mean() - plain.mean():+.2f} over Ah-Ch"
            parts.append(f"{domain.title} {runs['sampled_belief_kl'].mean():.2f} nats{gain}")
    if not parts:
        return "No run of a grounded agent is stored."
    return "Ah-Ch+BGN's reconstructed belief is off by (KL, mean of the runs): " + "; ".join(parts) + "."


def robots(scores: Scores) -> str:
    """Say which agents always succeed in which robot domain."""
    parts = []
    for domain in scores.domains:
        if domain.family != "robot":
            continue
        cells = [(domain.id, agent) for agent in dict.fromkeys(scores.runs["agent"])]
        ready = [cell for cell in cells if scores.has(cell)]
        perfect = [c for c in ready if criteria.success_interval(scores, c)[0] >= 1 - domain.tolerance]
        names = f"{len(perfect)} of {len(ready)} agents"
        ours = (domain.id, GROUNDED) in perfect
        steps = "" if not ready else f" at {_amount(min(map(float, _steps(scores, ready))))} steps"
        parts.append(f"{domain.title} {names}{', Ah-Ch+BGN among them' if ours else ''}{steps}")
    if not parts:
        return "No run of a robot domain is stored."
    return "Shown to succeed always (seed-level interval above .99): " + "; ".join(parts) + "."


def cost(runs: pd.DataFrame) -> str:
    """Say what the stored runs took."""
    if runs.empty:
        return "No run is stored."
    hours, steps = runs["cpu_seconds"].sum() / 3600, _total_steps(runs)
    rate = steps / runs["cpu_seconds"].sum()
    return (
        f"The {len(runs)} runs shown took {hours:.1f} core-hours for {steps / 1e6:,.1f} million environment steps: "
        f"{rate:,.0f} steps per CPU second."
    )


_COUNTED = {
    Answer.HOLDS: "hold",
    Answer.FAILS: "do not hold",
    Answer.INCONCLUSIVE: "inconclusive",
    Answer.SHORT: "short of the paper's horizon",
    Answer.MISSING: "not run",
    Answer.NOT_MEASURED: "not measured",
}


def _amount(steps: float) -> str:
    if np.isinf(steps):
        return "never"
    return f"{steps / 1e6:.2g} M" if steps >= 1e6 else f"{steps / 1e3:.0f} k"


def _steps(scores: Scores, cells: Sequence[tuple[str, str]]) -> list[int]:
    return [min(env_steps(scores.cell_runs(cell))) for cell in cells]


def _total_steps(runs: pd.DataFrame) -> int:
    return sum(env_steps(runs))
