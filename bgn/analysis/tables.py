"""The paper's tables beside ours: raw and normalised returns, success rates, reference policies, metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from bgn.analysis import paper
from bgn.analysis.cells import DomainRow
from bgn.analysis.collapses import LEARNT, LOST, collapses, late_success
from bgn.analysis.criteria import Answer
from bgn.analysis.evidence import Evidence
from bgn.analysis.habits import HABITS, Habit
from bgn.analysis.scores import Scores
from bgn.analysis.text_table import BLANK, TextTable, plus_minus
from bgn.analysis.verdicts import Verdict
from bgn.domains.episode_opening import CLEAN, HIDDEN

_MARKS = {
    Verdict.REPRODUCED: "=",
    Verdict.NEGLIGIBLE_SHIFT: "≈",
    Verdict.EXCEEDS: "↑",
    Verdict.FALLS_SHORT: "↓",
    Verdict.INCONCLUSIVE: "?",
    Verdict.SHORT: "s",
    Verdict.TOO_FEW_RUNS: "…",
    Verdict.NO_REFERENCE: "",
}
_METRICS = {
    "greedy_return": "greedy evaluation of the final policy",
    "train_return": "mean of the last 100 training episodes",
    "train_success": "success in the last 100 training episodes",
    "sampled_return": "evaluation of the final policy with sampled actions",
    "sampled_success": "success of the final policy with sampled actions",
    "first_100_return": "the first 100 greedy episodes to finish in 16 lanes",
}
_LEGEND = "Verdicts: " + "; ".join(f"{mark} {verdict.value}" for verdict, mark in _MARKS.items() if mark)
_COLLAPSES = ("collapses", "end lost", "nats, lost", "steps, lost", "last fifth")
_CI = 1.96  # half-width of a 95 % interval in standard errors


def claim_lines(claims: pd.DataFrame, remarks: Sequence[str] = ()) -> TextTable:
    """Return one line per claim of the paper: where it stands, what of it is judged, the verdict.

    ``remarks`` says of which results.
    """
    rows = []
    for _, claim in claims.iterrows():
        section = str(claim["section"])
        where = section if len(section) > 3 else f"§ {section}"
        rows.append([where, str(claim["asks"]), str(claim["verdict"])])
    counts = claims["verdict"].value_counts()
    total = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    notes = [f"{len(claims)} claims: {total}. What the verdicts rest on: --all; word for word: CLAIMS.md."]
    if (claims["verdict"] == Answer.SHORT.value).any():
        notes.append("short: some of its runs are shorter than the paper's, which show too little to tell.")
    notes += remarks
    return TextTable("What the paper claims", ["Where", "Claim", "Verdict"], rows, notes, labels=3)


def claim_details(claims: pd.DataFrame) -> TextTable:
    """Return the statistic behind each verdict, with runs, horizon and what Table 6 itself says."""
    rows = []
    for _, claim in claims.iterrows():
        words = [
            str(claim[name]) for name in ("claim", "verdict", "statistic", "runs", "env_steps", "by_table_6")
        ]
        rows.append([*words[:4], _short_steps(words[4]), words[5]])
    columns = ["Claim", "Verdict", "Statistic", "Runs", "Steps", "By Table 6"]
    notes = [
        "Runs and steps: per cell, the fewest and the most. By Table 6: the same question put to the paper's own "
        "numbers, where it prints any.",
    ]
    return TextTable("Claims: what the verdicts rest on", columns, rows, notes, labels=6)


def raw_returns(evidence: Evidence) -> TextTable:
    """Return Table 6 of the paper, turned: ours above the paper's in the same block, with verdict, n and power."""
    domains = evidence.family("classic")
    rows = []
    for agent, title in evidence.agent_titles.items():
        cells = [evidence.cell(domain.id, agent) for domain in domains]
        printed = [paper.RETURNS.get((domain.id, agent)) for domain in domains]
        rows.append([title, "ours", *(_judged(cell) for cell in cells)])
        if any(printed):
            rows.append(["", "paper", *map(_printed, printed)])
        if any(cell is not None and not math.isnan(cell["power"]) for cell in cells):
            rows.append(["", "n, power", *(_n_and_power(cell) for cell in cells)])
        if any(cell is not None and cell["authors_runs"] for cell in cells):
            rows.append(["", "as authors", *(_authors(cell) for cell in cells)])
    for policy, opening, spread, scale in (
        ("sarsop", CLEAN, "return_se", _CI),
        ("random", HIDDEN, "return_sd", 1.0),
    ):
        found = [evidence.reference(domain.id, policy, opening) for domain in domains]
        if any(row is not None for row in found):
            rows.append(
                [
                    evidence.reference_titles[policy],
                    "ours",
                    *(_text(r, "return", spread, scale=scale) for r in found),
                ]
            )
            rows.append(
                ["", "paper", *(_printed(paper.REFERENCE_RETURNS.get((d.id, policy))) for d in domains)]
            )
    titles: dict[str, list[str]] = {}
    for domain in domains:
        titles.setdefault(domain.metric, []).append(domain.title)
    metrics = [f"{', '.join(names)}: {_METRICS[metric]}" for metric, names in titles.items()]
    notes = [
        "Agents: mean ± standard deviation over runs (ddof 0, as in the paper). " + "; ".join(metrics),
        *_authors_note(evidence),
        "SARSOP: clean start, ± 95 % interval of its mean. Random: hidden first action, ± of single episodes.",
        "n, power: runs, and the chance that equal means would be found equivalent (=). " + _LEGEND,
        *(
            ["°: = is out of reach, even for ten seeds of the paper's own spread."]
            if _unattainable(evidence)
            else []
        ),
        *evidence.remarks,
    ]
    return TextTable("Raw returns (paper, Table 6)", ["Agent", "", *(d.title for d in domains)], rows, notes)


