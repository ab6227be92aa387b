"""Computes a stored run again and says whether the result is the same, bit for bit."""

from __future__ import annotations

import json
import pathlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.tasks import CellTask, ReferenceSpec, ReferenceTask, Task, Tools, execute
from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.results import provenance
from bgn.results.comparison import differing_columns, run_differences
from bgn.results.provenance import Origin
from bgn.results.store import Kind, Store, StoreError, read_shard
from bgn.training.cell import CellSpec


@dataclass(frozen=True)
class Verdict:
    """What a rerun came to."""

    differences: list[str]
    """What came out otherwise; empty if nothing."""
    remarks: list[str]
    """What is not as it was when the run was stored."""


def rerun(store: Store, run: str, *, budget: str, preset: str, tools: Tools) -> Verdict:
    """Compute a run or a reference row again, from the specification in its row.

    Raises
    ------
    StoreError
        There is no such row, it cannot be read, or the run fails now.
    """
    kind = _kind(store, run)
    (row,) = read_shard(store.shard(kind, run)).to_pylist()
    with tempfile.TemporaryDirectory() as folder:
        again = Store(pathlib.Path(folder))
        task = _task(kind, row, again.root, budget, preset)
        failure = execute(task, tools, lambda _: None)
        if failure:
            raise StoreError(f"{run} fails now: {failure.error}")
        if kind == "runs":
            differences = run_differences(run, store, again)
        else:
            mine, theirs = (read_shard(one.shard(kind, run)) for one in (store, again))
            differences = [f"{kind}: {name}" for name in differing_columns(mine, theirs)]
    return Verdict(differences, _remarks(row, task.origin))


def _kind(store: Store, run: str) -> Kind:
    kinds: tuple[Kind, ...] = ("runs", "references")
    for kind in kinds:
        if store.shard(kind, run).exists():
            return kind
    raise StoreError(f"{store.root} holds no run {run}; an id looks like hallway/ah-ch+bgn/seed-3")


def _task(kind: Kind, row: Mapping[str, Any], root: pathlib.Path, budget: str, preset: str) -> Task:
    described = json.loads(row["spec"])
    common = {"budget": budget, "preset": preset, "store": root, "cost": 1.0}
    if kind == "references":
        reference = ReferenceSpec(**described)
        origin = _origin(reference, provenance.PLANNING_CODE, None)
        return ReferenceTask(origin=origin, spec=reference, **common)
    settings = Hyperparameters(**described.pop("hyperparameters"))
    spec = CellSpec(hyperparameters=settings, **described)
    unused = None if spec.physics_episodes else provenance.PHYSICS_CODE
    origin = _origin(spec, provenance.TRAINING_CODE, unused)
    return CellTask(origin=origin, spec=spec, seeds=(row["seed"],), device=row["device"], **common)


def _origin(spec: CellSpec | ReferenceSpec, entry: str, unused: str | None) -> Origin:
    data = provenance.data_hash(domains.get(spec.domain))
    return Origin(provenance.spec_hash(spec), provenance.code_hash(entry, without=unused), data)


def _remarks(row: Mapping[str, Any], now: Origin) -> list[str]:
    pairs = {"settings": (row["spec_hash"], now.spec), "code": (row["code_hash"], now.code)}
    pairs["domain tables"] = (row["data_hash"], now.data)
    changed = [f"the {what} changed since" for what, (then, today) in pairs.items() if then != today]
    here = provenance.environment()
    names = ("machine", "version_torch", "version_numpy")
    return changed + [
        f"{name}: then {row[name]}, now {here[name]}" for name in names if row[name] != here[name]
    ]
