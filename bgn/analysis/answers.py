"""Each notebook's question answered in one sentence, made from what is stored."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bgn.analysis import criteria
from bgn.analysis.cells import env_steps
from bgn.analysis.claims import ACCURATE_NATS
from bgn.analysis.collapses import LEARNT, collapses
from bgn.analysis.criteria import Answer
from bgn.analysis.evidence import Evidence
from bgn.analysis.scores import Scores
from bgn.analysis.verdicts import Verdict

GROUNDED, PLAIN = "ah-ch+bgn", "ah-ch"


def numbers(evidence: Evidence) -> str:
    """Say how many of Table 6's numbers come out again."""
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
    are = "is" if same == 1 else "are"
    return f"Of the paper's 20 numbers {len(cells)} are stored here and {same} {are} reproduced{tail}."


def claims_verdicts(claims: pd.DataFrame, notebook: str | None = None) -> str:
    """Say how many of a notebook's claims hold."""
    chosen = claims if notebook is None else claims[claims["notebook"] == notebook]
    counts = chosen["verdict"].value_counts()
    parts = [f"{counts[a.value]} {_counted(a, counts[a.value])}" for a in Answer if a.value in counts]
    return f"Of {len(chosen)} claims: {', '.join(parts)}." if parts else "No claim is judged here."


def speed_of_learning(scores: Scores) -> str:
    """Say how often the grounded agent gets to 90 % of the best sooner than the plain one (median runs)."""
    sooner, later, both = 0, 0, 0
    for domain in scores.domains:
        steps = [criteria.learning_steps(scores, (domain.id, agent)) for agent in (GROUNDED, PLAIN)]
        if all(steps):
            ours, theirs = (float(np.sort(s)[len(s) // 2]) for s in steps)
            both += 1
            sooner, later = sooner + (ours < theirs), later + (ours > theirs)
    if not both:
        return "No domain is stored in which Ah-Ch+BGN and Ah-Ch could be compared."
    neither = "" if sooner + later == both else "; in the others neither gets there"
    return (
        f"The median run of Ah-Ch+BGN gets to 90 % of the best return sooner than Ah-Ch's in {sooner} of {both} "
        f"domains, later in {later}{neither}. Whether that is significant is the claim `learns-faster`."
    )


def grounding(scores: Scores) -> str:
    """Say in how many domains beliefs are reconstructed well, and in how many the grounded agent is ahead."""
    divergences, gains = [], []
    for domain in scores.domains:
        runs = scores.cell_runs((domain.id, GROUNDED))
        if len(runs) and "sampled_belief_kl" in runs and runs["sampled_belief_kl"].notna().any():
            divergences.append(float(runs["sampled_belief_kl"].mean()))
            plain = scores.values((domain.id, PLAIN))
            if len(plain):
                gains.append(float(scores.values((domain.id, GROUNDED)).mean() - plain.mean()))
    if not divergences:
        return "No run of a grounded agent is stored."
    close = sum(value < ACCURATE_NATS for value in divergences)
    ahead = (
        f"; its mean score is above Ah-Ch's in {sum(g > 0 for g in gains)} of {len(gains)}. Whether that is "
        "significant is part of the claim `outperforms-baselines`."
        if gains
        else "."
    )
    return (
        f"Ah-Ch+BGN's reconstructed belief is on average off by less than {ACCURATE_NATS} nats in {close} of "
        f"{len(divergences)} domains{ahead}"
    )


def robots(scores: Scores) -> str:
    """Say how many agents are shown to succeed always, up to the tolerance, in each robot domain."""
    parts, ours = [], 0
    domains = [domain for domain in scores.domains if domain.family == "robot"]
    for domain in domains:
        cells = [(domain.id, str(agent)) for agent in dict.fromkeys(scores.runs["agent"])]
        ready = [cell for cell in cells if scores.has(cell)]
        perfect = [c for c in ready if criteria.success_interval(scores, c)[0] >= 1 - domain.tolerance]
        ours += (domain.id, GROUNDED) in perfect
        parts.append(f"{domain.title} {len(perfect)} of {len(ready)}")
    if not parts:
        return "No run of a robot domain is stored."
    return (
        f"Ah-Ch+BGN is shown to succeed in at least {1 - max(d.tolerance for d in domains):.0%} of episodes in "
        f"{ours} of {len(domains)} domains; of all agents stored, {', '.join(parts)} are."
    )


def lost_success(evidence: Evidence, scores: Scores) -> str:
    """Say which agents' runs lose a robot domain that they had learnt in part, and which never do."""
    found = {
        title: [
            collapses(curve).count > 0
            for domain in evidence.family("robot")
            for curve in scores.cell_curves((domain.id, agent))
        ]
        for agent, title in evidence.agent_titles.items()
    }
    falling = [f"{sum(fell)} of {len(fell)} runs of {title}" for title, fell in found.items() if any(fell)]
    steady = [f"{len(fell)} of {title}" for title, fell in found.items() if fell and not any(fell)]
    if not falling:
        runs = f"runs ({', '.join(steady)})" if steady else "run stored"
        return f"No {runs} in which success falls to nothing after a robot domain was learnt in part."
    return (
        f"In the robot domains success falls to nothing after it had been {LEARNT:.0%} or more, once or several times, "
        f"in {', '.join(falling)}" + (f"; never in {', '.join(steady)}." if steady else ".")
    )


def cost(runs: pd.DataFrame) -> str:
    """Say what the stored runs took."""
    if runs.empty:
        return "No run is stored."
    on_cpu = runs["device"] == "cpu"
    said = []
    if on_cpu.any():
        seconds, steps = runs.loc[on_cpu, "cpu_seconds"].sum(), _total_steps(runs[on_cpu])
        said.append(
            f"{on_cpu.sum()} runs shown took {seconds / 3600:.1f} core-hours for {steps / 1e6:,.1f} million "
            f"environment steps: {steps / seconds:,.0f} steps per CPU second."
        )
    if not on_cpu.all():
        steps = _total_steps(runs[~on_cpu])
        said.append(
            f"{(~on_cpu).sum()} runs of {steps / 1e6:,.1f} million steps were trained on a GPU, which cells share: "
            "docs/performance.md has its speed."
        )
    return " ".join(said)


def _counted(answer: Answer, count: int) -> str:
    return answer.value if count == 1 and answer in (Answer.HOLDS, Answer.FAILS) else _COUNTED[answer]


_COUNTED = {
    Answer.HOLDS: "hold",
    Answer.FAILS: "do not hold",
    Answer.INCONCLUSIVE: "inconclusive",
    Answer.SHORT: "short of the paper's horizon",
    Answer.MISSING: "not run",
    Answer.NOT_MEASURED: "not measured",
}


def _total_steps(runs: pd.DataFrame) -> int:
    return sum(env_steps(runs))
