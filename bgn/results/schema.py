"""The tables that runs leave behind, column by column.

``runs``        one row per run: who, how it ended, final metrics, provenance.
``curves``      one row per logged update of a run: see :attr:`bgn.training.cell.RunResult.curve`.
``references``  one row per reference policy, domain and convention.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

import pandas as pd
import pyarrow as pa

from bgn.errors import BgnError

Columns = Mapping[str, pa.DataType]

_TEXT, _INT, _REAL, _FLAG = pa.string(), pa.int64(), pa.float64(), pa.bool_()
_TIME = pa.timestamp("us", tz="UTC")

#: What a row is about. ``run`` is its readable id, e.g. ``hallway/ah-ch+bgn/seed-3``.
RUN_IDENTITY: Columns = {
    "run": _TEXT,
    "domain": _TEXT,
    "agent": _TEXT,
    "seed": _INT,
    "budget": _TEXT,
    "preset": _TEXT,
}
REFERENCE_IDENTITY: Columns = {
    "run": _TEXT,
    "domain": _TEXT,
    "reference": _TEXT,
    "convention": _TEXT,
    "seed": _INT,
    "budget": _TEXT,
    "preset": _TEXT,
}

RowKind = Literal["runs", "references"]
IDENTITIES: Mapping[RowKind, Columns] = {"runs": RUN_IDENTITY, "references": REFERENCE_IDENTITY}

#: How it ended: ``ok`` or ``failed``, and then why; and what a row that is ``ok`` still lacks, which a later call
#: fills in (null: nothing).
OUTCOME: Columns = {"status": _TEXT, "error": _TEXT, "traceback": _TEXT, "missing": _TEXT}

#: What determines the row (:class:`bgn.results.provenance.Origin`) and what it was computed with.
PROVENANCE: Columns = {
    "key": _TEXT,
    "spec_hash": _TEXT,
    "code_hash": _TEXT,
    "data_hash": _TEXT,
    "spec": _TEXT,  # JSON
    "stack_seeds": pa.list_(_INT),  # the seeds that were trained together
    "device": _TEXT,
    "threads": _INT,
    "started_at": _TIME,
    "finished_at": _TIME,
    "git_commit": _TEXT,
    "git_dirty": _FLAG,
    "machine": _TEXT,
    "version_python": _TEXT,
    "version_bgn": _TEXT,
    "version_torch": _TEXT,
    "version_numpy": _TEXT,
    "version_scipy": _TEXT,
    "version_mujoco": _TEXT,
    "version_numba": _TEXT,
}

#: Further columns of a row that was given a new key, because the code that computed it was shown to be equal to newer
#: code (``python -m benchmarks.migration``): what it was stored under at first, and how that was shown.
REKEYING: Columns = {"former_key": _TEXT, "former_code_hash": _TEXT, "rekeyed_because": _TEXT}

#: Further column of a row that was computed under another budget or preset with the same settings: which.
ADOPTION: Columns = {"taken_from": _TEXT}

#: Metrics every finished run has; further ones (physics) are columns of their own.
RUN_METRICS = (
    "train_return",
    "train_success",
    *(
        f"{policy}_{metric}"
        for policy in ("sampled", "greedy")
        for metric in ("return", "return_se", "return_sd", "success", "success_se", "length")
    ),
    "env_steps_per_second",
    "wall_seconds",
    "cpu_seconds",
)
#: Metrics of a run whose final policy was evaluated in physics.
PHYSICS_METRICS = ("physics_success", "physics_success_se", "physics_length", "physics_episodes")
#: Metrics every finished reference row has.
REFERENCE_METRICS = ("return", "return_se", "return_sd")

#: Columns that every learning curve has, after ``run`` and ``key``; the algorithm's losses are further ones.
CURVE_COLUMNS = ("env_steps", "return_100", "success_100", "episodes", "seconds")


class SchemaError(BgnError, ValueError):
    """A result lacks a column, or has one of the wrong type; the message names both."""


def row(identity: Columns, values: Mapping[str, Any], metrics: Mapping[str, float]) -> pa.Table:
    """Return a one-row table: identity, outcome, provenance, and one float column per metric.

    Raises
    ------
    SchemaError
        A column is missing, unknown, or holds the wrong type.
    """
    columns = {**identity, **OUTCOME, **PROVENANCE}
    wrong = set(values) ^ set(columns)
    if wrong:
        raise SchemaError(f"missing or unknown columns: {', '.join(sorted(wrong))}")
    fields = [pa.field(name, kind) for name, kind in columns.items()]
    fields += [pa.field(name, _REAL) for name in metrics]
    filled = {**values, **{name: float(value) for name, value in metrics.items()}}
    try:
        return pa.Table.from_pylist([filled], schema=pa.schema(fields))
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise SchemaError(f"row {values.get('run')}: {error}") from error


def filled_in(table: pa.Table, metrics: Mapping[str, float], columns: Mapping[str, str | None]) -> pa.Table:
    """Return a one-row table with the metrics it lacked, ``columns`` replaced, and nothing missing any more."""
    values = {**table.to_pylist()[0], **metrics, **columns, "missing": None}
    added = [pa.field(name, _REAL) for name in metrics if name not in table.column_names]
    return pa.Table.from_pylist([values], schema=pa.schema([*table.schema, *added]))


def check_metrics(run: str, metrics: Mapping[str, float], needed: Iterable[str]) -> None:
    """Raise :class:`SchemaError` unless all needed metrics are there."""
    missing = [name for name in needed if name not in metrics]
    if missing:
        raise SchemaError(f"run {run} reports no {', '.join(missing)}")


def curve_table(run: str, key: str, curve: pd.DataFrame) -> pa.Table:
    """Return a learning curve as a table whose first columns say whose it is."""
    missing = [name for name in CURVE_COLUMNS if name not in curve.columns]
    if missing:
        raise SchemaError(f"the curve of {run} has no {', '.join(missing)}")
    identified = curve.copy()
    identified.insert(0, "run", run)
    identified.insert(1, "key", key)
    return pa.Table.from_pandas(identified, preserve_index=False)
