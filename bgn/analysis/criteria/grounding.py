"""What reconstructing the belief is worth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bgn.analysis import aggregate
from bgn.analysis.aggregate import Array
from bgn.analysis.cells import sample
from bgn.analysis.criteria.findings import Answer, Finding, below, beside, lacking
from bgn.analysis.scores import Scores
from bgn.analysis.statistics import spearman_within
from bgn.analysis.verdicts import SIGNIFICANCE, Cell


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
        """Compare the mean divergence with the bound (Student's test).

        No error of measuring a divergence is stored, so its spread over seeds has no floor.
        """
        bounds = {}
        for cell in self.cells:
            runs = scores.cell_runs(cell)
            if scores.ready(cell) and "sampled_belief_kl" in runs and runs["sampled_belief_kl"].notna().all():
                bounds[cell] = below(sample(runs, "sampled_belief_kl"), self.bound)
        return beside(scores, self.cells, bounds, f"below {self.bound:.2f} nats")


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
        """Rank runs within each cell by divergence and by score, and correlate the ranks over all cells.

        Not within a domain: an agent that sees the belief reconstructs its own input, so that its divergence is small
        for a reason of its own, and between agents it goes with whatever else tells them apart.
        Unlike comparisons, of which one may contradict a claim for the rest, a correlation over some of the cells
        answers another question: nothing is judged until all are there, each with a divergence that was measured.
        """
        strata: list[tuple[Array, Array]] = []
        unmeasured = False
        for cell in filter(scores.ready, self.cells):
            runs = _measured(scores.cell_runs(cell), "sampled_belief_kl")
            unmeasured |= runs.empty
            if len(runs):
                kl, score = runs["sampled_belief_kl"], runs[scores.domain(cell[0]).metric]
                strata.append((kl.to_numpy(dtype=float), score.to_numpy(dtype=float)))
        rho, p = spearman_within(strata)
        known = not math.isnan(rho)
        count = sum(len(kl) for kl, _ in strata)
        text = (
            f"rank correlation {rho:.2f} over {count} runs, p = {p:.3f}"
            if known
            else "too few runs, or none differ"
        )
        why_not = Answer.MISSING if unmeasured else lacking(scores, self.cells)
        if why_not or not p < SIGNIFICANCE:
            return Finding(why_not or Answer.INCONCLUSIVE, text)
        return Finding(Answer.HOLDS if rho < 0 else Answer.FAILS, text)


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
        why_not = lacking(scores, self.cells)
        if why_not:
            return Finding(why_not, "")
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


def _measured(runs: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return the runs of which a metric is stored (older ones may lack it)."""
    return runs[runs[metric].notna()] if metric in runs else runs[:0]
