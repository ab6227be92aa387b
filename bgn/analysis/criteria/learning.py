"""How agents learn: how soon, how steadily, and what from before there are rewards."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bgn.analysis import aggregate
from bgn.analysis.criteria.findings import Finding, above, beside, conclude, counted, ready_pairs
from bgn.analysis.scores import Scores
from bgn.analysis.statistics import Sample, holm, rank_sum_p, welch_p
from bgn.analysis.verdicts import SIGNIFICANCE, Cell


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
        ready = [
            pair for pair in ready_pairs(scores, pairs) if all(scores.cell_curves(cell) for cell in pair)
        ]
        samples = [tuple(_falls(scores, cell) for cell in pair) for pair in ready]
        less_stable = [welch_p(a, b, tail="greater") for a, b in samples]
        against = holm([welch_p(a, b, tail="less") for a, b in samples], family=len(pairs))
        refuted = sum(p < SIGNIFICANCE for p in against)
        counts = counted(sum(p < SIGNIFICANCE for p in less_stable), len(ready), len(pairs))
        text = counts + (f", {refuted} contradict" if refuted else "")
        return conclude(scores, self.cells, less_stable, refuted > 0, len(pairs), text)


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
        """Run exact one-sided Mann-Whitney tests on the steps; runs that never get there tie as slowest.

        Three runs of each agent are too few: no order of six values is rarer than 1 in 20.
        """
        faster, slower, too_few = [], [], 0
        for domain in self.domains:
            steps = [learning_steps(scores, (domain, agent)) for agent in (self.agent, self.other)]
            if min(len(s) for s in steps) < 2 or not all(
                scores.ready((domain, a)) for a in (self.agent, self.other)
            ):
                continue
            ours, theirs = steps
            faster.append(rank_sum_p(ours, theirs))
            slower.append(rank_sum_p(theirs, ours))
            too_few += 1 / math.comb(len(ours) + len(theirs), len(ours)) >= SIGNIFICANCE
        refuted = sum(p < SIGNIFICANCE for p in holm(slower, family=len(self.domains)))
        counts = f"faster in {sum(p < SIGNIFICANCE for p in faster)} of {len(self.domains)} domains"
        text = counts + (f", slower in {refuted}" if refuted else "")
        text += f", too few runs to tell in {too_few}" if too_few else ""
        absent = [domain for domain in self.domains if scores.scale(domain) is None]
        return conclude(scores, self.cells, faster, refuted > 0, len(self.domains), text, absent)


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
        """Compare the mean share with the one asked for (Student's test).

        No error of measuring a loss is stored, so the spread of shares over seeds has no floor.
        """
        bounds = {}
        for cell in self.cells:
            if scores.ready(cell):
                shares = [early_fall(curve, self.rare) for curve in scores.cell_curves(cell)]
                shares = [share for share in shares if not math.isnan(share)]
                if len(shares) > 1:
                    bounds[cell] = above(Sample.of(shares), self.share)
        return beside(scores, self.cells, bounds, f"above {self.share:.2f}")


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


def _falls(scores: Scores, cell: Cell) -> Sample:
    return Sample.of([fall(curve, scores.curve_column(cell[0])) for curve in scores.cell_curves(cell)])