def normalised_returns(evidence: Evidence) -> TextTable:
    """Return Table 7 of the paper under its own mixed convention and under one consistent convention."""
    frame = normalised_frame(evidence)
    rows = []
    for domain in evidence.family("classic"):
        title = domain.title
        labels = {"paper's": "", "consistent": ", alike"} if domain.opening == HIDDEN else {"paper's": ""}
        for convention, label in labels.items():
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
        "(return - Random) / (SARSOP - Random), Appendix D; the paper's rows follow from its Table 6.",
        "SARSOP from a clean start, agents and Random after a hidden, uniformly random first "
        "action, as behind the paper's table; alike: all rows after that hidden action, which ends 2/9 "
        "(RockSample[4,4]) and 1/5 ([5,5]) of the episodes before the agent acts, for the best policy too.",
    ]
    if bool(frame["borrowed"].any()):
        notes.append("†: SARSOP or Random is the paper's number, since ours is not stored yet.")
    return TextTable(
        "Normalised returns (paper, Table 7)", ["Domain", "", *evidence.agent_titles.values()], rows, notes
    )


def normalised_frame(evidence: Evidence) -> pd.DataFrame:
    """Return one row per domain, agent, source (ours, paper) and convention (paper's, consistent)."""
    columns = ["domain", "agent", "source", "convention", "mean", "sd", "sarsop", "random", "borrowed"]
    rows: list[list[str | float | bool]] = []
    for domain in evidence.family("classic"):
        for convention, best_opening in (("paper's", CLEAN), ("consistent", domain.opening)):
            ours = _scale(evidence, domain, best_opening)
            # Under its own convention, the paper's row is the paper's alone, as it would have printed it.
            theirs = _printed_scale(domain.id) if convention == "paper's" else ours
            for agent in evidence.agent_titles:
                for source, (mean, sd) in _both(evidence, domain.id, agent).items():
                    best, worst, borrowed = ours if source == "ours" else theirs
                    values: list[float] = [(mean - worst) / (best - worst), sd / (best - worst), best, worst]
                    rows.append([domain.id, agent, source, convention, *values, borrowed])
    return pd.DataFrame(rows, columns=columns)


