"""A trainer and a planner that take no time, for testing what surrounds them."""

from __future__ import annotations

import os
import pathlib
import signal
import time
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from benchmarks import registry
from benchmarks.plan import Selection
from benchmarks.tasks import ProgressListener, ReferenceSpec, Work, execute
from bgn.results import schema
from bgn.results.store import Store
from bgn.training.cell import CellSpec, Progress, RunResult

FAILING_AGENT, DYING_AGENT = "ah-cs", "ab-cb"


def train_cell(
    spec: CellSpec,
    seeds: Sequence[int],
    *,
    device: str = "cpu",
    checkpoint: pathlib.Path | None = None,
    on_progress: ProgressListener | None = None,
) -> list[RunResult]:
    assert on_progress is not None
    for done in (spec.env_steps // 2, spec.env_steps):
        on_progress(Progress(done, spec.env_steps, 1000.0, 0.5))
    return [_result(spec, seed) for seed in seeds]


def train_or_fail(spec: CellSpec, seeds: Sequence[int], **options: object) -> list[RunResult]:
    if spec.agent == FAILING_AGENT:
        raise FloatingPointError("the loss is NaN")
    if spec.agent == DYING_AGENT:
        os.kill(os.getpid(), signal.SIGKILL)
    return train_cell(spec, seeds, **options)  # type: ignore[arg-type]


def hang_before_checkpoint(
    spec: CellSpec,
    seeds: Sequence[int],
    *,
    checkpoint: pathlib.Path,
    on_progress: ProgressListener,
    device: str,
) -> list[RunResult]:
    """Write a checkpoint and go on for ever; finish at once where there is one."""
    if not checkpoint.exists():
        checkpoint.write_text(str(os.getpid()))
        while True:
            on_progress(Progress(0, spec.env_steps, 0.0, 0.0))
            time.sleep(0.05)
    return train_cell(spec, seeds, on_progress=on_progress)


def save_policy(path: pathlib.Path, spec: CellSpec, tensors: Mapping[str, object]) -> None:
    path.write_bytes(spec.agent.encode())


def evaluate_reference(spec: ReferenceSpec) -> dict[str, float]:
    value = {"random": -1.0, "sarsop": 1.0}.get(spec.reference, 0.5)
    return {"return": value, "return_se": 0.01, "return_sd": 0.3}


def fill(results: pathlib.Path, work: Work, *, domain: str, agent: str, reference: str) -> Store:
    """Store two runs of a cell and the rows of a reference policy, in this process; returns the store."""
    known = registry.load()
    chosen = Selection(
        registry=known,
        budget="smoke",
        preset=known.defaults.preset,
        domains=(domain,),
        agents=(agent,),
        references=(reference,),
        seeds=(0, 1),
    )
    store = chosen.store(results)
    for task in chosen.tasks(chosen.requests(), store, "cpu"):
        assert execute(task, work, lambda _: None) is None
    return store


def _result(spec: CellSpec, seed: int) -> RunResult:
    value = 0.5 + 0.01 * seed
    metrics = dict.fromkeys(schema.RUN_METRICS, value)
    curve = pd.DataFrame({name: np.linspace(0.0, value, 3) for name in schema.CURVE_COLUMNS})
    return RunResult(seed=seed, curve=curve, metrics=metrics, policy={})


WORKING = Work(train_cell, save_policy, evaluate_reference)
HANGING = Work(hang_before_checkpoint, save_policy, evaluate_reference)  # type: ignore[arg-type]
BREAKING = Work(train_or_fail, save_policy, evaluate_reference)
