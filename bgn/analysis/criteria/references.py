"""How close agents come to the best policy that planning finds."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from bgn.analysis.criteria.findings import Bound, Finding, above, beside, conclude
from bgn.analysis.scores import UPPER, Scores
from bgn.analysis.statistics import equivalence_p, holm, welch_p
from bgn.analysis.verdicts import SIGNIFICANCE, Cell
from bgn.domains.episode_opening import CLEAN


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
        return conclude(scores, self.cells, equal, any(refuted), len(self.cells), text, absent)


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
        """Compare the mean, normalised, with the share (Student's test).

        The reference rows, means of many episodes that lie far apart, are taken for exact.
        """
        scales = {domain: scores.scale(domain, upper_start=CLEAN) for domain in self.domains}
        bounds: dict[Cell, Bound] = {}
        for cell in self.cells:
            scale = scales[cell[0]]
            if scale is not None and scores.ready(cell):
                bounds[cell] = above(scores.sample(cell), scale.denormalise(self.share))
        absent = [domain for domain, scale in scales.items() if scale is None]
        return beside(scores, self.cells, bounds, f"above {self.share:.2f}", absent)
