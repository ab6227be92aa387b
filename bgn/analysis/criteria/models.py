"""What the domains' own models say: no run is needed."""

from __future__ import annotations

from dataclasses import dataclass

from bgn import domains
from bgn.analysis.criteria.findings import Answer, Finding
from bgn.analysis.scores import Scores
from bgn.analysis.verdicts import Cell
from bgn.pomdp.model import Floats


@dataclass(frozen=True)
class Penalises:
    """There are actions that cost reward, in every domain."""

    domains: tuple[str, ...]
    cells: tuple[Cell, ...] = ()

    def judge(self, scores: Scores) -> Finding:
        """Look for negative rewards."""
        count = sum(bool((_rewards(domain) < 0).any()) for domain in self.domains)
        return _all(count, self.domains, "an action costs reward")


@dataclass(frozen=True)
class RewardsSuccessOnly:
    """The only reward is 1, for an action that ends the episode, in every domain."""

    domains: tuple[str, ...]
    cells: tuple[Cell, ...] = ()

    def judge(self, scores: Scores) -> Finding:
        """Look for any other reward."""
        count = 0
        for domain in self.domains:
            rewards, reset = _rewards(domain), domains.get(domain).model.joint.reset
            count += bool(((rewards == 0) | (rewards == 1) & reset).all())
        return _all(count, self.domains, "only success is rewarded")


def _rewards(domain: str) -> Floats:
    return domains.get(domain).model.joint.expected_rewards


def _all(count: int, of: tuple[str, ...], what: str) -> Finding:
    """Conclude from exact models: there is nothing to be uncertain about."""
    holds = count == len(of)
    return Finding(Answer.HOLDS if holds else Answer.FAILS, f"{what} in {count} of {len(of)} models")
