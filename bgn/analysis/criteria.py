"""How a sentence of the paper becomes a question that stored runs can answer.

Each criterion names its cells and judges them. All follow one pattern. A claim about several comparisons *holds*
if every one of them is significant by itself (an intersection-union test needs no correction); it *does not hold* if
any is significantly contradicted (Holm-corrected over the comparisons); otherwise it stays *inconclusive*. Comparisons
whose cells or reference rows are missing, or whose runs are shorter than the paper's, can't make a claim hold.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd

from bgn.analysis import aggregate
from bgn.analysis.aggregate import Array
from bgn.analysis.cells import evaluation_episodes, sample
from bgn.analysis.scores import UPPER, Scores
from bgn.analysis.statistics import (
    Sample,
    equivalence_p,
    holm,
    mean_interval,
    rank_sum_p,
    rate_interval,
    spearman_within,
    welch_p,
)
from bgn.analysis.verdicts import SIGNIFICANCE, Cell
from bgn.domains.episode_opening import CLEAN

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


@dataclass(frozen=True)
class Better:
    """Each of some agents scores higher than each of others, in every domain."""

    higher: tuple[str, ...]
    lower: tuple[str, ...]
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Both groups in all domains."""
        return tuple(itertools.product(self.domains, (*self.higher, *self.lower)))

    def judge(self, scores: Scores) -> Finding:
        """Run one-sided Welch tests on all pairs; to be worse, or as good within the tolerance, contradicts."""
        groups = itertools.product(self.domains, self.higher, self.lower)
        pairs = [((domain, a), (domain, b)) for domain, a, b in groups]
        ready = _ready(scores, pairs)
        p_better = [welch_p(*samples, tail="greater") for samples in _samples(scores, ready)]
        worse = [welch_p(*samples, tail="less") for samples in _samples(scores, ready)]
        equal = _equivalences(scores, ready)
        against = np.fmin(holm(worse, family=len(pairs)), holm(equal, family=len(pairs)))
        better = np.array(p_better) < SIGNIFICANCE  # if by little: what is better is not contradicted
        counts = f"{better.sum()} of {len(pairs)} comparisons significant"
        refuted = int(np.sum((against < SIGNIFICANCE) & ~better))
        text = counts + (f", {refuted} contradict" if refuted else "")
        return _conclude(scores, self.cells, p_better, refuted > 0, len(pairs), text)


@dataclass(frozen=True)
class Similar:
    """Agents score the same, within a tolerance, in every domain."""

    agents: tuple[str, ...]
    domains: tuple[str, ...]
    tolerance: float | None = None
    """By default that of the domain."""

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All agents in all domains."""
        return tuple(itertools.product(self.domains, self.agents))

    def judge(self, scores: Scores) -> Finding:
        """Run TOST on all pairs; a significant difference that isn't negligible contradicts."""
        pairs = [
            ((domain, a), (domain, b))
            for domain in self.domains
            for a, b in itertools.combinations(self.agents, 2)
        ]
        ready = _ready(scores, pairs)
        equal = _equivalences(scores, ready, self.tolerance)
        differ = holm([welch_p(*samples) for samples in _samples(scores, ready)], family=len(pairs))
        refuted = [d < SIGNIFICANCE and not e < SIGNIFICANCE for d, e in zip(differ, equal, strict=True)]
        text = (
            f"{sum(p < SIGNIFICANCE for p in equal)} of {len(pairs)} pairs equivalent, {sum(refuted)} differ"
        )
        return _conclude(scores, self.cells, equal, any(refuted), len(pairs), text)


