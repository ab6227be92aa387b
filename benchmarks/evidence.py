"""Stored results read back: what the tables print, what the notebooks show, and what a user starts from.

>>> from benchmarks import evidence
>>> laptop = evidence.load("results/published", budget="laptop")
>>> laptop.cells[["domain", "agent", "mean", "paper_mean", "verdict"]]

``runs``, ``curves``, ``references`` and ``cells`` are pandas frames; ``policy(run)`` is a trained policy.
"""

from __future__ import annotations

import pathlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import pandas as pd

from benchmarks import registry as registries
from benchmarks.plan import Selection, opening
from benchmarks.registry import Registry
from bgn import domains
from bgn.agents.specs import agent
from bgn.analysis import cells
from bgn.analysis.cells import DomainRow
from bgn.analysis.claims import judge_claims
from bgn.analysis.evidence import Evidence
from bgn.analysis.scores import Scores
from bgn.errors import BgnError
from bgn.results import schema
from bgn.results.run_ids import RunId
from bgn.results.store import Store

if TYPE_CHECKING:
    from bgn.policies.saved import NetworkPolicy

_MOST_NAMED = 12


class EvidenceError(BgnError, LookupError):
    """What was asked for is not stored; the message says what is."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StoredEvidence(Evidence):
    """The finished results of one budget and preset, with their curves and policies."""

    budget: str
    preset: str
    store: Store

    def __repr__(self) -> str:
        return (
            f"<evidence of {self.budget}/{self.preset} in {self.store.root}: {len(self.runs)} runs of "
            f"{len(self.cells)} cells, {len(self.references)} reference rows, {len(self.policies())} policies>"
        )

    @cached_property
    def curves(self) -> pd.DataFrame:
        """The learning curves of the finished runs, a row per logged update; read when first asked for.

        Columns: ``run``, ``key``, those of :data:`bgn.results.schema.CURVE_COLUMNS`, ``domain``, ``agent``
        and ``seed``.
        """
        stored = self.store.read("curves")
        if stored.empty:
            return pd.DataFrame(columns=["run", "key", *schema.CURVE_COLUMNS, "domain", "agent", "seed"])
        return stored.merge(self.runs[["run", "key", "domain", "agent", "seed"]], on=["run", "key"])

    @cached_property
    def scores(self) -> Scores:
        """The runs, curves and reference rows as the claims and figures look them up."""
        return Scores(self.runs, self.curves, self.references, self.domains)

    @cached_property
    def claims(self) -> pd.DataFrame:
        """One row per claim of the paper with its verdict: :func:`bgn.analysis.claims.judge_claims`."""
        return judge_claims(self.scores)

    def policy(self, run: str | RunId, *, greedy: bool = True) -> NetworkPolicy:
        """Return the trained policy of a run such as ``hallway/ah-ch+bgn/seed-3``.

        Raises
        ------
        bgn.results.run_ids.RunIdError
            A text that is not a run id.
        EvidenceError
            No policy of that run is stored; the message names those that are.
        """
        run = RunId.parse(run) if isinstance(run, str) else run
        path = self.store.policy(str(run))
        if not path.is_file():
            raise EvidenceError(f"{self.store.root} holds no policy of {run}; {_listed(self.policies())}")
        from bgn.policies.saved import NetworkPolicy  # imported here because torch takes seconds

        return NetworkPolicy.load(path, greedy=greedy)

    def policies(self) -> tuple[str, ...]:
        """Return the ids of the finished runs whose policies are stored."""
        return tuple(run for run in self.runs["run"] if self.store.policy(run).is_file())


def load(
    results: str | pathlib.Path,
    *,
    budget: str | None = None,
    preset: str | None = None,
    registry: Registry | None = None,
) -> StoredEvidence:
    """Read what is stored of one budget and preset under a folder such as ``results/published``.

    Parameters
    ----------
    results
        The folder that ``python -m benchmarks`` calls ``--results``.
    budget, preset
        Names of the registry; None: its default budget, and the budget's own preset.
    registry
        What names and judges the results; None: the one that is shipped.

    Raises
    ------
    EvidenceError
        Nothing of the kind is stored; the message names what is.
    benchmarks.registry.RegistryError
        The registry has no such budget or preset.
    """
    registry = registries.load() if registry is None else registry
    budget = registry.defaults.budget if budget is None else budget
    preset = registry.preset_of(budget) if preset is None else preset
    folder = pathlib.Path(results)
    (budget,), (preset,) = registry.select("budget", [budget]), registry.select("preset", [preset])
    found = gather(registry, budget, preset, Store(folder / budget / preset))
    if found.runs.empty and found.references.empty:
        kinds = ("runs", "references")
        stored = {path.parent for kind in kinds for path in folder.glob(f"*/*/{kind}") if path.is_dir()}
        names = sorted(path.relative_to(folder).as_posix() for path in stored)
        raise EvidenceError(f"{folder} holds no results of {budget}/{preset}; {_listed(names)}")
    return found


def gather(registry: Registry, budget: str, preset: str, store: Store) -> StoredEvidence:
    """Read what a store holds, which may be nothing, and judge it."""
    runs = _measured(_finished(store, "runs"), store)
    references = reference_rows(registry, budget, preset, store)
    named_domains = _present(registry.domains, [*runs["domain"], *references["domain"]])
    named_agents = _present(registry.agents, runs["agent"])
    selection = Selection(
        registry=registry,
        budget=budget,
        preset=preset,
        domains=named_domains,
        agents=named_agents,
        references=(),
        seeds=(0,),  # the key is that of the cell: the seed is no part of it
    )
    current = [request.origin.key for request in selection.requests()]
    runs = runs.assign(older=~runs["key"].isin(current))
    rows = [domain_row(registry, domain) for domain in named_domains]
    return StoredEvidence(
        cells=cells.summarise(runs, rows, named_agents),
        runs=runs,
        references=references,
        domains=rows,
        agent_titles={name: agent(name).title for name in registry.agents},
        reference_titles={name: entry.title for name, entry in registry.references.items()},
        remarks=_remarks(registry, budget, preset, runs),
        budget=budget,
        preset=preset,
        store=store,
    )


def reference_rows(registry: Registry, budget: str, preset: str, store: Store) -> pd.DataFrame:
    """Return the finished reference rows of a store, with a column that says which are of older code or settings."""
    rows = _finished(store, "references")
    selection = Selection(
        registry=registry,
        budget=budget,
        preset=preset,
        domains=tuple(
            d for d in _present(registry.domains, rows["domain"]) if d in registry.budget(budget).env_steps
        ),
        agents=(),
        references=_present(registry.references, rows["reference"]),
        seeds=(),
    )
    return rows.assign(older=~rows["key"].isin([request.origin.key for request in selection.requests()]))


def _finished(store: Store, kind: schema.RowKind) -> pd.DataFrame:
    rows = store.read(kind)
    if rows.empty:
        return pd.DataFrame(columns=[*schema.IDENTITIES[kind], *schema.OUTCOME, *schema.PROVENANCE])
    return rows[rows["status"] == "ok"].reset_index(drop=True)


def _present(names: Iterable[str], stored: Iterable[str]) -> tuple[str, ...]:
    """Return the registry's names that are stored, in its order."""
    found = set(stored)
    return tuple(name for name in names if name in found)


