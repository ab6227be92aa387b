"""Attempts at a run that nobody needs any more, because its result has come from elsewhere."""

from __future__ import annotations

from bgn.results.run_ids import RunId
from bgn.results.store import Kind, Store, read_shard


def discard_attempts(store: Store, kind: Kind, run: str, key: str) -> None:
    """Remove a failed attempt at what is now stored, and checkpoints of it, if they have the same key.

    A stack of seeds goes on as a whole or not at all, so its checkpoint is of no use to the others of it either.
    """
    failed = store.shard(kind, f"{run}.failed")
    if failed.exists() and read_shard(failed)["key"].to_pylist() == [key]:
        failed.unlink()
    if kind == "runs":
        _discard_checkpoints(store, RunId.parse(run), key)


def _discard_checkpoints(store: Store, run: RunId, key: str) -> None:
    cell = str(run.cell)
    for stack in store.unfinished(cell, key):
        if run.seed in stack:
            store.checkpoint(cell, key, stack).unlink(missing_ok=True)
