"""One row per cell: what our runs show, what the paper offers for it, and the verdict."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Literal

import pandas as pd

from bgn.analysis import paper, verdicts
from bgn.analysis.statistics import Sample, prediction_interval, rate_error, rate_interval
from bgn.analysis.verdicts import Cell, Judgement, Verdict
from bgn.domains.episode_opening import CLEAN, EpisodeOpening

GROUNDED = "ah-ch+bgn"
"""The agent that the paper's claims about robot domains compare with."""
TRAINING_WINDOW = 100
"""Episodes behind ``train_return`` and ``train_success``."""


@dataclass(frozen=True)
class DomainRow:
    """A domain as the tables show it."""

    id: str
    title: str
    family: Literal["classic", "robot"]
    metric: str
    """The column of ``runs`` that is judged."""
    tolerance: float
    """What difference from the paper is negligible, in the metric's unit."""
    opening: EpisodeOpening = CLEAN
    """How the episodes of agents open."""
    authors_metric: str | None = None
    """The column that measures as the authors did, where that is another one and was measured."""
    horizon: int = 0
    """Environment steps of the paper's runs; shorter ones get no verdict."""


@dataclass(frozen=True, kw_only=True)
class CellRow:
    """What is known of a cell: a row of :func:`summarise`."""

    domain: str
    agent: str
    metric: str
    """The column of ``runs`` that is judged."""
    runs: int
    """How many are finished."""
    env_steps: int
    """Their horizon (of the shortest)."""
    horizon: int
    """The paper's: shorter runs get no verdict."""
    mean: float
    sd: float
    """Over runs, ddof 0 as in the paper."""
    older_runs: int
    """How many are of other code, settings or domain tables than the present ones."""
    success_low: float
    success_high: float
    """95 % interval of a seed's success rate in the sampled evaluation."""
    reference_kind: str
    """What the paper offers: ``numeric``, ``claim`` or ``none``."""
    paper_mean: float
    paper_sd: float
    paper_claim: str | None
    predicted_low: float
    predicted_high: float
    """Between them the mean of as many runs would lie in 19 of 20 repetitions of the paper's experiment."""
    tolerance: float
    p_difference: float
    p_equivalence: float
    """Of the tests that the verdict rests on, Holm-corrected; NaN where one does not apply."""
    detectable: float
    power: float
    attainable: bool
    """See :class:`bgn.analysis.verdicts.Judgement`."""
    verdict: str
    """A value of :class:`bgn.analysis.verdicts.Verdict`."""
    authors_metric: str | None
    """The column that measures as the authors did, where it was measured; the rest is judged by it."""
    authors_runs: int
    authors_mean: float
    authors_sd: float
    authors_verdict: str | None


def summarise(runs: pd.DataFrame, domains: Sequence[DomainRow], agents: Iterable[str]) -> pd.DataFrame:
    """Return a row for each cell that has finished runs, in the order of ``domains`` and ``agents``.

    ``runs`` holds finished runs only, with a flag ``older`` for those of other code, settings or tables. The columns
    are the fields of :class:`CellRow`.
    """
    groups = _groups(runs, [domain.id for domain in domains], tuple(agents))
    by_id = {domain.id: domain for domain in domains}
    judged = {cell: by_id[cell[0]].metric for cell in groups}
    authors = {cell: by_id[cell[0]].authors_metric for cell in groups}
    first = judge(groups, by_id, judged)
    second = judge(groups, by_id, {cell: name for cell, name in authors.items() if name is not None})
    rows = [_row(by_id[cell[0]], cell, groups[cell], found, second) for cell, found in first.items()]
    return pd.DataFrame([asdict(row) for row in rows], columns=[field.name for field in fields(CellRow)])


def judge(
    groups: Mapping[Cell, pd.DataFrame], domains: Mapping[str, DomainRow], metrics: Mapping[Cell, str]
) -> dict[Cell, tuple[Sample, Judgement]]:
    """Judge the cells that have runs with their metric; every family of tests spans all of them."""
    tolerances = {domain.id: domain.tolerance for domain in domains.values()}
    samples: dict[Cell, Sample] = {}
    for cell, metric in metrics.items():
        if metric in groups[cell] and groups[cell][metric].notna().any():
            samples[cell] = sample(groups[cell], metric)
    long = {cell: s for cell, s in samples.items() if not is_short(groups[cell], domains[cell[0]])}
    grounded = {domain: s for (domain, agent), s in long.items() if agent == GROUNDED}
    judgements = verdicts.judge_numbers(long, tolerances) | verdicts.judge_below(long, grounded, tolerances)
    for cell in long:
        claim = paper.CELL_CLAIMS.get(cell)
        if claim is not None and claim.kind == "perfect":
            rates = groups[cell]["sampled_success"].tolist()
            episodes = evaluation_episodes(groups[cell])
            judgements[cell] = verdicts.judge_perfection(rates, episodes, tolerance=tolerances[cell[0]])
    return {
        cell: (s, judgements.get(cell) or _unjudged(cell, short=cell not in long))
        for cell, s in samples.items()
    }


