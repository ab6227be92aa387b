"""Which agent scores higher, or the same, or no worse."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bgn.analysis.criteria.findings import (
    Answer,
    Finding,
    conclude,
    counted,
    equivalences,
    lacking,
    pair_samples,
    ready_pairs,
)
from bgn.analysis.scores import Scores
from bgn.analysis.statistics import at_least_p, holm, welch_p
from bgn.analysis.verdicts import SIGNIFICANCE, Cell


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
        ready = ready_pairs(scores, pairs)
        p_better = [welch_p(*samples, tail="greater") for samples in pair_samples(scores, ready)]
        worse = [welch_p(*samples, tail="less") for samples in pair_samples(scores, ready)]
        equal = equivalences(scores, ready)
        against = np.fmin(holm(worse, family=len(pairs)), holm(equal, family=len(pairs)))
        better = np.array(p_better) < SIGNIFICANCE  # if by little: what is better is not contradicted
        counts = counted(int(better.sum()), len(ready), len(pairs))
        refuted = int(np.sum((against < SIGNIFICANCE) & ~better))
        text = counts + (f", {refuted} contradict" if refuted else "")
        return conclude(scores, self.cells, p_better, refuted > 0, len(pairs), text)


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
        ready = ready_pairs(scores, pairs)
        equal = equivalences(scores, ready, self.tolerance)
        differ = holm([welch_p(*samples) for samples in pair_samples(scores, ready)], family=len(pairs))
        refuted = [d < SIGNIFICANCE and not e < SIGNIFICANCE for d, e in zip(differ, equal, strict=True)]
        text = (
            f"{sum(p < SIGNIFICANCE for p in equal)} of {len(pairs)} pairs equivalent, {sum(refuted)} differ"
        )
        return conclude(scores, self.cells, equal, any(refuted), len(pairs), text)


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

        A domain is matched if all others are; in how many is a partial conjunction over the domains. That another is
        better is Holm-corrected over the others of all domains.
        """
        pairs = [((domain, self.agent), (domain, other)) for domain in self.domains for other in self.others]
        ready = ready_pairs(scores, pairs)
        samples = pair_samples(scores, ready)
        below = holm([welch_p(*pair, tail="less") for pair in samples], family=len(pairs))
        close: dict[str, list[float]] = {domain: [] for domain in self.domains}
        worse: set[str] = set()
        for (first, _), pair, p in zip(ready, samples, below, strict=True):
            domain = first[0]
            no_worse = welch_p(*pair, shift=-scores.domain(domain).tolerance, tail="greater")
            close[domain].append(no_worse)
            if p < SIGNIFICANCE and not no_worse < SIGNIFICANCE:
                worse.add(domain)
        matches = [max(p) if len(p) == len(self.others) else math.nan for p in close.values()]
        matched = _surely(matches)
        text = f"matches in {matched} of {len(self.domains)} domains, worse in {len(worse)}"
        if matched >= self.at_least:
            return Finding(Answer.HOLDS, text)
        if len(worse) > len(self.domains) - self.at_least:
            return Finding(Answer.FAILS, text)
        return Finding(lacking(scores, self.cells) or Answer.INCONCLUSIVE, text)


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
        ready = ready_pairs(scores, pairs)
        samples = pair_samples(scores, ready)
        p = holm([welch_p(*pair) for pair in samples], family=len(pairs))
        signs: dict[tuple[str, str], set[bool]] = {}
        for (first, second), (a, b), value in zip(ready, samples, p, strict=True):
            if value < SIGNIFICANCE:
                signs.setdefault((first[1], second[1]), set()).add(a.mean > b.mean)
        turned = sum(len(both) == 2 for both in signs.values())
        text = f"{turned} of {len(combinations)} pairs of agents change order"
        if turned:
            return Finding(Answer.HOLDS, text)
        return Finding(lacking(scores, self.cells) or Answer.INCONCLUSIVE, text)


def _surely(p_values: Sequence[float]) -> int:
    """Return of how many null hypotheses it is significant that so many are false."""
    counts = range(1, len(p_values) + 1)
    return max((u for u in counts if at_least_p(p_values, u) < SIGNIFICANCE), default=0)
