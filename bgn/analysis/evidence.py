"""What tables and figures are made of: frames of results, and the names under which they are shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from bgn.analysis.cells import DomainRow


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Finished results of one budget and preset, judged; in the order in which they are shown."""

    cells: pd.DataFrame
    """One row per cell with its verdict: :func:`bgn.analysis.cells.summarise`."""
    runs: pd.DataFrame
    """One row per finished run (:mod:`bgn.results.schema`), and ``older``: not of the present code or settings."""
    references: pd.DataFrame
    """One row per finished reference row, and ``older``."""
    domains: Sequence[DomainRow]
    """The domains to show."""
    agent_titles: Mapping[str, str]
    """The agents to show: titles by id."""
    reference_titles: Mapping[str, str]
    """The policies that are not trained: titles by id."""
    remarks: Sequence[str] = ()
    """Notes on the whole, such as results of older code."""

    def family(self, family: str) -> list[DomainRow]:
        """Return the classic or the robot domains."""
        return [domain for domain in self.domains if domain.family == family]

    def cell(self, domain: str, agent: str) -> pd.Series | None:
        """Return the summary of a cell, if it has runs."""
        found = self.cells[(self.cells["domain"] == domain) & (self.cells["agent"] == agent)]
        return None if found.empty else found.iloc[0]

    def reference(self, domain: str, policy: str, convention: str) -> pd.Series | None:
        """Return the row of a reference policy, if it was evaluated."""
        rows = self.references
        if rows.empty:
            return None
        rows = rows[(rows["domain"] == domain) & (rows["reference"] == policy)]
        rows = rows[rows["convention"] == convention]
        return None if rows.empty else rows.iloc[0]
