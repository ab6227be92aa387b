"""How often agents succeed, and what they do in the robot domains."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bgn.analysis.cells import evaluation_episodes
from bgn.analysis.criteria.findings import BESIDE, Answer, Bound, Finding, beside, lacking
from bgn.analysis.habits import Habit
from bgn.analysis.scores import Scores
from bgn.analysis.statistics import holm, rate_interval, rate_p
from bgn.analysis.verdicts import Cell


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
        """Compare the success rate of a seed with 1 - tolerance, over all domains together.

        To be perfect everywhere takes every domain; to be not perfect somewhere takes one, after Holm's correction over
        the domains. What contradicts the claim, one domain of the agent's or one other agent that is perfect
        everywhere, is corrected over all of these.
        """
        bounds = {agent: self._bounds(scores, agent) for agent in (self.agent, *self.others)}
        everywhere = {agent: self._everywhere(found) for agent, found in bounds.items()}
        against = holm(
            [*(everywhere[other] for other in self.others), *(bound.beyond for bound in bounds[self.agent])],
            family=len(self.others) + len(self.domains),
        )
        also = sum(p < BESIDE for p in against[: len(self.others)])
        imperfect = any(p < BESIDE for p in against[len(self.others) :])
        excluded = sum(self._somewhere_not(bounds[other]) for other in self.others)
        perfect = everywhere[self.agent] < BESIDE
        ours = "not perfect in all" if imperfect else "perfect in all" if perfect else "undecided"
        text = f"{ours} {len(self.domains)}; of {len(self.others)} others {also} perfect, {excluded} not"
        if imperfect or also:
            return Finding(Answer.FAILS, text)
        if perfect and excluded == len(self.others):
            return Finding(Answer.HOLDS, text)
        return Finding(lacking(scores, self.cells) or Answer.INCONCLUSIVE, text)

    def _bounds(self, scores: Scores, agent: str) -> list[Bound]:
        """Return how an agent stands to perfection where its cells are ready, domain by domain."""
        ready = [domain for domain in self.domains if scores.ready((domain, agent))]
        return [success_above(scores, (d, agent), 1 - scores.domain(d).tolerance) for d in ready]

    def _everywhere(self, bounds: Sequence[Bound]) -> float:
        """Return the p-value of an agent's being perfect in all domains; NaN where one is missing."""
        return max(bound.within for bound in bounds) if len(bounds) == len(self.domains) else math.nan

    def _somewhere_not(self, bounds: Sequence[Bound]) -> bool:
        """Say whether an agent is significantly imperfect in one of the domains."""
        return any(p < BESIDE for p in holm([bound.beyond for bound in bounds], family=len(self.domains)))


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
        """Compare the success rate of a seed with the level."""
        above = {c: success_above(scores, c, self.level) for c in self.cells if scores.ready(c)}
        below = {cell: Bound(within=bound.beyond, beyond=bound.within) for cell, bound in above.items()}
        return beside(scores, self.cells, below, f"below {self.level:.2f}")


@dataclass(frozen=True)
class ShowsHabit:
    """An agent's policies do what they are said to do (:mod:`bgn.analysis.habits`)."""

    agent: str
    habit: Habit

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The agent in the habit's domain."""
        return ((self.habit.domain, self.agent),)

    def judge(self, scores: Scores) -> Finding:
        """Compare the share of the cases in which a policy shows the habit with the level asked for.

        A policy's share is exact. That few policies were asked, and of few cases, is what the tests of rates allow for.
        """
        (cell,) = self.cells
        runs, columns = scores.cell_runs(cell), [self.habit.share_column, self.habit.cases_column]
        runs = runs.dropna(subset=columns) if {*columns} <= {*runs} else runs[:0]
        if len(runs) < 2:
            return Finding(Answer.NOT_MEASURED, f"policies measured: {len(runs)}, of the two that it takes")
        shares, cases = runs[columns[0]].tolist(), [round(n) for n in runs[columns[1]]]
        reach = f"{min(shares):.0%} to {max(shares):.0%}"
        text = f"in {np.mean(shares):.0%} of its cases, {reach} by policy; {len(runs)} policies"
        if scores.is_short(cell):
            return Finding(Answer.SHORT, text)
        if rate_p(shares, cases, self.habit.level, tail="less") < BESIDE:
            return Finding(Answer.FAILS, text)
        holds = rate_p(shares, cases, self.habit.level, tail="greater") < BESIDE
        return Finding(Answer.HOLDS if holds else Answer.INCONCLUSIVE, text)


def success_interval(scores: Scores, cell: Cell) -> tuple[float, float]:
    """Return the seed-level interval of a cell's success rate in the sampled evaluation."""
    runs = scores.cell_runs(cell)
    return rate_interval(runs["sampled_success"].tolist(), evaluation_episodes(runs))


def success_above(scores: Scores, cell: Cell, level: float) -> Bound:
    """Compare a cell's success rate in the sampled evaluation with a level that it should be above."""
    runs = scores.cell_runs(cell)
    rates, episodes = runs["sampled_success"].tolist(), evaluation_episodes(runs)
    return Bound(rate_p(rates, episodes, level, tail="greater"), rate_p(rates, episodes, level, tail="less"))
