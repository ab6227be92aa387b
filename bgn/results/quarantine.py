"""Sets damaged results aside, so that a run can compute them anew and nobody takes them for results.

What is set aside lies under ``quarantine/`` of the store, at the path it had, for whoever wants to look. A run
is its row, its curve and its policy: if one of them is damaged, all are set aside.

A shard of an older version lacks columns, one of a newer version has more: neither matters, as long as those
are there that say what the row is and how it came about, with their types.
"""

from __future__ import annotations

import json
import pathlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import pyarrow as pa

from bgn.results import schema
from bgn.results.store import Kind, Store, StoreError, read_shard

FOLDER = "quarantine"

_ROW = ("run", "status", "error", "traceback", "key", "spec_hash", "code_hash", "data_hash")
_KNOWN = {
    **schema.RUN_IDENTITY,
    **schema.REFERENCE_IDENTITY,
    **schema.OUTCOME,
    **schema.PROVENANCE,
    **schema.REKEYING,
    **schema.ADOPTION,
}
_NEEDED: dict[Kind, tuple[str, ...]] = {
    "runs": (*_ROW, "domain", "agent", "seed"),
    "references": (*_ROW, "domain", "reference", "convention"),
    "curves": ("run", "key", "env_steps"),
}
_METRICS: dict[Kind, tuple[str, ...]] = {
    "runs": schema.RUN_METRICS,
    "references": schema.REFERENCE_METRICS,
    "curves": schema.CURVE_COLUMNS,
}


@dataclass(frozen=True)
class Damage:
    """A damaged file, where it lies now, and what is wrong with it."""

    path: pathlib.Path
    aside: pathlib.Path
    reason: str

    def __str__(self) -> str:
        return f"{self.path} is damaged ({self.reason}); it is set aside as {self.aside}"


def sweep(store: Store) -> list[Damage]:
    """Set aside every damaged file of a store that this process has locked, with what belongs to its run."""
    found: list[Damage] = []
    for kind in _NEEDED:
        for path in sorted((store.root / kind).rglob("[!.]*.parquet")):
            reason = path.exists() and damage_of_shard(store, kind, path)
            if reason:
                found += _set_aside(store, path, reason)
    for path in sorted((store.root / "policies").rglob("[!.]*.safetensors")):
        reason = damage_of_policy(path)
        if reason:
            found += _set_aside(store, path, reason)
    return found


def damage_of_shard(store: Store, kind: Kind, path: pathlib.Path) -> str:
    """Say what is wrong with a shard; empty if nothing is."""
    try:
        table = read_shard(path)
    except StoreError as error:
        return str(error.__cause__).partition("\n")[0][:200]
    missing = [name for name in _NEEDED[kind] if name not in table.column_names]
    if missing:
        return f"no column {', '.join(missing)}: another version wrote it"
    known = {**_KNOWN, **dict.fromkeys(_METRICS[kind], pa.float64())}
    for name in table.column_names:
        expected, found = known.get(name), table.schema.field(name).type
        if expected is not None and not _fits(found, expected):  # what is not known may be anything
            return f"column {name} holds {found}, not {expected}: another version wrote it"
    run = _run_of(store, kind, path)
    if table.num_rows == 0 or set(table["run"].to_pylist()) != {run}:
        return f"it does not hold {run}, which its name promises"
    return ""


def damage_of_run(store: Store, kind: Kind, run: str) -> str:
    """Say what is wrong with a row or with what belongs to it, and in which file; empty if nothing is."""
    parts: list[tuple[Kind, pathlib.Path]] = [(kind, store.shard(kind, run))]
    if kind == "runs":
        parts.append(("curves", store.shard("curves", run)))
    found = [(path, damage_of_shard(store, of, path)) for of, path in parts if path.exists()]
    if kind == "runs" and store.policy(run).exists():
        found.append((store.policy(run), damage_of_policy(store.policy(run))))
    return next((f"{path}: {damage}" for path, damage in found if damage), "")


def damage_of_policy(path: pathlib.Path) -> str:
    """Say what is wrong with a policy's file, as far as its length and header tell; empty if nothing is."""
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(8)
        length = struct.unpack("<Q", start)[0] if len(start) == 8 else size
        if length > size - 8:
            return f"{size} bytes are less than its header needs"
        try:
            entries = json.loads(file.read(length))
            ends = [entry["data_offsets"][1] for name, entry in entries.items() if name != "__metadata__"]
            wanted = 8 + length + max(ends, default=0)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            return "its header is not that of a safetensors file"
    return "" if wanted == size else f"{size} bytes long, not {wanted} as its header says"


def _fits(found: pa.DataType, expected: pa.DataType) -> bool:
    """Say whether values of one type can stand where another is expected."""
    if pa.types.is_null(found) or found == expected:
        return True
    if pa.types.is_string(expected):
        return bool(pa.types.is_large_string(found))
    if pa.types.is_floating(expected):
        return bool(pa.types.is_floating(found) or pa.types.is_integer(found))
    return str(found).partition("[")[0] == str(expected).partition("[")[0]  # timestamps, lists of numbers


def _run_of(store: Store, kind: Kind, path: pathlib.Path) -> str:
    relative = path.relative_to(store.root / kind).as_posix()
    return relative.removesuffix(".parquet").removesuffix(".failed")


def _set_aside(store: Store, path: pathlib.Path, reason: str) -> Iterator[Damage]:
    """Move a file, then what else its run has: the row first, which stands for all others."""
    kind, *rest = path.relative_to(store.root).parts
    if path.name.endswith(".failed.parquet") or kind == "references":
        yield Damage(path, _move(store, path), reason)
        return
    run = "/".join(rest).rpartition(".")[0]
    belonging = [store.shard("runs", run), store.shard("curves", run), store.policy(run)]
    for one in belonging:
        if one.exists():
            aside = _move(store, one)
            yield Damage(one, aside, reason if one == path else f"belongs to {path.name}: {reason}")


def _move(store: Store, path: pathlib.Path) -> pathlib.Path:
    aside = store.root / FOLDER / path.relative_to(store.root)
    aside.parent.mkdir(parents=True, exist_ok=True)
    taken = 0
    while aside.exists():
        taken += 1
        aside = aside.with_name(f"{path.name}.{taken}")
    path.rename(aside)
    return aside
