"""The paper's tables beside ours: raw and normalised returns, success rates, reference policies, metrics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pandas as pd

from bgn.analysis import paper
from bgn.analysis.cells import DomainRow
from bgn.analysis.evidence import Evidence
from bgn.analysis.text_table import BLANK, TextTable, plus_minus
from bgn.analysis.verdicts import Verdict
from bgn.results.schema import CLEAN, HIDDEN

_MARKS = {
    Verdict.REPRODUCED: "=",
    Verdict.NEGLIGIBLE_SHIFT: "≈",
    Verdict.EXCEEDS: "↑",
    Verdict.FALLS_SHORT: "↓",
    Verdict.INCONCLUSIVE: "?",
    Verdict.TOO_FEW_RUNS: "…",
    Verdict.NO_REFERENCE: "",
}
_METRICS = {
    "greedy_return": "greedy evaluation of the final policy",
    "train_return": "mean of the last 100 training episodes",
    "train_success": "success in the last 100 training episodes",
    "sampled_return": "evaluation of the final policy with sampled actions",
    "sampled_success": "success of the final policy with sampled actions",
}
_LEGEND = "Verdicts: " + "; ".join(f"{mark} {verdict.value}" for verdict, mark in _MARKS.items() if mark)
_CI = 1.96  # half-width of a 95 % interval in standard errors


def raw_returns(evidence: Evidence) -> TextTable:
    """Return Table 7 of the paper, ours above the paper's, with verdicts."""
    rows = []
    for domain in evidence.family("classic"):
        sarsop = evidence.reference(domain.id, "sarsop", CLEAN)
        random = evidence.reference(domain.id, "random", domain.opening)
        ours = [
            _text(sarsop, "return", "return_se", scale=_CI),
            _text(random, "return", "return_sd"),
        ]
        theirs = [paper.RETURNS.get((domain.id, agent)) for agent in evidence.agent_titles]
        printed = [paper.REFERENCE_RETURNS.get((domain.id, policy)) for policy in ("sarsop", "random")]
        rows += [
            [domain.title, "ours", *_cells(evidence, domain, _mean_sd), *ours],
            ["", "paper", *(_printed(p) for p in (*theirs, *printed))],
            ["", "verdict", *_cells(evidence, domain, _mark), "", ""],
        ]
    titles: dict[str, list[str]] = {}
    for domain in evidence.family("classic"):
        titles.setdefault(domain.metric, []).append(domain.title)
    metrics = [f"{', '.join(names)}: {_METRICS[metric]}" for metric, names in titles.items()]
    notes = [
        "Agents: mean ± standard deviation over runs (ddof 0, as in the paper). " + "; ".join(metrics),
        "SARSOP and Random as in the paper's table: SARSOP from a clean start (± 95 % interval of its mean), "
        "Random after a hidden first action (± standard deviation of single episodes).",
        _LEGEND,
        *evidence.remarks,
    ]
    columns = ["Domain", "", *evidence.agent_titles.values(), "SARSOP", "Random"]
    return TextTable("Raw returns (paper, Table 7)", columns, rows, notes)


def normalised_returns(evidence: Evidence) -> TextTable:
    """Return Table 8 of the paper under its own mixed convention and under one consistent convention."""
    frame = normalised_frame(evidence)
    rows = []
    for domain in evidence.family("classic"):
        title = domain.title
        for convention, label in (("paper's", ""), ("consistent", ", consistent")):
            for source in ("ours", "paper"):
                chosen = frame[
                    (frame["domain"] == domain.id)
                    & (frame["convention"] == convention)
                    & (frame["source"] == source)
                ].set_index("agent")
                texts = [
                    plus_minus(chosen["mean"].get(agent), chosen["sd"].get(agent))
                    for agent in evidence.agent_titles
                ]
                borrowed = "†" if bool(chosen["borrowed"].any()) else ""
                rows.append([title, f"{source}{label}{borrowed}", *texts])
                title = ""
    notes = [
        "(return - Random) / (SARSOP - Random), Appendix D; the paper's rows follow from its Table 7.",
        "SARSOP from a clean start, agents and Random after a hidden, uniformly random first "
        "action, as behind the paper's table; consistent: all rows after that hidden action, which ends 2/9 "
        "(RockSample[4,4]) and 1/5 ([5,5]) of the episodes before the agent acts, for the best policy too.",
    ]
    if bool(frame["borrowed"].any()):
        notes.append("†: SARSOP or Random is the paper's number, since ours is not stored yet.")
    return TextTable(
        "Normalised returns (paper, Table 8)", ["Domain", "", *evidence.agent_titles.values()], rows, notes
    )


