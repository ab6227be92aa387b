"""What claims are judged by: the stored runs and reference rows, looked up by domain and agent."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bgn.analysis import cells
from bgn.analysis.cells import DomainRow
from bgn.analysis.statistics import Sample
from bgn.analysis.verdicts import Cell
from bgn.domains.episode_opening import CLEAN, HIDDEN

Array = NDArray[np.float64]

#: The row that stands for the best that is possible, by family of domains.
UPPER = {"classic": "sarsop", "robot": "perfect"}


@dataclass(frozen=True)
class Scale:
    """The two reference returns that become 0 and 1."""

    lower: float
    upper: float

    def normalise(self, value: float) -> float:
        """Return (value - lower) / (upper - lower)."""
        return (value - self.lower) / (self.upper - self.lower)

    def denormalise(self, share: float) -> float:
        """Return the value that :meth:`normalise` makes this share."""
        return self.lower + share * (self.upper - self.lower)


@dataclass(frozen=True)
class Scores:
    """Finished runs, their curves and the reference rows of one budget and preset."""

    runs: pd.DataFrame
    curves: pd.DataFrame
    """With columns domain and agent beside those of the schema."""
    references: pd.DataFrame
    domains: Sequence[DomainRow]

    @cached_property
    def _groups(self) -> dict[Cell, pd.DataFrame]:
        if self.runs.empty:
            return {}
        return {(str(d), str(a)): group for (d, a), group in self.runs.groupby(["domain", "agent"])}

    # Claims share cells, and each asks anew: what they look up is made once.

    @cached_property
    def _short(self) -> dict[Cell, bool]:
        return {
            c: cells.is_short(r, self._domains[c[0]])
            for c, r in self._groups.items()
            if c[0] in self._domains
        }

    @cached_property
    def _samples(self) -> dict[Cell, Sample]:
        return {}  # filled when asked for: not every run has every metric

    @cached_property
    def _curves(self) -> dict[Cell, list[pd.DataFrame]]:
        found: dict[Cell, list[pd.DataFrame]] = {}
        if not self.curves.empty:
            for (domain, agent, _), curve in self.curves.groupby(["domain", "agent", "run"]):
                found.setdefault((str(domain), str(agent)), []).append(curve)
        return found

    @cached_property
    def _references(self) -> dict[tuple[str, str, str], pd.Series]:
        if self.references.empty:
            return {}
        groups = self.references.groupby(["domain", "reference", "convention"])
        return {(str(d), str(p), str(c)): rows.iloc[0] for (d, p, c), rows in groups}

    @cached_property
    def _domains(self) -> dict[str, DomainRow]:
        return {domain.id: domain for domain in self.domains}

    def domain(self, domain: str) -> DomainRow:
        """Return a domain of the evidence."""
        return self._domains[domain]

    def cell_runs(self, cell: Cell) -> pd.DataFrame:
        """Return a cell's runs, one row per seed (empty where there are none)."""
        return self._groups.get(cell, pd.DataFrame())

    def has(self, cell: Cell) -> bool:
        """Say whether a cell has at least two runs, so that there is a spread to judge by."""
        return len(self.cell_runs(cell)) > 1

    def is_short(self, cell: Cell) -> bool:
        """Say whether a cell's runs are shorter than the paper's horizon."""
        return self._short.get(cell, False)

    def ready(self, cell: Cell) -> bool:
        """Say whether a cell can be judged."""
        return self.has(cell) and not self.is_short(cell)

    def sample(self, cell: Cell) -> Sample:
        """Return the judged metric of a cell, one value per seed."""
        if cell not in self._samples:
            self._samples[cell] = cells.sample(self.cell_runs(cell), self._domains[cell[0]].metric)
        return self._samples[cell]

    def values(self, cell: Cell) -> Array:
        """Return the judged metric of every seed of a cell."""
        runs = self.cell_runs(cell)
        return (
            runs[self._domains[cell[0]].metric].dropna().to_numpy(dtype=float) if len(runs) else np.empty(0)
        )

    def reference(self, domain: str, policy: str, convention: str) -> pd.Series | None:
        """Return the row of a policy that is not trained."""
        return self._references.get((domain, policy, convention))

    def reference_sample(self, domain: str, policy: str, convention: str) -> Sample | None:
        """Return a reference row as a sample of its episodes."""
        row = self.reference(domain, policy, convention)
        if row is None:
            return None
        episodes = int(json.loads(row["spec"])["episodes"])
        error = float(row["return_se"]) * math.sqrt(episodes)
        return Sample(float(row["return"]), float(row["return_sd"]), episodes, error)

    def scale(self, domain: str, *, upper_start: str | None = None) -> Scale | None:
        """Return Random and the best reference as agents live: episodes open with the hidden action in classic domains.

        ``upper_start`` opens the upper row's episodes in another way, as the paper's table does with ``clean``.
        """
        if domain not in self._domains:
            return None
        family = self._domains[domain].family
        start = HIDDEN if family == "classic" else CLEAN
        upper = self.reference(domain, UPPER[family], upper_start or start)
        lower = self.reference(domain, "random", start)
        if upper is None or lower is None:
            return None
        best = 1.0 if family == "robot" else float(upper["return"])  # in robot domains success counts
        worst = float(lower.get("success", math.nan)) if family == "robot" else float(lower["return"])
        if math.isnan(worst):
            worst = float(lower["return"])
        return Scale(worst, best)

    def shares(self, cell: Cell) -> Array:
        """Return a cell's values as shares of the best reference's, episodes opening alike (empty without one).

        Unlike Table 7, which normalises by Random as well: RockSample's -62 would press all agents into .85 to 1.
        """
        scale = self.scale(cell[0])
        return np.empty(0) if scale is None else self.values(cell) / scale.upper

    def strata(self, agent: str, family: str) -> dict[str, Array]:
        """Return an agent's shares of the best by domain of a family, where it has any."""
        found = {d.id: self.shares((d.id, agent)) for d in self.domains if d.family == family}
        return {domain: values for domain, values in found.items() if len(values)}

    def cell_curves(self, cell: Cell) -> list[pd.DataFrame]:
        """Return the learning curves of a cell's runs."""
        return self._curves.get(cell, [])

    def curve_column(self, domain: str) -> str:
        """Return the column of curves that shows how well a domain is learnt."""
        return "return_100" if self._domains[domain].family == "classic" else "success_100"