@dataclass(frozen=True)
class MatchesIn:
    """An agent is no worse than others, by more than the tolerance, in so many of the domains."""

    agent: str
    others: tuple[str, ...]
    domains: tuple[str, ...]
    at_least: int

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The agent and the others in all domains."""
        return tuple(itertools.product(self.domains, (self.agent, *self.others)))

    def judge(self, scores: Scores) -> Finding:
        """Run non-inferiority tests; a domain with a significantly better other, and no match, is lost.

        Holm's correction spans the others of all domains.
        """
        pairs = [((domain, self.agent), (domain, other)) for domain in self.domains for other in self.others]
        ready = _ready(scores, pairs)
        below = holm([welch_p(*pair, tail="less") for pair in _samples(scores, ready)], family=len(pairs))
        close: dict[str, int] = dict.fromkeys(self.domains, 0)
        worse: set[str] = set()
        for pair, samples, p in zip(ready, _samples(scores, ready), below, strict=True):
            domain = pair[0][0]
            if welch_p(*samples, shift=-scores.domain(domain).tolerance, tail="greater") < SIGNIFICANCE:
                close[domain] += 1
            elif p < SIGNIFICANCE:
                worse.add(domain)
        matched, lost = sum(count == len(self.others) for count in close.values()), len(worse)
        text = f"matches in {matched} of {len(self.domains)} domains, worse in {lost}"
        if matched >= self.at_least:
            return Finding(Answer.HOLDS, text)
        if lost > len(self.domains) - self.at_least:
            return Finding(Answer.FAILS, text)
        return Finding(_lacking(scores, self.cells) or Answer.INCONCLUSIVE, text)


@dataclass(frozen=True)
class OrderVaries:
    """The order of agents is not the same in all domains."""

    agents: tuple[str, ...]
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All agents in all domains."""
        return tuple(itertools.product(self.domains, self.agents))

    def judge(self, scores: Scores) -> Finding:
        """Look for two agents that are significantly ordered one way in a domain and the other way in another."""
        combinations = list(itertools.combinations(self.agents, 2))
        pairs = [((domain, a), (domain, b)) for domain in self.domains for a, b in combinations]
        ready = _ready(scores, pairs)
        samples = _samples(scores, ready)
        p = holm([welch_p(*pair) for pair in samples], family=len(pairs))
        signs: dict[tuple[str, str], set[bool]] = {}
        for (first, second), (a, b), value in zip(ready, samples, p, strict=True):
            if value < SIGNIFICANCE:
                signs.setdefault((first[1], second[1]), set()).add(a.mean > b.mean)
        turned = sum(len(both) == 2 for both in signs.values())
        text = f"{turned} of {len(combinations)} pairs of agents change order"
        if turned:
            return Finding(Answer.HOLDS, text)
        return Finding(_lacking(scores, self.cells) or Answer.INCONCLUSIVE, text)