def normalised_frame(evidence: Evidence) -> pd.DataFrame:
    """Return one row per domain, agent, source (ours, paper) and convention (paper's, consistent)."""
    columns = ["domain", "agent", "source", "convention", "mean", "sd", "sarsop", "random", "borrowed"]
    rows: list[list[str | float | bool]] = []
    for domain in evidence.family("classic"):
        for convention, best_start in (("paper's", CLEAN), ("consistent", HIDDEN)):
            ours = _scale(evidence, domain.id, best_start)
            # Under its own convention, the paper's row is the paper's alone, as it would have printed it.
            theirs = _printed_scale(domain.id) if convention == "paper's" else ours
            for agent in evidence.agent_titles:
                for source, (mean, sd) in _both(evidence, domain.id, agent).items():
                    best, worst, borrowed = ours if source == "ours" else theirs
                    values: list[float] = [(mean - worst) / (best - worst), sd / (best - worst), best, worst]
                    rows.append([domain.id, agent, source, convention, *values, borrowed])
    return pd.DataFrame(rows, columns=columns)


def success_rates(evidence: Evidence) -> TextTable:
    """Return the success rates of the robot domains (paper, Figures 4 and 8, which print no numbers)."""
    rows = []
    for domain in evidence.family("robot"):
        random, perfect = (evidence.reference(domain.id, policy, CLEAN) for policy in ("random", "perfect"))
        references = [_text(random, "return", "return_se", scale=_CI), _text(perfect, "return")]
        rows.append([domain.title, "ours", *_cells(evidence, domain, _mean_sd), *references])
        lengths = [_text(row, "length") for row in (random, perfect)]
        rows += _extra_row(evidence, domain, "ours, in MuJoCo", "physics_success", ["", ""])
        rows += _extra_row(evidence, domain, "steps an episode", "sampled_length", lengths)
        rows.append(["", "paper's claim", *_cells(evidence, domain, _mark), "", ""])
    notes = [
        "Success in the last 100 training episodes, mean ± standard deviation over runs; in MuJoCo: episodes "
        "of the final policies in physics; steps: of the final policies with sampled actions. Perfect is the exact "
        "optimum of the discounted return.",
        "The paper's claims: Ah-Ch+BGN succeeds always (Clopper-Pearson interval of the pooled evaluation "
        "episodes); every other agent does so less often (one-sided Welch tests, Holm-corrected; ↑ also for one "
        "that is as good within the tolerance, by TOST).",
        _LEGEND,
        *evidence.remarks,
    ]
    columns = ["Domain", "", *evidence.agent_titles.values(), "Random", "Perfect"]
    return TextTable("Success rates in the robot domains", columns, rows, notes)


def reference_policies(evidence: Evidence) -> TextTable:
    """Return every reference policy under both conventions."""
    rows = []
    for domain in evidence.domains:
        title = domain.title
        for policy, name in evidence.reference_titles.items():
            found = [evidence.reference(domain.id, policy, start) for start in (CLEAN, HIDDEN)]
            if any(row is not None for row in found):
                texts = [_text(row, "return", "return_se", scale=_CI, digits=3) for row in found]
                printed = _printed(paper.REFERENCE_RETURNS.get((domain.id, policy)))
                rows.append([title, name, *texts, printed])
                title = ""
    notes = ["Mean ± 95 % interval of the mean over episodes; returns, in the robot domains success rates."]
    return TextTable(
        "Reference policies", ["Domain", "Policy", "clean start", "hidden first action", "paper"], rows, notes
    )