def success_rates(evidence: Evidence) -> TextTable:
    """Return the success rates of the robot domains (paper, Figures 4 and 7, which print no numbers)."""
    domains = evidence.family("robot")
    rows = []
    for agent, title in evidence.agent_titles.items():
        cells = [evidence.cell(domain.id, agent) for domain in domains]
        rows.append([title, "ours", *(_judged(cell, digits=3) for cell in cells)])
        rows.append(["", "95 %, n", *(_success_interval(cell) for cell in cells)])
        physics = [_over_runs(evidence, domain.id, agent, "physics_success", 3) for domain in domains]
        if any(text != BLANK for text in physics):
            rows.append(["", "in MuJoCo", *physics])
    for policy in ("random", "perfect"):
        found = [evidence.reference(domain.id, policy, CLEAN) for domain in domains]
        if any(row is not None for row in found):
            texts = [_text(row, "success" if policy == "random" else "return", digits=3) for row in found]
            rows.append([evidence.reference_titles[policy], "", *texts])
    notes = [
        "Success of the final policies with sampled actions, mean ± standard deviation over runs; 95 %: of a seed's "
        "rate, the wider of Student's interval over seeds and Clopper-Pearson's over episodes; in MuJoCo: in physics.",
        "Judged: Ah-Ch+BGN succeeds always; every other agent less often (one-sided Welch tests, Holm; ↑ also for one "
        "as good within the tolerance, by TOST). That it *alone* is perfect in *all* tasks is a claim about all cells.",
        _LEGEND,
        *evidence.remarks,
    ]
    return TextTable(
        "Success rates in the robot domains", ["Agent", "", *(d.title for d in domains)], rows, notes
    )


def policies_habits(evidence: Evidence) -> TextTable:
    """Return how often measured policies do what the paper says they do in the robot domains (Section 5.3)."""
    measured = {
        agent: {habit.id: _measured(evidence, habit, agent) for habit in HABITS}
        for agent in evidence.agent_titles
    }
    shown = [agent for agent, found in measured.items() if any(len(runs) for runs in found.values())]
    rows = []
    for domain in evidence.family("robot"):
        habits = [habit for habit in HABITS if habit.domain == domain.id]
        habits = [habit for habit in habits if any(len(measured[agent][habit.id]) for agent in shown)]
        for habit in habits:
            if habit is habits[0]:
                runs = [len(measured[agent][habit.id]) or BLANK for agent in shown]
                rows.append([f"{domain.title}, policies", *map(str, runs)])
            shares = [_shares(measured[agent][habit.id], habit) for agent in shown]
            rows.append([habit.asks, *(mean for mean, _ in shares)])
            if any(span for _, span in shares):
                rows.append(["", *(span for _, span in shares)])
    notes = [
        "Share of the starts in question from which a policy does so, in percent: mean over the policies measured; "
        "below, lowest to highest. Policies take their most probable action, from every possible start: exact shares.",
        "`python -m benchmarks measure` measures the policies that are stored.",
    ]
    titles = [evidence.agent_titles[agent] for agent in shown]
    return TextTable("What policies do in the robot domains", ["Habit", *titles], rows, notes, labels=1)


def success_collapses(evidence: Evidence, scores: Scores) -> TextTable:
    """Return how often runs in the robot domains lose what they had learnt, and how much of it comes back."""
    agents = [a for a in evidence.agent_titles if any(scores.cell_curves((d.id, a)) for d in scores.domains)]
    rows = []
    for domain in evidence.family("robot"):
        entries = [_collapses(scores.cell_curves((domain.id, agent))) for agent in agents]
        shown = [label for label in _COLLAPSES if any(entry[label] != BLANK for entry in entries)]
        for label in shown:
            title = domain.title if label == shown[0] else ""
            rows.append([title, label, *(entry[label] for entry in entries)])
    notes = [
        f"Collapses (recoveries): how often success in the last 100 training episodes falls from {LEARNT:.2f} or more "
        f"to {LOST:.2f} or less, and comes back to {LEARNT:.2f}. Over all runs, at the points that curves have: lower "
        "bounds. Lost: after the one, before the other; the policy's mean entropy there, and the steps to an episode.",
        "Last fifth: success over the last fifth of training, mean ± standard deviation over runs.",
    ]
    titles = [evidence.agent_titles[agent] for agent in agents]
    return TextTable("Collapses in the robot domains", ["Domain", "", *titles], rows, notes)


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
    labels = {"train": "training", "sampled": "sampled", "greedy": "greedy"}
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
        rows += _extra_row(evidence, domain, "KL, nats", "sampled_belief_kl", digits=3)
    notes = [
        "Mean ± standard deviation over runs, of the last 100 training episodes and of the evaluations of the final "
        "policy with sampled and with greedy actions. *: judged. KL: how far the belief that a grounded actor "
        "reconstructs is from the exact one, mean over the steps of the sampled evaluation.",
    ]
    return TextTable("All metrics", ["Domain", "", *evidence.agent_titles.values()], rows, notes)


