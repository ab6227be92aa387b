"""Computes a stored run once more and compares every bit of it."""

from __future__ import annotations

import json
import pathlib
from dataclasses import dataclass
from typing import Any

import pandas as pd

from benchmarks.adoption import name_of, stores_of
from benchmarks.retraining import Fingerprint, fingerprint, of_metrics
from benchmarks.tasks import ReferenceSpec, Work
from bgn.agents.hyperparameters import Hyperparameters
from bgn.errors import BgnError
from bgn.results import schema
from bgn.results.store import Kind, Store
from bgn.training.cell import CellSpec


class RerunError(BgnError, LookupError):
    """There is no such run to compute again; the message says why."""


@dataclass(frozen=True)
class Comparison:
    """A run as it was and as it comes out now."""

    run: str
    then: Fingerprint
    now: Fingerprint

    @property
    def differences(self) -> tuple[str, ...]:
        """Which of curve, metrics and policy differ."""
        return self.then.differences(self.now)

    @property
    def identical(self) -> bool:
        """Whether every bit is as it was, but for times."""
        return not self.differences


def rerun_and_compare(store: Store, run: str, work: Work = Work()) -> Comparison:  # noqa: B008
    """Compute a finished run or reference row of a store again, from its specification, on the CPU.

    A stored run does not depend on the seeds that were trained beside it, so it is trained alone. The store is only
    read. Where it has no policy, as what is published, curve and metrics are compared.

    Raises
    ------
    RerunError
        The store holds no such finished row, one whose specification this version does not know, or a run of a GPU.
    """
    kind, row = _row(store, run)
    if kind == "references":
        spec = _specification(ReferenceSpec, row)
        return Comparison(run, of_metrics(_metrics(row, kind)), of_metrics(work.evaluate_reference(spec)))
    if row["device"] != "cpu":
        raise RerunError(
            f"{run} was trained on a GPU ({row['device']}), which adds up in another order: on a CPU it comes out "
            "the same statistically, not bit for bit; `nox -s regress` compares cells that way"
        )
    (result,) = work.train_cell(
        _specification(CellSpec, row), [int(row["seed"])], checkpoint=None, on_progress=lambda _: None
    )
    curve = pd.read_parquet(store.shard("curves", run)).drop(columns=["run", "key"])
    policy = _policy(store.policy(run)) if store.policy(run).exists() else None
    then = fingerprint(curve, _metrics(row, kind), policy or {})
    now = fingerprint(
        result.curve[list(curve.columns)], result.metrics, {} if policy is None else result.policy
    )
    return Comparison(run, then, now)


def _row(store: Store, run: str) -> tuple[Kind, dict[str, Any]]:
    kinds: tuple[Kind, ...] = ("runs", "references")
    for kind in kinds:
        path = store.shard(kind, run)
        if path.is_file():
            return kind, {str(name): value for name, value in pd.read_parquet(path).iloc[0].items()}
    results = store.root.parents[1]
    if not store.root.is_dir() and results.is_dir():
        names = ", ".join(name_of(other) for other in stores_of(results)) or "nothing"
        raise RerunError(f"{results} holds nothing of {name_of(store)}; it holds {names}")
    raise RerunError(f"{store.root} holds no finished {run!r}; runs are called like hallway/ah-ch/seed-0")


def _specification(kind: type[Any], row: dict[str, Any]) -> Any:
    """Read a specification back; raises :class:`RerunError`."""
    fields = json.loads(row["spec"])
    try:
        if "hyperparameters" in fields:
            fields["hyperparameters"] = Hyperparameters(**fields["hyperparameters"])
        return kind(**fields)
    except (TypeError, ValueError) as error:
        raise RerunError(f"{row['run']} was asked for in terms of another version: {error}") from error


def _metrics(row: dict[str, Any], kind: Kind) -> dict[str, float]:
    identity = schema.RUN_IDENTITY if kind == "runs" else schema.REFERENCE_IDENTITY
    others = {*identity, *schema.OUTCOME, *schema.PROVENANCE, *schema.REKEYING, *schema.ADOPTION}
    return {name: float(value) for name, value in row.items() if name not in others}


def _policy(path: pathlib.Path) -> dict[str, Any]:
    """Return a stored policy's parameters (torch is imported here because it takes seconds)."""
    import safetensors.torch

    tensors: dict[str, Any] = safetensors.torch.load_file(path)
    return tensors
