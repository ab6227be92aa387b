"""A trainer and a planner that take no time, for testing what surrounds them."""

from __future__ import annotations

import ctypes
import errno
import os
import pathlib
import signal
import sys
import time
from collections.abc import Mapping, Sequence

import safetensors.numpy

from benchmarks import registry
from benchmarks.plan import Selection
from benchmarks.tasks import ProgressListener, ReferenceSpec, Work, execute
from bgn.results import schema
from bgn.results.store import Store
from bgn.training.cell import Beginning, CellSpec, DeviceLostError, Progress, RunResult

FAILING_AGENT, DYING_AGENT = "ah-cs", "ab-cb"


def train_cell(
    spec: CellSpec,
    seeds: Sequence[int],
    *,
    device: str = "cpu",
    checkpoint: pathlib.Path | None = None,
    on_progress: ProgressListener | None = None,
    physics: bool = True,
    beginnings: Sequence[Beginning] = (),
) -> list[RunResult]:
    assert on_progress is not None
    for done in (spec.env_steps // 2, spec.env_steps):
        on_progress(Progress(done, spec.env_steps, 1000.0, 0.5))
    return [_result(spec, seed, physics) for seed in seeds]


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
    physics: bool,
    beginnings: Sequence[Beginning] = (),
) -> list[RunResult]:
    """Write a checkpoint and go on for ever; finish at once where there is one."""
    if not checkpoint.exists():
        checkpoint.write_text(str(os.getpid()))
        while True:
            on_progress(Progress(0, spec.env_steps, 0.0, 0.0))
            time.sleep(0.05)
    return train_cell(spec, seeds, on_progress=on_progress)


def lose_the_device(
    spec: CellSpec, seeds: Sequence[int], *, checkpoint: pathlib.Path, **options: object
) -> list[RunResult]:
    """Fail as a GPU does, once two other cells are running; these hang until they find a checkpoint."""
    root = checkpoint.parents[3]
    if spec.agent == FAILING_AGENT:
        while len(said(root, "began")) < 2:
            time.sleep(0.02)
        raise DeviceLostError("an illegal memory access was encountered")
    if not checkpoint.exists():
        checkpoint.write_text("half")
        say(root, "began", str(os.getpid()))
        while True:
            time.sleep(0.02)
    say(root, "resumed", str(os.getpid()))
    return train_cell(spec, seeds, **options)  # type: ignore[arg-type]


def fill_the_disk(spec: CellSpec, seeds: Sequence[int], **options: object) -> list[RunResult]:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def ask_the_environment(
    spec: CellSpec, seeds: Sequence[int], *, checkpoint: pathlib.Path, **options: object
) -> list[RunResult]:
    root = checkpoint.parents[3]
    say(root, "connections", os.environ["CUDA_DEVICE_MAX_CONNECTIONS"])
    say(root, "threads", os.environ["OMP_NUM_THREADS"])
    return train_cell(spec, seeds, **options)  # type: ignore[arg-type]


def say(root: pathlib.Path, what: str, text: str) -> None:
    """Leave a message for the test, from whatever process."""
    with (root / f"{what}.txt").open("a", encoding="utf-8") as file:
        file.write(text + "\n")


def said(root: pathlib.Path, what: str) -> list[str]:
    path = root / f"{what}.txt"
    return path.read_text(encoding="utf-8").split() if path.exists() else []


def save_policy(path: pathlib.Path, spec: CellSpec, tensors: Mapping[str, object]) -> None:
    path.write_bytes(safetensors.numpy.save({}, metadata={"agent": spec.agent}))


def die_between_two_results(path: pathlib.Path, spec: CellSpec, tensors: Mapping[str, object]) -> None:
    """Store the first seed's policy; be killed while storing the second's."""
    if "seed-1" in path.name:
        os.kill(os.getpid(), signal.SIGKILL)
    save_policy(path, spec, tensors)


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


def say_nothing(spec: ReferenceSpec) -> dict[str, float]:
    """Work for ever, as deep in compiled code as a planner; its process id is left where a test looks."""
    folder = pathlib.Path(sys.argv[sys.argv.index("--results") + 1])
    (folder / "silent.checkpoint").write_text(str(os.getpid()))
    ctypes.PyDLL(None).pause()  # a PyDLL keeps the interpreter's lock: no thread of this process gets a turn
    return {}


def evaluate_in_physics(policy: pathlib.Path, spec: CellSpec, seed: int) -> dict[str, float]:
    assert policy.exists()
    return dict.fromkeys(schema.PHYSICS_METRICS, 0.25 + seed)


def _result(spec: CellSpec, seed: int, physics: bool) -> RunResult:
    value = 0.5 + 0.01 * seed
    metrics = dict.fromkeys(schema.RUN_METRICS, value)
    if physics and spec.physics_episodes:
        metrics |= dict.fromkeys(schema.PHYSICS_METRICS, value)
    points = [dict.fromkeys(schema.CURVE_COLUMNS, share * value) for share in (0.0, 0.5, 1.0)]
    return RunResult(seed=seed, points=points, metrics=metrics, policy={})


WORKING = Work(train_cell, save_policy, evaluate_reference, evaluate_in_physics)
SILENT = Work(train_cell, save_policy, say_nothing, evaluate_in_physics)
HANGING = Work(hang_before_checkpoint, save_policy, evaluate_reference, evaluate_in_physics)  # type: ignore[arg-type]
HALVING = Work(train_cell, die_between_two_results, evaluate_reference, evaluate_in_physics)
BREAKING = Work(train_or_fail, save_policy, evaluate_reference, evaluate_in_physics)
LOSING = Work(lose_the_device, save_policy, evaluate_reference, evaluate_in_physics)  # type: ignore[arg-type]
FULL = Work(fill_the_disk, save_policy, evaluate_reference, evaluate_in_physics)
ASKING = Work(ask_the_environment, save_policy, evaluate_reference, evaluate_in_physics)  # type: ignore[arg-type]