def _short_steps(text: str) -> str:
    return text.replace(",000,000", " M").replace(",000", " k")


def _judged(cell: pd.Series | None, digits: int = 2) -> str:
    """Return a cell's mean ± sd with the mark of its verdict."""
    if cell is None:
        return BLANK
    older = "‡" if cell["older_runs"] else ""
    mark = _MARKS[Verdict(cell["verdict"])] + ("" if cell["attainable"] else "°")
    return f"{plus_minus(cell['mean'], cell['sd'], digits)}{older} {mark}".rstrip()


def _n_and_power(cell: pd.Series | None) -> str:
    if cell is None:
        return BLANK
    power = "" if math.isnan(cell["power"]) else f", {cell['power']:.2f}"
    return f"{cell['runs']}{power}"


def _success_interval(cell: pd.Series | None) -> str:
    return (
        BLANK if cell is None else f"{cell['success_low']:.3f} to {cell['success_high']:.3f}, {cell['runs']}"
    )


def _authors(cell: pd.Series | None) -> str:
    if cell is None or not cell["authors_runs"]:
        return BLANK
    mark = _MARKS[Verdict(cell["authors_verdict"])]
    return f"{plus_minus(cell['authors_mean'], cell['authors_sd'])} {mark}".rstrip()


def _authors_note(evidence: Evidence) -> list[str]:
    named = [d for d in evidence.family("classic") if d.authors_metric]
    if not named or not (evidence.cells["authors_runs"] > 0).any():
        return []
    titles = ", ".join(domain.title for domain in named)
    return [f"As authors, {titles}: {_METRICS[named[0].authors_metric or '']}, which favours short ones."]


def _unattainable(evidence: Evidence) -> bool:
    return bool((~evidence.cells["attainable"].astype(bool)).any())


def _measured(evidence: Evidence, habit: Habit, agent: str) -> pd.DataFrame:
    """Return an agent's runs in a habit's domain whose policies were measured, and have a case of it."""
    if habit.share_column not in evidence.runs:
        return evidence.runs[:0]
    runs = evidence.runs.dropna(subset=[habit.share_column])
    return runs[(runs["domain"] == habit.domain) & (runs["agent"] == agent)]


def _shares(runs: pd.DataFrame, habit: Habit) -> tuple[str, str]:
    """Return the mean share, and from which to which they go where there are several."""
    if runs.empty:
        return BLANK, ""
    shares = runs[habit.share_column]
    span = f"{_percent(shares.min())}-{_percent(shares.max())}" if len(shares) > 1 else ""
    return _percent(shares.mean()), span


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _collapses(curves: Sequence[pd.DataFrame]) -> Mapping[str, str]:
    """Return a cell's entries by label."""
    if not curves:
        return dict.fromkeys(_COLLAPSES, BLANK)
    found = [collapses(curve) for curve in curves]
    entropy, steps = ([getattr(c, name) for c in found] for name in ("entropy", "episode_steps"))
    late = pd.Series([late_success(curve) for curve in curves])
    entries = (
        f"{sum(c.count for c in found)} ({sum(c.recoveries for c in found)})",
        f"{sum(c.ends_lost for c in found)} of {len(found)}",
        plus_minus(pd.Series(entropy, dtype=float).mean(), None),
        plus_minus(pd.Series(steps, dtype=float).mean(), None, 0),
        plus_minus(float(late.mean()), float(late.std(ddof=0))),
    )
    return dict(zip(_COLLAPSES, entries, strict=True))


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


def _scale(evidence: Evidence, domain: DomainRow, best_opening: str) -> tuple[float, float, bool]:
    """Return SARSOP's and Random's returns, and whether one had to be borrowed from the paper."""
    best = evidence.reference(domain.id, "sarsop", best_opening)
    worst = evidence.reference(domain.id, "random", domain.opening)
    printed_best, printed_worst, _ = _printed_scale(domain.id)
    if best_opening == HIDDEN:
        printed_best = math.nan  # the paper has no SARSOP under this convention
    borrowed = (best is None and not math.isnan(printed_best)) or (
        worst is None and not math.isnan(printed_worst)
    )
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
