"""The rows of published shards, read from parquet alone, and what the claims ask of them."""

from __future__ import annotations

import functools
import json
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bgn.results import provenance
from tests.benchmarks import recomputed_statistics as statistics
from tests.benchmarks.recomputed_statistics import HORIZONS, METRICS, TABLE_6, Sample

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "published"
CURVES = [
    "run",
    "key",
    "env_steps",
    "episodes",
    "return_100",
    "success_100",
    "belief_cross_entropy",
    "entropy",
]
Cell = tuple[str, str]


@dataclass
class Rows:
    """Finished runs with their curves by cell, and reference rows by domain, policy and convention."""

    runs: dict[Cell, pd.DataFrame] = field(default_factory=dict)
    curves: dict[Cell, list[pd.DataFrame]] = field(default_factory=dict)
    references: dict[tuple[str, str, str], pd.Series] = field(default_factory=dict)
    horizons: Mapping[str, int] = field(default_factory=lambda: HORIZONS)
    """Environment steps without which a domain's runs are short."""

    def at_any_length(self, references: dict[tuple[str, str, str], pd.Series]) -> Rows:
        """Return the same rows, of which none is short, with lent reference rows where they have none."""
        return replace(self, horizons={}, references=self.references or references)

    def renamed(self, names: dict[str, str]) -> Rows:
        """Return the same rows as if other agents had been trained."""
        runs, curves = (
            {(d, names[a]): rows for (d, a), rows in of.items()} for of in (self.runs, self.curves)
        )
        return replace(self, runs=runs, curves=curves)

    def domains(self) -> set[str]:
        return {domain for domain, *_ in (*self.runs, *self.references)}

    def steps(self, cell: Cell) -> list[int]:
        return (
            [json.loads(spec)["env_steps"] for spec in self.runs[cell]["spec"]] if cell in self.runs else []
        )

    def missing(self, cell: Cell) -> bool:
        """Say whether a cell, or its second seed, is missing."""
        return len(self.runs.get(cell, ())) < 2

    def short(self, cell: Cell) -> bool:
        return min(self.steps(cell), default=np.inf) < self.horizons.get(cell[0], 0)

    def judged(self, *cells: Cell) -> bool:
        return not any(self.missing(cell) or self.short(cell) for cell in cells)

    def sample(self, cell: Cell) -> Sample:
        return statistics.sample(self.runs[cell], METRICS[cell[0]])

    def values(self, cell: Cell) -> np.ndarray:
        return self.runs[cell][METRICS[cell[0]]].to_numpy()

    def rate(self, cell: Cell) -> tuple[float, float]:
        """Return the interval of a seed's success rate."""
        runs = self.runs[cell]
        return statistics.seed_rate(runs["sampled_success"].to_numpy(), statistics.episodes(runs))

    def rate_sides(self, cell: Cell, value: float) -> tuple[float, float]:
        """Return the p-values of a seed's rate being above, and below, a value."""
        runs = self.runs[cell]
        return statistics.sides_of_rate(runs["sampled_success"].to_numpy(), statistics.episodes(runs), value)


class Table6(Rows):
    """The paper's own numbers in place of runs."""

    def missing(self, cell: Cell) -> bool:
        return cell[0] not in TABLE_6 or cell[1] not in statistics.AGENTS

    def short(self, cell: Cell) -> bool:
        return False

    def sample(self, cell: Cell) -> Sample:
        return statistics.of_table_6(*cell)


def stores() -> list[tuple[str, str]]:
    """Return the published budgets and presets that hold runs."""
    return sorted((path.parts[-3], path.parts[-2]) for path in RESULTS.glob("*/*/runs"))


@functools.cache
def read(budget: str, preset: str) -> Rows:
    """Read one store's shards."""
    rows, root = Rows(), RESULTS / budget / preset
    for domain in METRICS:
        for folder in sorted((root / "runs" / domain).glob("*")):
            runs = _frame(folder)
            if len(runs):
                cell = domain, folder.name
                measures = _frame(root / "measures" / domain / folder.name)
                runs = runs.merge(measures, how="left") if len(measures) else runs
                rows.runs[cell] = runs.reindex(columns=[*dict.fromkeys([*runs, "sampled_belief_kl"])])
                curves = _frame(root / "curves" / domain / folder.name, CURVES)
                keys = dict(zip(runs["run"], runs["key"], strict=True))
                found = dict(iter(curves.groupby("run"))) if len(curves) else {}
                assert all((curve["key"] == keys[run]).all() for run, curve in found.items())
                rows.curves[cell] = list(found.values())
        for folder in sorted((root / "references" / domain).glob("*")):
            for _, row in _frame(folder).iterrows():
                rows.references[domain, folder.name, row["convention"]] = row
    return rows


def longest(preset: str) -> tuple[Rows, dict[str, str]]:
    """Return, for each domain, the runs of the longest budget of most agents, and which budget that is.

    Of equally long ones it is that with more runs, of equals in that too the one that is judged.
    """
    parts = {budget: read(budget, preset) for budget, name in stores() if name == preset}
    rows, budgets = Rows(), {}
    for domain in METRICS:
        of_domain = {budget: [c for c in part.runs if c[0] == domain] for budget, part in parts.items()}
        sizes = {b: _size(parts[b], cells) for b, cells in of_domain.items() if cells}
        if sizes:
            budgets[domain] = chosen = max(sizes, key=lambda budget: (sizes[budget], budget == "paper"))
            rows.runs |= {cell: parts[chosen].runs[cell] for cell in of_domain[chosen]}
            rows.curves |= {cell: parts[chosen].curves[cell] for cell in of_domain[chosen]}
            rows.references |= {k: r for k, r in lent_references().items() if k[0] == domain}
            rows.references |= {k: r for k, r in parts[chosen].references.items() if k[0] == domain}
    return rows, budgets


@functools.cache
def lent_references() -> dict[tuple[str, str, str], pd.Series]:
    """Return what stands in where a budget lacks a reference row, which is not trained and knows no preset.

    It is the row of the present code, of the most episodes, the latest: in this order.
    """
    present = provenance.code_hash(provenance.PLANNING)
    best: dict[tuple[str, str, str], pd.Series] = {}
    for store in stores():
        for key, row in read(*store).references.items():
            if key not in best or _worth(row, present) > _worth(best[key], present):
                best[key] = row
    return best


def _worth(row: pd.Series, present: str) -> tuple[bool, int, pd.Timestamp]:
    return row["code_hash"] == present, json.loads(row["spec"])["episodes"], row["finished_at"]


def _size(rows: Rows, cells: list[Cell]) -> tuple[int, int, int]:
    """Return the number of agents, the environment steps and the number of runs of a domain."""
    steps = [steps for cell in cells for steps in rows.steps(cell)]
    return len(cells), max(steps), len(steps)


def _frame(folder: pathlib.Path, columns: list[str] | None = None) -> pd.DataFrame:
    """Return the finished rows of a folder's shards."""
    shards = [path for path in sorted(folder.glob("[!.]*.parquet")) if ".failed" not in path.name]
    tables = [pq.read_table(shard, columns=columns, partitioning=None) for shard in shards]
    if not tables:
        return pd.DataFrame()
    frame = pa.concat_tables(tables, promote_options="default").to_pandas()
    return frame[frame["status"] == "ok"] if "status" in frame else frame