@dataclass(frozen=True)
class MatchesReference:
    """Agents score as the upper reference row does, within the tolerance."""

    agents: tuple[str, ...]
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All agents in all domains."""
        return tuple(itertools.product(self.domains, self.agents))

    def judge(self, scores: Scores) -> Finding:
        """Run TOST of each cell against the row as the paper prints it, from a clean start."""
        equal, differ = [], []
        for cell in self.cells:
            row = scores.reference_sample(cell[0], UPPER["classic"], CLEAN) if scores.ready(cell) else None
            if row is not None:
                ours = scores.sample(cell)
                equal.append(equivalence_p(ours, row, tolerance=scores.domain(cell[0]).tolerance))
                differ.append(welch_p(ours, row, tail="less"))
        adjusted = holm(differ, family=len(self.cells))
        refuted = [d < SIGNIFICANCE and not e < SIGNIFICANCE for d, e in zip(adjusted, equal, strict=True)]
        text = f"{sum(p < SIGNIFICANCE for p in equal)} of {len(self.cells)} cells equivalent, {sum(refuted)} below"
        absent = [d for d in self.domains if scores.reference(d, UPPER["classic"], CLEAN) is None]
        return _conclude(scores, self.cells, equal, any(refuted), len(self.cells), text, absent)


@dataclass(frozen=True)
class ComesClose:
    """Agents reach a share of the upper reference row, normalised as the paper's Table 7."""

    agents: tuple[str, ...]
    domains: tuple[str, ...]
    share: float

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All agents in all domains."""
        return tuple(itertools.product(self.domains, self.agents))

    def judge(self, scores: Scores) -> Finding:
        """Compare Student's interval of the mean, normalised, with the share.

        The reference rows, means of many episodes that lie far apart, are taken for exact.
        """
        scales = {domain: scores.scale(domain, upper_start=CLEAN) for domain in self.domains}
        intervals: dict[Cell, tuple[float, float]] = {}
        for cell in self.cells:
            scale = scales[cell[0]]
            if scale is not None and scores.ready(cell):
                low, high = mean_interval(scores.sample(cell))
                intervals[cell] = scale.normalise(low), scale.normalise(high)
        absent = [domain for domain, scale in scales.items() if scale is None]
        return _beside(
            scores, self.cells, intervals, f"above {self.share:.2f}", lower=self.share, absent=absent
        )


@dataclass(frozen=True)
class AlonePerfect:
    """One agent always succeeds in all domains, and no other does."""

    agent: str
    others: tuple[str, ...]
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All agents in all domains."""
        return tuple(itertools.product(self.domains, (self.agent, *self.others)))

    def judge(self, scores: Scores) -> Finding:
        """Compare seed-level intervals of the success rate with 1 - tolerance, over all domains together."""
        perfect = {agent: self._everywhere(scores, agent) for agent in (self.agent, *self.others)}
        also = [agent for agent in self.others if perfect[agent] is True]
        ours = {True: "perfect in all", False: "not perfect in all", None: "undecided"}[perfect[self.agent]]
        excluded = sum(perfect[agent] is False for agent in self.others)
        text = f"{ours} {len(self.domains)}; of {len(self.others)} others {len(also)} perfect, {excluded} not"
        if perfect[self.agent] is False or also:
            return Finding(Answer.FAILS, text)
        if perfect[self.agent] and excluded == len(self.others):
            return Finding(Answer.HOLDS, text)
        return Finding(_lacking(scores, self.cells) or Answer.INCONCLUSIVE, text)

    def _everywhere(self, scores: Scores, agent: str) -> bool | None:
        """Say whether an agent is perfect in all domains (None: cannot be told)."""
        answers: list[bool | None] = []
        for domain in self.domains:
            if not scores.ready((domain, agent)):
                answers.append(None)
                continue
            low, high = success_interval(scores, (domain, agent))
            needed = 1 - scores.domain(domain).tolerance
            answers.append(True if low >= needed else False if high < needed else None)
        return False if False in answers else None if None in answers else True


@dataclass(frozen=True)
class SucceedsBelow:
    """Agents' success rates stay below a level."""

    agents: tuple[str, ...]
    domains: tuple[str, ...]
    level: float

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All agents in all domains."""
        return tuple(itertools.product(self.domains, self.agents))

    def judge(self, scores: Scores) -> Finding:
        """Compare seed-level intervals of the success rate with the level."""
        intervals = {c: success_interval(scores, c) for c in self.cells if scores.ready(c)}
        return _beside(scores, self.cells, intervals, f"below {self.level:.2f}", upper=self.level)


@dataclass(frozen=True)
class LessStable:
    """Agents' learning curves fall back further from what they had reached than those of others."""

    agents: tuple[str, ...]
    calm: tuple[str, ...]
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Both groups in all domains."""
        return tuple(itertools.product(self.domains, (*self.agents, *self.calm)))

    def judge(self, scores: Scores) -> Finding:
        """Run one-sided Welch tests on the mean fall below the running best, over a run's second half.

        No error of measuring a fall is stored, so its spread over seeds has no floor.
        """
        groups = itertools.product(self.domains, self.agents, self.calm)
        pairs = [((domain, a), (domain, b)) for domain, a, b in groups]
        ready = [pair for pair in _ready(scores, pairs) if all(scores.cell_curves(cell) for cell in pair)]
        samples = [tuple(_falls(scores, cell) for cell in pair) for pair in ready]
        less_stable = [welch_p(a, b, tail="greater") for a, b in samples]
        against = holm([welch_p(a, b, tail="less") for a, b in samples], family=len(pairs))
        refuted = sum(p < SIGNIFICANCE for p in against)
        counts = f"{sum(p < SIGNIFICANCE for p in less_stable)} of {len(pairs)} comparisons significant"
        text = counts + (f", {refuted} contradict" if refuted else "")
        return _conclude(scores, self.cells, less_stable, refuted > 0, len(pairs), text)


@dataclass(frozen=True)
class LearnsFaster:
    """An agent reaches 90 % of the upper reference row in fewer steps than another, in every domain."""

    agent: str
    other: str
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Both agents in all domains."""
        return tuple(itertools.product(self.domains, (self.agent, self.other)))

    def judge(self, scores: Scores) -> Finding:
        """Run exact one-sided Mann-Whitney tests on the steps; runs that never get there tie as slowest."""
        faster, slower = [], []
        for domain in self.domains:
            steps = [learning_steps(scores, (domain, agent)) for agent in (self.agent, self.other)]
            if min(len(s) for s in steps) < 2 or not all(
                scores.ready((domain, a)) for a in (self.agent, self.other)
            ):
                continue
            ours, theirs = steps
            faster.append(rank_sum_p(ours, theirs))
            slower.append(rank_sum_p(theirs, ours))
        refuted = sum(p < SIGNIFICANCE for p in holm(slower, family=len(self.domains)))
        counts = f"faster in {sum(p < SIGNIFICANCE for p in faster)} of {len(self.domains)} domains"
        text = counts + (f", slower in {refuted}" if refuted else "")
        absent = [domain for domain in self.domains if scores.scale(domain) is None]
        return _conclude(scores, self.cells, faster, refuted > 0, len(self.domains), text, absent)


