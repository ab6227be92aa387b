"""Whether two results are the same: bit for bit, but for how and when they came about."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from bgn.results import schema

#: What depends on the machine and the moment.
TIMINGS = frozenset(("env_steps_per_second", "wall_seconds", "cpu_seconds", "solve_seconds", "seconds"))


def differing_columns(one: pa.Table, other: pa.Table) -> list[str]:
    """Return the columns in which two shards of a run differ, provenance and timings aside."""
    aside = {*schema.PROVENANCE, *schema.REKEYING, *TIMINGS}
    names = [name for name in dict.fromkeys((*one.column_names, *other.column_names)) if name not in aside]
    return [name for name in names if not _equal(one, other, name)]


def _equal(one: pa.Table, other: pa.Table, name: str) -> bool:
    if name not in one.column_names or name not in other.column_names:
        return False
    mine, theirs = (table[name].to_numpy() for table in (one, other))
    numbers = mine.dtype.kind in "fiu" and theirs.dtype.kind in "fiu"
    return bool(np.array_equal(mine, theirs, equal_nan=numbers))
