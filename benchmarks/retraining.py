"""Trains runs anew and takes the fingerprints of what they yield: equal where every bit is.

Run as a script it does so with whatever version of the project is on the path, so that two revisions can be compared;
it therefore needs of them only the trainer, the specification of a cell and the registry.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    from torch import Tensor

#: Columns of a curve and metrics that say how long it took; they differ between any two runs.
_CURVE_TIMES = ("seconds",)
_METRIC_TIMES = ("env_steps_per_second", "wall_seconds", "cpu_seconds", "solve_seconds")


@dataclass(frozen=True)
class Fingerprint:
    """Hashes of what a run yields, times left out."""

    curve: str
    metrics: str
    policy: str

    def differences(self, other: Fingerprint) -> tuple[str, ...]:
        """Return what differs between two runs."""
        ours, theirs = asdict(self), asdict(other)
        return tuple(part for part in ours if ours[part] != theirs[part])


def fingerprint(
    curve: pd.DataFrame, metrics: Mapping[str, float], policy: Mapping[str, Tensor]
) -> Fingerprint:
    """Take the fingerprint of a run: its curve, its metrics, and its policy's parameters by name."""
    columns = {
        str(name): curve[name].to_numpy(dtype=np.float64) for name in curve if name not in _CURVE_TIMES
    }
    numbers = {name: np.float64(value) for name, value in metrics.items() if name not in _METRIC_TIMES}
    tensors = {name: tensor.cpu().numpy() for name, tensor in policy.items()}
    return Fingerprint(_digest(columns), _digest(numbers), _digest(tensors))


def of_metrics(metrics: Mapping[str, float]) -> Fingerprint:
    """Take the fingerprint of a row that has neither curve nor policy."""
    return Fingerprint(
        "", _digest({n: np.float64(v) for n, v in metrics.items() if n not in _METRIC_TIMES}), ""
    )


def _digest(arrays: Mapping[str, np.ndarray[Any, Any] | np.float64]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.array(arrays[name], ndmin=1)
        array[np.isnan(array)] = np.nan  # files keep that a number is missing, not with which bits
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:16]


def retrain_cells(
    cells: Sequence[str], budget: str, preset: str, seeds: Sequence[int]
) -> dict[str, Fingerprint]:
    """Train cells such as ``hallway/ah-ch`` as the registry has them; returns the fingerprints by run."""
    from benchmarks import registry
    from bgn.training.trainer import train_cell

    benchmark = registry.load()
    found = {}
    for cell in cells:
        domain, agent = cell.split("/")
        for result in train_cell(benchmark.cell(domain, agent, budget=budget, preset=preset), seeds):
            run = f"{cell}/seed-{result.seed}"  # as text: run ids had no type at first
            found[run] = fingerprint(result.curve, result.metrics, result.policy)
    return found


if __name__ == "__main__":
    fingerprints = retrain_cells(**json.load(sys.stdin))
    print(json.dumps({run: asdict(one) for run, one in fingerprints.items()}))