def sample(runs: pd.DataFrame, metric: str) -> Sample:
    """Summarise a metric over a cell's runs, with the error of measuring each of them."""
    chosen = runs[runs[metric].notna()]
    return Sample.of(chosen[metric].tolist(), measurement_errors(chosen, metric))


def measurement_errors(runs: pd.DataFrame, metric: str) -> list[float]:
    """Return the standard error with which each run's metric was measured (none where it is not known)."""
    prefix, _, quantity = metric.rpartition("_")
    if quantity == "success":
        counts = [TRAINING_WINDOW] * len(runs) if prefix == "train" else evaluation_episodes(runs)
        return [rate_error(rate, n) for rate, n in zip(runs[metric], counts, strict=True)]
    if f"{metric}_se" in runs:
        return [float(error) for error in runs[f"{metric}_se"].fillna(0.0)]
    if metric == "train_return":
        return (runs["sampled_return_sd"] / math.sqrt(TRAINING_WINDOW)).tolist()
    return []


def evaluation_episodes(runs: pd.DataFrame) -> list[int]:
    """Return the episodes of each run's fixed evaluation."""
    return [int(json.loads(spec)["evaluation_episodes"]) for spec in runs["spec"]]


def env_steps(runs: pd.DataFrame) -> list[int]:
    """Return the horizon of each run in environment steps."""
    return [int(json.loads(spec)["env_steps"]) for spec in runs["spec"]]


def is_short(runs: pd.DataFrame, domain: DomainRow) -> bool:
    """Say whether any of a cell's runs is shorter than the paper's horizon."""
    return min(env_steps(runs)) < domain.horizon


def _groups(runs: pd.DataFrame, domains: Iterable[str], agents: Sequence[str]) -> dict[Cell, pd.DataFrame]:
    if runs.empty:
        return {}
    found = {(str(d), str(a)): group for (d, a), group in runs.groupby(["domain", "agent"])}
    return {(d, a): found[d, a] for d in domains for a in agents if (d, a) in found}


def _unjudged(cell: Cell, *, short: bool) -> Judgement:
    if paper.reference_kind(*cell) == "none":
        return Judgement(Verdict.NO_REFERENCE)
    return Judgement(Verdict.SHORT if short else Verdict.TOO_FEW_RUNS)


def _row(
    domain: DomainRow,
    cell: Cell,
    runs: pd.DataFrame,
    judged: tuple[Sample, Judgement],
    authors: Mapping[Cell, tuple[Sample, Judgement]],
) -> CellRow:
    ours, judgement = judged
    printed, claim = paper.RETURNS.get(cell), paper.CELL_CLAIMS.get(cell)
    predicted = (math.nan, math.nan)
    if printed:
        predicted = prediction_interval(Sample(printed.mean, printed.sd, paper.SEEDS), n=ours.n)
    second = authors.get(cell)
    success = rate_interval(runs["sampled_success"].tolist(), evaluation_episodes(runs))
    return CellRow(
        domain=domain.id,
        agent=cell[1],
        metric=domain.metric,
        runs=ours.n,
        env_steps=min(env_steps(runs)),
        horizon=domain.horizon,
        mean=ours.mean,
        sd=ours.sd,
        older_runs=int(runs["older"].sum()),
        success_low=success[0],
        success_high=success[1],
        reference_kind=paper.reference_kind(*cell),
        paper_mean=printed.mean if printed else math.nan,
        paper_sd=printed.sd if printed else math.nan,
        paper_claim=claim.quote if claim else None,
        predicted_low=predicted[0],
        predicted_high=predicted[1],
        tolerance=domain.tolerance,
        p_difference=judgement.p_difference,
        p_equivalence=judgement.p_equivalence,
        detectable=judgement.detectable,
        power=judgement.power,
        attainable=verdicts.attainable(printed, tolerance=domain.tolerance) if printed else True,
        verdict=judgement.verdict.value,
        authors_metric=domain.authors_metric if second else None,
        authors_runs=second[0].n if second else 0,
        authors_mean=second[0].mean if second else math.nan,
        authors_sd=second[0].sd if second else math.nan,
        authors_verdict=second[1].verdict.value if second else None,
    )
