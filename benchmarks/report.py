"""Prints what is stored: the state of every run, and the paper's tables beside ours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pandas as pd
import pyarrow as pa
from rich.console import Console

from benchmarks.plan import Selection, State, Status
from bgn import domains
from bgn.agents.specs import AGENTS
from bgn.analysis import cells, figures, tables
from bgn.analysis.cells import DomainRow
from bgn.analysis.tables import Evidence
from bgn.analysis.text_table import Grid
from bgn.results.store import Store, write_bytes, write_parquet

#: Columns that the widest table needs.
TABLE_WIDTH = 140


def show_status(selection: Selection, statuses: Sequence[Status], console: Console) -> None:
    """Print how many runs of each cell are done, older, failed or missing, then why runs failed."""
    rows = []
    for domain in selection.domains:
        groups = [f"{domain}/{agent}/" for agent in selection.agents]
        counts = [_count([s for s in statuses if s.wanted.run.startswith(group)]) for group in groups]
        rest = [s for s in statuses if s.wanted.kind == "references" and s.wanted.spec.domain == domain]
        rows.append([domain, *counts, _count(rest)])
    columns = ["Domain", *(AGENTS[agent].title for agent in selection.agents), "References"]
    title = f"Runs done, budget {selection.budget}, preset {selection.preset}"
    _print(Grid(title, columns, rows, _reasons(statuses), labels=1), console)
    failed = [status for status in statuses if status.state is State.FAILED]
    if failed:
        show_missing(failed, console)
    for error, trace in {status.detail: status.traceback for status in failed}.items():
        console.print(trace or error, highlight=False, markup=False, soft_wrap=True)


def show_missing(statuses: Sequence[Status], console: Console) -> None:
    """Print a table naming every run that is not done, and why."""
    lacking = [[s.wanted.run, s.state.value, s.detail] for s in statuses if s.state is not State.CURRENT]
    _print(Grid("Missing runs", ["Run", "State", "Why"], lacking, labels=3), console)


def show_tables(selection: Selection, store: Store, console: Console) -> None:
    """Print the tables of everything stored under the budget and preset, and write them beside it."""
    evidence = gather(selection, store)
    if evidence.runs.empty and evidence.references.empty:
        console.print(f"Nothing is stored in {store.root} yet.", highlight=False, soft_wrap=True)
        return
    grids = [tables.all_metrics(evidence)]
    if not evidence.references.empty:
        grids.append(tables.reference_policies(evidence))
    if evidence.family("robot"):
        grids.append(tables.success_rates(evidence))
    if evidence.family("classic"):
        grids += [tables.raw_returns(evidence), tables.normalised_returns(evidence)]
    for grid in grids:
        _print(grid, console)
    _write(evidence, grids, store)
    console.print(f"Written to {store.root / 'tables'}", highlight=False, soft_wrap=True)


def gather(selection: Selection, store: Store) -> Evidence:
    """Collect the finished runs and reference rows of a store, with what the tables need to know of them."""
    current = selection.current_keys()
    runs, references = (_finished(store.read(kind), current) for kind in ("runs", "references"))
    seen = set(runs.get("domain", ())) | set(references.get("domain", ()))
    rows = [_domain_row(selection, domain) for domain in selection.registry.domains if domain in seen]
    agents = {agent: AGENTS[agent].title for agent in selection.registry.agents}
    policies = {name: entry.title for name, entry in selection.registry.references.items()}
    return Evidence(
        cells=cells.summarise(runs, rows),
        runs=runs,
        references=references,
        domains=rows,
        agents=agents,
        policies=policies,
        remarks=_remarks(selection, runs),
    )


def _print(grid: Grid, console: Console) -> None:
    """Print a table at its full width: a narrow terminal may break its lines, but loses no number."""
    console.print(grid.rich(), width=max(console.width, TABLE_WIDTH), crop=False)


def _finished(rows: pd.DataFrame, current_keys: set[str]) -> pd.DataFrame:
    if rows.empty:
        return rows
    finished = rows[rows["status"] == "ok"]
    return finished.assign(older=~finished["key"].isin(list(current_keys)))


def _domain_row(selection: Selection, domain_id: str) -> DomainRow:
    entry, domain = selection.registry.domains[domain_id], domains.get(domain_id)
    return DomainRow(domain_id, domain.title, domain.family, entry.metric, entry.tolerance)


def _remarks(selection: Selection, runs: pd.DataFrame) -> list[str]:
    budget = selection.registry.budget(selection.budget)
    remarks = [f"Budget {selection.budget}: {budget.description}. Preset {selection.preset}."]
    if len(runs) and runs["older"].any():
        remarks.append(
            f"‡: {int(runs['older'].sum())} of {len(runs)} runs are of other code, settings or domain tables "
            "than the present ones; `python -m benchmarks status` says which."
        )
    return remarks


def _count(statuses: Sequence[Status]) -> str:
    states = Counter(status.state for status in statuses)
    others = [f"{states[state]} {state.value}" for state in (State.STALE, State.FAILED) if states[state]]
    return f"{states[State.CURRENT]}/{len(statuses)}" + (f" ({', '.join(others)})" if others else "")


def _reasons(statuses: Sequence[Status]) -> list[str]:
    reasons = Counter(status.detail for status in statuses if status.state is State.STALE)
    return [f"{count} stored results are older: {reason}" for reason, count in reasons.items()]


def _write(evidence: Evidence, grids: Sequence[Grid], store: Store) -> None:
    folder = store.root / "tables"
    frames = {
        "cells": evidence.cells,
        "normalised": tables.normalised_frame(evidence),
        "references": evidence.references,
    }
    for name, frame in frames.items():
        write_parquet(folder / f"{name}.parquet", pa.Table.from_pandas(frame, preserve_index=False))
    text = "\n".join(["# Tables", "", *(grid.markdown() for grid in grids)])
    write_bytes(folder / "tables.md", text.encode())
    if len(evidence.runs):
        curves = store.read("curves").merge(
            evidence.runs[["run", "key", "domain", "agent"]], on=["run", "key"]
        )
        write_bytes(folder / "learning-curves.png", figures.learning_curves(evidence, curves))
