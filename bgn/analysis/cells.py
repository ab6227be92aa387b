"""One row per cell: what our runs show, what the paper offers for it, and the verdict."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import pandas as pd

from bgn.analysis import paper, verdicts
from bgn.analysis.statistics import Sample, prediction_interval
from bgn.analysis.verdicts import Judgement, Verdict
from bgn.domains.episode_opening import CLEAN, EpisodeOpening

GROUNDED = "ah-ch+bgn"
"""The agent that the paper's claims about robot domains compare with."""


@dataclass(frozen=True)
class DomainRow:
    """A domain as the tables show it."""

    id: str
    title: str
    family: Literal["classic", "robot"]
    metric: str
    """The column of ``runs`` that is judged: what the paper reports."""
    tolerance: float
    """What difference from the paper is negligible, in the metric's unit."""
    opening: EpisodeOpening = CLEAN
    """How the episodes of agents open."""


@dataclass(frozen=True, kw_only=True)
class CellRow:
    """What is known of a cell: a row of :func:`summarise`."""

    domain: str
    agent: str
    metric: str
    """The column of ``runs`` that is judged."""
    runs: int
    """How many are finished."""
    mean: float
    sd: float
    """Over runs, ddof 0 as in the paper."""
    older_runs: int
    """How many are of other code, settings or domain tables than the present ones."""
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
    """Of the tests that the verdict rests on; NaN where one does not apply."""
    verdict: str
    """A value of :class:`bgn.analysis.verdicts.Verdict`."""


def summarise(runs: pd.DataFrame, domains: Sequence[DomainRow], agents: Iterable[str]) -> pd.DataFrame:
    """Return a row for each cell that has finished runs, in the order of ``domains`` and ``agents``.

    ``runs`` holds finished runs only, with a flag ``older`` for those of other code, settings or tables. The columns
    are the fields of :class:`CellRow`.
    """
    groups = dict(iter(runs.groupby(["domain", "agent"]))) if len(runs) else {}
    order = itertools.product(domains, agents)
    samples = {
        (domain.id, agent): Sample.of(groups[domain.id, agent][domain.metric].tolist())
        for domain, agent in order
        if (domain.id, agent) in groups
    }
    judgements = _judge(samples, groups, domains)
    by_id = {domain.id: domain for domain in domains}
    rows = [
        _cell(by_id[cell[0]], cell[1], sample, int(groups[cell]["older"].sum()), judgements.get(cell))
        for cell, sample in samples.items()
    ]
    return pd.DataFrame(rows, columns=[field.name for field in fields(CellRow)])


def _judge(
    samples: dict[tuple[str, str], Sample],
    groups: dict[Any, pd.DataFrame],
    domains: Sequence[DomainRow],
) -> dict[tuple[str, str], Judgement]:
    tolerances = {domain.id: domain.tolerance for domain in domains}
    judgements = verdicts.judge_numbers(samples, tolerances)
    grounded = {domain: sample for (domain, agent), sample in samples.items() if agent == GROUNDED}
    judgements |= verdicts.judge_below(samples, grounded, tolerances)
    for cell, claim in paper.CLAIMS.items():
        if claim.kind == "perfect" and cell in samples:
            successes, episodes = _pooled_successes(groups[cell])
            judgements[cell] = verdicts.judge_perfection(successes, episodes, tolerance=tolerances[cell[0]])
    return judgements


def _pooled_successes(runs: pd.DataFrame) -> tuple[int, int]:
    """Return successes and episodes of the fixed evaluations with sampled actions."""
    episodes = [int(json.loads(spec)["evaluation_episodes"]) for spec in runs["spec"]]
    successes = [round(rate * n) for rate, n in zip(runs["sampled_success"], episodes, strict=True)]
    return sum(successes), sum(episodes)


def _cell(domain: DomainRow, agent: str, sample: Sample, older: int, judgement: Judgement | None) -> CellRow:
    kind = paper.reference_kind(domain.id, agent)
    if judgement is None:
        judgement = Judgement(Verdict.NO_REFERENCE if kind == "none" else Verdict.TOO_FEW_RUNS)
    printed = paper.RETURNS.get((domain.id, agent))
    claim = paper.CLAIMS.get((domain.id, agent))
    predicted = (math.nan, math.nan)
    if printed:
        predicted = prediction_interval(Sample(printed.mean, printed.sd, paper.SEEDS), n=sample.n)
    return CellRow(
        domain=domain.id,
        agent=agent,
        metric=domain.metric,
        runs=sample.n,
        mean=sample.mean,
        sd=sample.sd,
        older_runs=older,
        reference_kind=kind,
        paper_mean=printed.mean if printed else math.nan,
        paper_sd=printed.sd if printed else math.nan,
        paper_claim=claim.text if claim else None,
        predicted_low=predicted[0],
        predicted_high=predicted[1],
        tolerance=domain.tolerance,
        p_difference=judgement.p_difference,
        p_equivalence=judgement.p_equivalence,
        verdict=judgement.verdict.value,
    )
