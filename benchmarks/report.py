"""Prints what is stored: the state of every run, and the paper's tables beside ours."""

from __future__ import annotations

import pathlib
from collections import Counter
from collections.abc import Sequence

import pandas as pd
import pyarrow as pa
from rich.console import Console

from benchmarks.plan import Selection, State, Status
from bgn import domains
from bgn.agents.specs import AGENTS
from bgn.results import cells, tables
from bgn.results.cells import DomainRow
from bgn.results.grids import Grid
from bgn.results.store import Store, write_atomically, write_parquet
from bgn.results.tables import Evidence


def show_status(selection: Selection, statuses: Sequence[Status], console: Console) -> None:
    """Print how many runs of each cell are done, older, failed or missing, then the failures."""
    rows = []
    for domain in selection.domains:
        ours = [status for status in statuses if status.wanted.spec.domain == domain]
        agents = {
            agent: [s for s in ours if s.wanted.run.startswith(f"{domain}/{agent}/")] for agent in AGENTS
        }
        references = [status for status in ours if status.wanted.kind == "references"]
        rows.append([domain, *(_count(agents[agent]) for agent in AGENTS), _count(references)])
    columns = ["Domain", *(spec.title for spec in AGENTS.values()), "References"]
    title = f"Runs done, budget {selection.budget}, preset {selection.preset}"
    console.print(Grid(title, columns, rows, _reasons(statuses)).rich())
    show_failures(statuses, console)


def show_failures(statuses: Sequence[Status], console: Console) -> None:
    """Print a table of the runs that are not done, if there are any."""
    lacking = [status for status in statuses if status.state is not State.CURRENT]
    failed = [[s.wanted.run, s.state.value, s.detail] for s in lacking if s.state is State.FAILED]
    if failed:
        console.print(Grid("Failed runs", ["Run", "", "Error"], failed).rich())


def show_missing(statuses: Sequence[Status], console: Console) -> None:
    """Print a table naming every run that is not done."""
    lacking = [[s.wanted.run, s.state.value, s.detail] for s in statuses if s.state is not State.CURRENT]
    console.print(Grid("Missing runs", ["Run", "", "Why"], lacking).rich())


def show_tables(selection: Selection, statuses: Sequence[Status], store: Store, console: Console) -> None:
    """Print the tables of everything stored under the budget and preset, and write them beside it."""
    evidence = gather(selection, statuses, store)
    if evidence.runs.empty and evidence.references.empty:
        console.print(f"Nothing is stored in {store.root} yet.", highlight=False, soft_wrap=True)
        return
    grids = [tables.all_metrics(evidence), tables.reference_policies(evidence)]
    if evidence.family("robot"):
        grids.append(tables.success_rates(evidence))
    if evidence.family("classic"):
        grids += [tables.raw_returns(evidence), tables.normalised_returns(evidence)]
    for grid in grids:
        console.print(grid.rich())
    _write(evidence, grids, store.root / "tables")
    console.print(f"Written to {store.root / 'tables'}", highlight=False, soft_wrap=True)


def gather(selection: Selection, statuses: Sequence[Status], store: Store) -> Evidence:
    """Collect the finished runs and reference rows of a store, with what the tables need to know of them."""
    current = {status.wanted.origin.key for status in statuses}
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


def _write(evidence: Evidence, grids: Sequence[Grid], folder: pathlib.Path) -> None:
    frames = {
        "cells": evidence.cells,
        "normalised": tables.normalised_frame(evidence),
        "references": evidence.references,
    }
    for name, frame in frames.items():
        write_parquet(folder / f"{name}.parquet", pa.Table.from_pandas(frame, preserve_index=False))
    text = "\n".join(["# Tables", "", *(grid.markdown() for grid in grids)])
    write_atomically(folder / "tables.md", lambda path: path.write_text(text, encoding="utf-8") and None)
