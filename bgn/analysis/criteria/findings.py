"""What every criterion shares: the answers it can give, and how it concludes from its comparisons."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from bgn.analysis.scores import Scores
from bgn.analysis.statistics import Sample, equivalence_p, holm, mean_p
from bgn.analysis.verdicts import SIGNIFICANCE, Cell

Pair = tuple[Cell, Cell]


class Answer(enum.Enum):
    """What the stored runs say to a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    INCONCLUSIVE = "inconclusive"
    SHORT = "short"
    """Runs are shorter than the paper's horizon."""
    MISSING = "not run"
    """Cells, a second seed, or the reference rows to compare with are missing."""
    NOT_MEASURED = "not measured"
    """No stored quantity answers it."""


@dataclass(frozen=True)
class Finding:
    """The answer to a claim and the statistic it rests on."""

    answer: Answer
    statistic: str = ""


class Criterion(Protocol):
    """What is asked of the store."""

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells whose runs decide."""
        ...

    def judge(self, scores: Scores) -> Finding:
        """Ask it."""
        ...


@dataclass(frozen=True)
class NotMeasured:
    """A claim that no run of this project can answer, with the reason."""

    reason: str
    cells: tuple[Cell, ...] = ()

    def judge(self, scores: Scores) -> Finding:
        """Say why not."""
        return Finding(Answer.NOT_MEASURED, self.reason)


def ready_pairs(scores: Scores, pairs: Iterable[Pair]) -> list[Pair]:
    """Return the pairs of which both cells can be judged."""
    return [pair for pair in pairs if all(scores.ready(cell) for cell in pair)]


def pair_samples(scores: Scores, pairs: Iterable[Pair]) -> list[tuple[Sample, Sample]]:
    """Return the judged metric of both cells of each pair."""
    return [(scores.sample(a), scores.sample(b)) for a, b in pairs]


def equivalences(scores: Scores, pairs: Sequence[Pair], tolerance: float | None = None) -> list[float]:
    """Return the p-value of each pair's equivalence, by default within the tolerance of its domain."""
    return [
        equivalence_p(
            scores.sample(a),
            scores.sample(b),
            tolerance=scores.domain(a[0]).tolerance if tolerance is None else tolerance,
        )
        for a, b in pairs
    ]


def counted(significant: int, judged: int, asked: int) -> str:
    """Say how many of the comparisons that can be judged are significant, each by itself, and how many are asked."""
    more = f" ({asked} asked for)" if judged < asked else ""
    return f"{significant} of {judged} comparisons significant{more}"


def lacking(scores: Scores, cells: Iterable[Cell]) -> Answer | None:
    """Return why not all cells can be judged, if so: one that is not run weighs more than a short one."""
    cells = tuple(cells)
    if any(not scores.has(cell) for cell in cells):
        return Answer.MISSING
    return Answer.SHORT if any(scores.is_short(cell) for cell in cells) else None


def conclude(
    scores: Scores,
    cells: Sequence[Cell],
    p_values: Sequence[float],
    refuted: bool,
    comparisons: int,
    text: str,
    absent: Sequence[str] = (),
) -> Finding:
    """Conclude from the comparisons that could be made; ``absent`` are domains without the reference rows asked for."""
    if refuted:
        return Finding(Answer.FAILS, text)
    why_not = Answer.MISSING if absent else lacking(scores, cells)
    if why_not:
        return Finding(why_not, with_absent(text if p_values else "", cells, absent))
    holds = len(p_values) == comparisons and all(p < SIGNIFICANCE for p in p_values)
    return Finding(Answer.HOLDS if holds else Answer.INCONCLUSIVE, text)


@dataclass(frozen=True)
class Bound:
    """One-sided p-values of a cell against a bound."""

    within: float
    """Small where the cell is on the side that is claimed."""
    beyond: float
    """Small where it is on the other."""


def above(sample: Sample, value: float) -> Bound:
    """Compare the mean of a seed with a value that it should be above."""
    return Bound(mean_p(sample, value, tail="greater"), mean_p(sample, value, tail="less"))


def below(sample: Sample, value: float) -> Bound:
    """Compare the mean of a seed with a value that it should be below."""
    return Bound(mean_p(sample, value, tail="less"), mean_p(sample, value, tail="greater"))


#: One-sided tests against a bound are made at the level of a 95 % interval, which tables print beside.
BESIDE = SIGNIFICANCE / 2


def beside(
    scores: Scores,
    cells: Sequence[Cell],
    bounds: Mapping[Cell, Bound],
    asked: str,
    absent: Sequence[str] = (),
) -> Finding:
    """Judge cells that all must lie on one side of a bound; one that lies beyond contradicts (Holm over the cells).

    ``absent`` are domains without the reference rows asked for.
    """
    within = sum(bound.within < BESIDE for bound in bounds.values())
    beyond = holm([bound.beyond for bound in bounds.values()], family=len(cells))
    refuted = sum(p < BESIDE for p in beyond)
    text = f"{within} of {len(cells)} cells {asked}" + (f", {refuted} not" if refuted else "")
    if refuted:
        return Finding(Answer.FAILS, text)
    why_not = Answer.MISSING if absent else lacking(scores, cells)
    if why_not:
        return Finding(why_not, with_absent(text if bounds else "", cells, absent))
    return Finding(Answer.HOLDS if within == len(cells) else Answer.INCONCLUSIVE, text)


def with_absent(text: str, cells: Sequence[Cell], absent: Sequence[str]) -> str:
    """Add to a statistic of which domains no reference rows are stored."""
    if not absent:
        return text
    every = len(absent) == len({domain for domain, _ in cells}) > 1
    return f"{text}{'; ' if text else ''}no reference rows of {'any domain' if every else ', '.join(absent)}"
