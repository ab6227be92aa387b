"""Prints what is stored: the state of every run, and the paper's tables beside ours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Literal

import pyarrow as pa
from rich.console import Console

from benchmarks import evidence
from benchmarks.evidence import StoredEvidence
from benchmarks.plan import Selection, State, Status
from bgn.agents.specs import agent
from bgn.analysis import tables
from bgn.analysis.figures import curves, style
from bgn.analysis.text_table import TextTable
from bgn.results.atomic import write_bytes
from bgn.results.run_ids import CellId, RunId
from bgn.results.store import Store, write_parquet

Form = Literal["markdown", "csv", "html", "latex"]

#: Columns that the widest table of results needs, and the widest of states.
TABLE_WIDTH = 100
STATUS_WIDTH = 140


def show_status(selection: Selection, statuses: Sequence[Status], console: Console) -> None:
    """Print how many runs of each cell are done, older, failed or missing, then why runs failed."""
    groups: dict[str, list[Status]] = {}
    for status in statuses:
        of = status.request.id
        groups.setdefault(str(of.cell) if isinstance(of, RunId) else of.domain, []).append(status)
    rows = []
    for domain in selection.domains:
        cells = [str(CellId(domain, agent_id)) for agent_id in selection.agents]
        rows.append([domain, *(_count(groups.get(group, [])) for group in (*cells, domain))])
    columns = ["Domain", *(agent(agent_id).title for agent_id in selection.agents), "References"]
    title = f"Runs done, budget {selection.budget}, preset {selection.preset}"
    _print(TextTable(title, columns, rows, _reasons(statuses), labels=1), console, STATUS_WIDTH)
    failed = [status for status in statuses if status.state is State.FAILED]
    if failed:
        show_missing(failed, console)
    for error, trace in {status.detail: status.traceback for status in failed}.items():
        console.print(trace or error, highlight=False, markup=False, soft_wrap=True)


def show_missing(statuses: Sequence[Status], console: Console) -> None:
    """Print a table naming every run that is not done, and why."""
    missing = [[s.request.run, s.state.value, s.detail] for s in statuses if s.state is not State.CURRENT]
    _print(TextTable("Missing runs", ["Run", "State", "Why"], missing, labels=3), console)


def show_tables(
    selection: Selection,
    store: Store,
    console: Console,
    *,
    everything: bool = False,
    form: Form | None = None,
    writing: AbstractContextManager[None] | None = None,
) -> None:
    """Print the claims and tables of what is stored under the budget and preset.

    Without ``everything``: a line per claim, and the tables of returns and success rates. ``form`` prints them for
    another program, not for the terminal. Given ``writing``, all of them are also written beside the results, in that
    context, after they are printed.
    """
    found = evidence.gather(selection.registry, selection.budget, selection.preset, store)
    if found.runs.empty and found.references.empty:
        console.print(_nothing(store), highlight=False, soft_wrap=True)
        return
    first, rest = leading_tables(found), further_tables(found)
    for table in (*first, *rest) if everything else first:
        if form is None:
            _print(table, console)
        else:
            print(_formatted(table, form, selection))
    if writing is not None:
        with writing:
            _write(found, [*first, *rest], store)
    if form is None:
        said = [] if writing is None else [f"Written to {store.root / 'tables'}."]
        said += [] if everything else ["All tables: --all."]
        console.print(" ".join(said), highlight=False, soft_wrap=True)


def _formatted(table: TextTable, form: Form, selection: Selection) -> str:
    """Return a table for another program; as CSV, which has no title and no notes, every line says what it is of."""
    if form == "csv":
        return table.csv({"Table": table.title, "Budget": selection.budget, "Preset": selection.preset})
    return str(getattr(table, form)())


def _nothing(store: Store) -> str:
    """Say that a store is empty, and which beside it are not."""
    stores = sorted({path.parent for path in store.root.parents[1].glob("*/*/runs")})
    others = [f"{path.parent.name}/{path.name}" for path in stores if path != store.root]
    there = f" Stored there (budget/preset): {', '.join(others)}." if others else ""
    return f"Nothing is stored in {store.root} yet.{there}"


def leading_tables(found: StoredEvidence) -> list[TextTable]:
    """Return what a reader asks first: the claims' verdicts, then the paper's tables with ours."""
    shown = [tables.claim_lines(found.claims, found.remarks)]
    if found.family("classic"):
        shown.append(tables.raw_returns(found))
    if found.family("robot"):
        shown.append(tables.success_rates(found))
    return shown


def further_tables(found: StoredEvidence) -> list[TextTable]:
    """Return the other tables."""
    shown = [tables.claim_details(found.claims)]
    if found.family("classic"):
        shown.append(tables.normalised_returns(found))
    shown.append(tables.all_metrics(found))
    habits = tables.policies_habits(found)
    if habits.rows:
        shown.append(habits)
    if found.family("robot"):
        shown.append(tables.success_collapses(found, found.scores))
    if not found.references.empty:
        shown.append(tables.reference_policies(found))
    return shown


def _print(table: TextTable, console: Console, width: int = TABLE_WIDTH) -> None:
    """Print a table at its full width: a narrow terminal may break its lines, but loses no number."""
    terminal = console.width
    console.width = max(
        min(terminal, 2 * width), width, table.narrowest
    )  # print() takes no width above the console's
    try:
        console.print(table.rich(), crop=False)
    finally:
        console.width = terminal


def _count(statuses: Sequence[Status]) -> str:
    states = Counter(status.state for status in statuses)
    shown = (State.INCOMPLETE, State.STALE, State.FAILED)
    others = [f"{states[state]} {state.value}" for state in shown if states[state]]
    return f"{states[State.CURRENT]}/{len(statuses)}" + (f" ({', '.join(others)})" if others else "")


def _reasons(statuses: Sequence[Status]) -> list[str]:
    explained = (State.STALE, State.INCOMPLETE)
    reasons = Counter((status.state, status.detail) for status in statuses if status.state in explained)
    return [f"{n} stored results are {state.value}: {reason}" for (state, reason), n in reasons.items()]


def _write(found: StoredEvidence, shown: Sequence[TextTable], store: Store) -> None:
    folder = store.root / "tables"
    frames = {
        "cells": found.cells,
        "normalised": tables.normalised_frame(found),
        "references": found.references,
        "claims": found.claims,
    }
    for name, frame in frames.items():
        write_parquet(folder / f"{name}.parquet", pa.Table.from_pandas(frame, preserve_index=False))
    text = "\n".join(["# Tables", "", *(table.markdown() for table in shown)])
    write_bytes(folder / "tables.md", text.encode())
    if len(found.runs):
        for family, draw in (("classic", curves.training_curves), ("robot", curves.success_curves)):
            if found.family(family):
                figure = draw(found.scores, found.agent_titles)
                write_bytes(folder / f"learning-curves-{family}.png", style.png(figure))