@dataclass(frozen=True)
class RecoversHalf:
    """An agent closes about half of the gap between a lower and a higher one, on average over the domains."""

    agent: str
    lower: str
    higher: str
    domains: tuple[str, ...]
    around: tuple[float, float] = (0.25, 0.75)
    """What counts as about half."""

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The three agents in all domains."""
        return tuple(itertools.product(self.domains, (self.agent, self.lower, self.higher)))

    def judge(self, scores: Scores) -> Finding:
        """Bootstrap the share of the summed gaps; without a gap to close it is infinite, not about half.

        Seeds are drawn anew, not the episodes that measure them: equal seeds bring no spread into the interval.
        """
        lacking = _lacking(scores, self.cells)
        if lacking:
            return Finding(lacking, "")
        strata = {f"{d}|{a}": scores.values((d, a)) for d, a in self.cells}

        def share(values: Mapping[str, Array]) -> Array:
            mean = {name: v.mean(axis=-1) for name, v in values.items()}
            gained = sum(mean[f"{d}|{self.agent}"] - mean[f"{d}|{self.lower}"] for d in self.domains)
            gap = sum(mean[f"{d}|{self.higher}"] - mean[f"{d}|{self.lower}"] for d in self.domains)
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(np.where(np.asarray(gap) > 0, gained / np.asarray(gap), np.inf))

        estimate = aggregate.bootstrap(strata, share)
        text = f"recovers {estimate}"
        low, high = self.around
        if low <= estimate.low and estimate.high <= high:
            return Finding(Answer.HOLDS, text)
        apart = estimate.high < low or estimate.low > high
        return Finding(Answer.FAILS if apart else Answer.INCONCLUSIVE, text)


@dataclass(frozen=True)
class ReconstructsBelief:
    """KL(b ‖ b̂) of a grounded actor stays below a bound, in nats."""

    agent: str
    domains: tuple[str, ...]
    bound: float

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The agent in all domains."""
        return tuple((domain, self.agent) for domain in self.domains)

    def judge(self, scores: Scores) -> Finding:
        """Compare Student's interval of the mean divergence with the bound.

        No error of measuring a divergence is stored, so its spread over seeds has no floor.
        """
        intervals = {}
        for cell in self.cells:
            runs = scores.cell_runs(cell)
            if scores.ready(cell) and "sampled_belief_kl" in runs and runs["sampled_belief_kl"].notna().all():
                intervals[cell] = mean_interval(sample(runs, "sampled_belief_kl"))
        return _beside(scores, self.cells, intervals, f"below {self.bound:.2f} nats", upper=self.bound)


