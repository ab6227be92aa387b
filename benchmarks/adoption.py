"""Results that another budget or preset has already: equal settings, code and tables make equal results.

A row whose key is the one that is asked for is copied, with all that lies beside it, instead of being computed again;
``taken_from`` says which budget and preset it was computed under. Everything else about it stays.
"""

from __future__ import annotations

import pathlib
from collections.abc import Iterator, Sequence

import pyarrow as pa

from benchmarks.plan import Request
from benchmarks.superfluous import discard_attempts
from bgn.results import schema
from bgn.results.atomic import write_bytes
from bgn.results.quarantine import damage_of_run
from bgn.results.store import Store, read_shard


def adopt(requests: Sequence[Request], store: Store, results: pathlib.Path) -> list[Request]:
    """Copy what other stores under ``results`` hold of the requests; return the requests that were answered.

    The store must be locked by the caller.
    """
    others = [other for other in stores_of(results) if other.root.resolve() != store.root.resolve()]
    return [request for request in requests if _adopt(request, store, others)]


def stores_of(results: pathlib.Path) -> Iterator[Store]:
    """Yield the store of every budget and preset, in the order of their names."""
    for folder in sorted(results.glob("*/*")):
        if (folder / "runs").is_dir() or (folder / "references").is_dir():
            yield Store(folder)


def _adopt(request: Request, store: Store, others: Sequence[Store]) -> bool:
    for other in others:
        shard = other.shard(request.kind, request.run)
        if not shard.is_file() or damage_of_run(other, request.kind, request.run):
            continue
        row = read_shard(shard)
        if row["status"].to_pylist() == ["ok"] and row["key"].to_pylist() == [request.origin.key]:
            _copy(request, row, other, store)
            discard_attempts(store, request.kind, request.run, request.origin.key)
            return True
    return False


def _copy(request: Request, row: pa.Table, source: Store, store: Store) -> None:
    """Copy a row, the row itself last: it stands for all that belongs to it."""
    if request.kind == "runs":
        for theirs, ours in zip(source.companions(request.run), store.companions(request.run), strict=True):
            if theirs.is_file():
                write_bytes(ours, theirs.read_bytes())
    store.write(request.kind, request.run, under(row, store, taken_from=name_of(source)))


def under(row: pa.Table, store: Store, *, taken_from: str) -> pa.Table:
    """Return a row as it stands in another store: its budget and preset, and where it was computed first."""
    preset, budget = store.root.name, store.root.parent.name
    before = row["taken_from"].to_pylist()[0] if "taken_from" in row.column_names else None
    changed = {"budget": budget, "preset": preset, "taken_from": before or taken_from}
    kinds = {**schema.RUN_IDENTITY, **schema.ADOPTION}
    for name, value in changed.items():
        column = pa.array([value], type=kinds[name])
        at = row.schema.get_field_index(name)
        row = row.append_column(name, column) if at < 0 else row.set_column(at, name, column)
    return row


def name_of(store: Store) -> str:
    """Return a store's budget and preset, such as ``paper/calibrated``."""
    return f"{store.root.parent.name}/{store.root.name}"
