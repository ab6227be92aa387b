"""Whether two results are the same: bit for bit, but for how and when they came about."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from bgn.results import schema
from bgn.results.store import Store, read_shard

#: What depends on the machine and the moment.
TIMINGS = frozenset(("env_steps_per_second", "wall_seconds", "cpu_seconds", "seconds"))


def differing_columns(one: pa.Table, other: pa.Table) -> list[str]:
    """Return the columns in which two shards of a run differ, provenance and timings aside."""
    aside = {*schema.PROVENANCE, *TIMINGS}
    names = [name for name in dict.fromkeys((*one.column_names, *other.column_names)) if name not in aside]
    return [name for name in names if not _equal(one, other, name)]


def _equal(one: pa.Table, other: pa.Table, name: str) -> bool:
    if name not in one.column_names or name not in other.column_names:
        return False
    mine, theirs = (table[name].to_numpy() for table in (one, other))
    numbers = mine.dtype.kind in "fiu" and theirs.dtype.kind in "fiu"
    return bool(np.array_equal(mine, theirs, equal_nan=numbers))


def run_differences(run: str, one: Store, other: Store) -> list[str]:
    """Say in what a run of two stores differs: its metrics, its curve, its policy; empty if in nothing.

    A policy counts only where both stores have one.

    Raises
    ------
    StoreError
        A shard cannot be read.
    """
    differences = []
    for kind in ("runs", "curves"):
        mine, theirs = (read_shard(store.shard(kind, run)) for store in (one, other))
        differences += [f"{kind}: {name}" for name in differing_columns(mine, theirs)]
    policies = [store.policy(run) for store in (one, other)]
    if all(path.exists() for path in policies):
        mine, theirs = (path.read_bytes() for path in policies)
        differences += [] if mine == theirs else ["policy"]
    return differences