@dataclass(frozen=True)
class BeliefGoesWithScore:
    """Over the runs of grounded agents, a better reconstructed belief goes with a higher score."""

    agents: tuple[str, ...]
    domains: tuple[str, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The agents in all domains."""
        return tuple(itertools.product(self.domains, self.agents))

    def judge(self, scores: Scores) -> Finding:
        """Rank runs within each domain by divergence and by score, and correlate the ranks over all domains.

        Unlike comparisons, of which one may contradict a claim for the rest, a correlation over some of the cells
        answers another question: nothing is judged until all are there, each with a divergence that was measured.
        """
        strata: list[tuple[Array, Array]] = []
        unmeasured = False
        for domain in self.domains:
            frames = [scores.cell_runs((domain, a)) for a in self.agents if scores.ready((domain, a))]
            frames = [_measured(runs, "sampled_belief_kl") for runs in frames]
            unmeasured |= any(runs.empty for runs in frames)
            runs = pd.concat(frames) if frames else pd.DataFrame()
            if len(runs):
                kl, score = runs["sampled_belief_kl"], runs[scores.domain(domain).metric]
                strata.append((kl.to_numpy(dtype=float), score.to_numpy(dtype=float)))
        rho, p = spearman_within(strata)
        known = not math.isnan(rho)
        count = sum(len(kl) for kl, _ in strata)
        text = (
            f"rank correlation {rho:.2f} over {count} runs, p = {p:.3f}"
            if known
            else "too few runs, or none differ"
        )
        lacking = Answer.MISSING if unmeasured else _lacking(scores, self.cells)
        if lacking or not p < SIGNIFICANCE:
            return Finding(lacking or Answer.INCONCLUSIVE, text)
        return Finding(Answer.HOLDS if rho < 0 else Answer.FAILS, text)


@dataclass(frozen=True)
class LearnsBeforeReward:
    """A grounded actor's belief loss falls by a share of its whole fall while success is still rare."""

    agent: str
    domains: tuple[str, ...]
    rare: float
    share: float

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The agent in all domains."""
        return tuple((domain, self.agent) for domain in self.domains)

    def judge(self, scores: Scores) -> Finding:
        """Compare Student's interval of the mean share with the one asked for.

        No error of measuring a loss is stored, so the spread of shares over seeds has no floor.
        """
        intervals = {}
        for cell in self.cells:
            if scores.ready(cell):
                shares = [early_fall(curve, self.rare) for curve in scores.cell_curves(cell)]
                shares = [share for share in shares if not math.isnan(share)]
                if len(shares) > 1:
                    intervals[cell] = mean_interval(Sample.of(shares))
        return _beside(scores, self.cells, intervals, f"above {self.share:.2f}", lower=self.share)


def success_interval(scores: Scores, cell: Cell) -> tuple[float, float]:
    """Return the seed-level interval of a cell's success rate in the sampled evaluation."""
    runs = scores.cell_runs(cell)
    return rate_interval(runs["sampled_success"].tolist(), evaluation_episodes(runs))


def learning_steps(scores: Scores, cell: Cell, share: float = aggregate.LEARNT) -> list[float]:
    """Return, for each run of a cell, the steps to a share of what the upper reference row earns."""
    scale = scores.scale(cell[0])
    if scale is None:
        return []
    level, column = share * scale.upper, scores.curve_column(cell[0])
    return [aggregate.steps_to(curve, column, level) for curve in scores.cell_curves(cell)]


def early_fall(curve: pd.DataFrame, rare: float) -> float:
    """Return which share of the belief loss's fall has happened by the point at which success first is more than rare.

    NaN, and no part of the mean, for a run whose loss was not logged or does not fall, or whose success stays rare.
    """
    if "belief_cross_entropy" not in curve:
        return math.nan
    loss = curve["belief_cross_entropy"].to_numpy(dtype=float)
    settled = curve["episodes"].to_numpy() >= aggregate.WINDOW
    often = np.flatnonzero((curve["success_100"].to_numpy() > rare) & settled)
    if len(often) == 0 or np.isnan(loss).any() or loss[0] <= np.nanmin(loss):
        return math.nan
    return float((loss[0] - loss[: often[0] + 1].min()) / (loss[0] - loss.min()))


def fall(curve: pd.DataFrame, column: str) -> float:
    """Return the mean distance below the best point so far, over the second half of a curve's steps.

    What the few episodes before the first full window earned is no best to fall from; NaN for a run without such a
    window.
    """
    curve = aggregate.settled(curve, column)
    if curve.empty:
        return math.nan
    steps, values = curve["env_steps"].to_numpy(), curve[column].to_numpy(dtype=float)
    below = np.maximum.accumulate(values) - values
    late = steps >= steps[-1] / 2
    return float(np.trapezoid(below[late], steps[late]) / max(np.ptp(steps[late]), 1))


def _measured(runs: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return the runs of which a metric is stored (older ones may lack it)."""
    return runs[runs[metric].notna()] if metric in runs else runs[:0]


def _falls(scores: Scores, cell: Cell) -> Sample:
    return Sample.of([fall(curve, scores.curve_column(cell[0])) for curve in scores.cell_curves(cell)])


def _ready(scores: Scores, pairs: Iterable[Pair]) -> list[Pair]:
    return [pair for pair in pairs if all(scores.ready(cell) for cell in pair)]


def _samples(scores: Scores, pairs: Iterable[Pair]) -> list[tuple[Sample, Sample]]:
    return [(scores.sample(a), scores.sample(b)) for a, b in pairs]


def _equivalences(scores: Scores, pairs: Sequence[Pair], tolerance: float | None = None) -> list[float]:
    return [
        equivalence_p(
            scores.sample(a),
            scores.sample(b),
            tolerance=scores.domain(a[0]).tolerance if tolerance is None else tolerance,
        )
        for a, b in pairs
    ]


def _lacking(scores: Scores, cells: Iterable[Cell]) -> Answer | None:
    """Return why not all cells can be judged, if so: one that is not run weighs more than a short one."""
    cells = tuple(cells)
    if any(not scores.has(cell) for cell in cells):
        return Answer.MISSING
    return Answer.SHORT if any(scores.is_short(cell) for cell in cells) else None


def _conclude(
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
    lacking = Answer.MISSING if absent else _lacking(scores, cells)
    if lacking:
        return Finding(lacking, _with_absent(text if p_values else "", cells, absent))
    holds = len(p_values) == comparisons and all(p < SIGNIFICANCE for p in p_values)
    return Finding(Answer.HOLDS if holds else Answer.INCONCLUSIVE, text)


def _beside(
    scores: Scores,
    cells: Sequence[Cell],
    intervals: Mapping[Cell, tuple[float, float]],
    asked: str,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    absent: Sequence[str] = (),
) -> Finding:
    """Judge intervals that all must lie between two bounds; one that lies outside contradicts.

    ``absent`` are domains without the reference rows asked for.
    """
    inside = sum(lower <= low and high <= upper for low, high in intervals.values())
    outside = sum(high < lower or low > upper for low, high in intervals.values())
    text = f"{inside} of {len(cells)} cells {asked}" + (f", {outside} not" if outside else "")
    if outside:
        return Finding(Answer.FAILS, text)
    lacking = Answer.MISSING if absent else _lacking(scores, cells)
    if lacking:
        return Finding(lacking, _with_absent(text if intervals else "", cells, absent))
    return Finding(Answer.HOLDS if inside == len(cells) else Answer.INCONCLUSIVE, text)


def _with_absent(text: str, cells: Sequence[Cell], absent: Sequence[str]) -> str:
    """Add to a statistic of which domains no reference rows are stored."""
    if not absent:
        return text
    every = len(absent) == len({domain for domain, _ in cells}) > 1
    return f"{text}{'; ' if text else ''}no reference rows of {'any domain' if every else ', '.join(absent)}"