def domain_row(registry: Registry, domain_id: str) -> DomainRow:
    """Return a domain as tables, verdicts and figures need it."""
    entry, domain = registry.domains[domain_id], domains.get(domain_id)
    return DomainRow(
        domain_id,
        domain.title,
        domain.family,
        entry.metric,
        entry.tolerance,
        opening(domain),
        entry.authors_metric,
        registry.horizon(domain_id),
    )


def _measured(runs: pd.DataFrame, store: Store) -> pd.DataFrame:
    """Add what was measured of the policies after training."""
    measures = store.read("measures")
    return runs.merge(measures, on=["run", "key"], how="left") if len(measures) else runs


def _remarks(registry: Registry, budget: str, preset: str, runs: pd.DataFrame) -> list[str]:
    meaning = registry.presets[preset].description
    remarks = [f"Budget {budget}: {registry.budget(budget).description}. Preset {preset}: {meaning}."]
    if runs["older"].any():
        remarks.append(
            f"‡: {int(runs['older'].sum())} of {len(runs)} runs are of other code, settings or domain tables "
            "than the present ones; `python -m benchmarks status` says which."
        )
    unnamed = runs[~(runs["domain"].isin(registry.domains) & runs["agent"].isin(registry.agents))]
    if len(unnamed):
        known = sorted({str(RunId.parse(run).cell) for run in unnamed["run"]})
        remarks.append(
            f"Not shown: {len(unnamed)} runs of cells that this registry does not name, {', '.join(known)}; "
            "`--registry FILE` reads them with one that does."
        )
    return remarks


def _listed(names: Sequence[str]) -> str:
    if not names:
        return "nothing is stored there"
    rest = len(names) - _MOST_NAMED
    return f"stored: {', '.join(names[:_MOST_NAMED])}" + (f" and {rest} more" if rest > 0 else "")