def all_metrics(evidence: Evidence) -> TextTable:
    """Return each cell by the paper's training metric and by both fixed evaluations of the final policy."""
    labels = {"train": "last 100 training", "sampled": "evaluated, sampled", "greedy": "evaluated, greedy"}
    rows = []
    for domain in evidence.domains:
        quantity = "return" if domain.family == "classic" else "success"
        title = domain.title
        for prefix, label in labels.items():
            column = f"{prefix}_{quantity}"
            mark = " *" if column == domain.metric else ""
            texts = [_over_runs(evidence, domain.id, agent, column) for agent in evidence.agent_titles]
            rows.append([title, label + mark, *texts])
            title = ""
        rows += _extra_row(evidence, domain, "KL of the belief, nats", "sampled_belief_kl", digits=3)
    notes = [
        "Mean ± standard deviation over runs. * is the paper's metric for the domain, used above. KL: how far the "
        "belief that a grounded actor reconstructs is from the exact one, mean over the steps of sampled evaluation.",
    ]
    return TextTable("All metrics", ["Domain", "", *evidence.agent_titles.values()], rows, notes)


def _cells(evidence: Evidence, domain: DomainRow, text: Callable[[pd.Series], str]) -> list[str]:
    found = [evidence.cell(domain.id, agent) for agent in evidence.agent_titles]
    return [text(cell) if cell is not None else BLANK for cell in found]


def _mean_sd(cell: pd.Series) -> str:
    return plus_minus(cell["mean"], cell["sd"]) + ("‡" if cell["older_runs"] else "")


def _mark(cell: pd.Series) -> str:
    return _MARKS[Verdict(cell["verdict"])]


def _printed(printed: paper.Printed | None) -> str:
    return plus_minus(printed.mean, printed.sd) if printed else BLANK


def _text(
    row: pd.Series | None, value: str, spread: str | None = None, *, scale: float = 1.0, digits: int = 2
) -> str:
    if row is None or value not in row:
        return BLANK
    if spread is None:
        return f"{row[value]:.{digits}f}"
    return plus_minus(row[value], scale * row.get(spread, math.nan), digits)


def _extra_row(
    evidence: Evidence,
    domain: DomainRow,
    label: str,
    column: str,
    references: Sequence[str] = (),
    *,
    digits: int = 2,
) -> list[list[str]]:
    """Return one row of a metric that not every run has, or none where no run has it."""
    texts = [_over_runs(evidence, domain.id, agent, column, digits) for agent in evidence.agent_titles]
    return [["", label, *texts, *references]] if any(text != BLANK for text in texts) else []


def _over_runs(evidence: Evidence, domain: str, agent: str, column: str, digits: int = 2) -> str:
    runs = evidence.runs
    if runs.empty or column not in runs:
        return BLANK
    values = runs.loc[(runs["domain"] == domain) & (runs["agent"] == agent), column].dropna()
    return plus_minus(float(values.mean()), float(values.std(ddof=0)), digits) if len(values) else BLANK


def _scale(evidence: Evidence, domain: str, best_start: str) -> tuple[float, float, bool]:
    """Return SARSOP's and Random's returns, and whether one had to be borrowed from the paper."""
    best = evidence.reference(domain, "sarsop", best_start)
    worst = evidence.reference(domain, "random", HIDDEN)
    printed_best, printed_worst, _ = _printed_scale(domain)
    if best is None and best_start == HIDDEN:
        printed_best = math.nan  # the paper has no SARSOP under this convention
    borrowed = worst is None or (best is None and best_start == CLEAN)
    return (
        printed_best if best is None else float(best["return"]),
        printed_worst if worst is None else float(worst["return"]),
        borrowed,
    )


def _printed_scale(domain: str) -> tuple[float, float, bool]:
    """Return the paper's SARSOP and Random (NaN for a domain it does not have)."""
    unknown = paper.Printed(math.nan, math.nan)
    best, worst = (paper.REFERENCE_RETURNS.get((domain, policy), unknown) for policy in ("sarsop", "random"))
    return best.mean, worst.mean, False


def _both(evidence: Evidence, domain: str, agent: str) -> dict[str, tuple[float, float]]:
    """Return (mean, sd) of our runs and of the paper's table, where there are any."""
    found = {}
    cell = evidence.cell(domain, agent)
    if cell is not None:
        found["ours"] = (float(cell["mean"]), float(cell["sd"]))
    if (domain, agent) in paper.RETURNS:
        printed = paper.RETURNS[domain, agent]
        found["paper"] = (printed.mean, printed.sd)
    return found
