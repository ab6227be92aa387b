"""Units of work and how a worker does them.

A cell's missing seeds as one stack, one reference row, or what the rows of a cell still lack: their physics.
"""

from __future__ import annotations

import datetime
import pathlib
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from bgn.domains import from_file
from bgn.domains.episode_opening import EpisodeOpening
from bgn.domains.from_file import FileDomain
from bgn.results import provenance, schema
from bgn.results.atomic import write_atomically
from bgn.results.provenance import Origin
from bgn.results.run_ids import CellId, ReferenceId, RunId
from bgn.results.store import Kind, StorageError, Store, read_shard, writing_to
from bgn.training.cell import Beginning, CellSpec, DeviceLostError, Progress, RunResult
from bgn.training.physics_evaluation import has_physics

ProgressListener = Callable[[Progress], None]


class TrainCell(Protocol):
    """Trains the seeds of a cell as one stack; :func:`bgn.training.trainer.train_cell`."""

    def __call__(
        self,
        spec: CellSpec,
        seeds: Sequence[int],
        *,
        device: str = ...,
        checkpoint: pathlib.Path | None = ...,
        on_progress: ProgressListener | None = ...,
        physics: bool = ...,
        beginnings: Sequence[Beginning] = ...,
    ) -> list[RunResult]:
        """Return one result per seed."""


def train_cell(
    spec: CellSpec, seeds: Sequence[int], *, beginnings: Sequence[Beginning] = (), **options: Any
) -> list[RunResult]:
    """Call the trainer, importing torch only now, in the worker."""
    if beginnings:
        from bgn.training.beginnings import train_cell as lead

        return lead(spec, seeds, beginnings=beginnings, **options)
    from bgn.training.trainer import train_cell as train

    return train(spec, seeds, **options)


def save_policy(path: pathlib.Path, spec: CellSpec, tensors: Mapping[str, Any]) -> None:
    """Write a trained policy that needs only the history to act."""
    from bgn.policies.saved import save_policy as save

    save(
        path,
        tensors,
        domain=spec.domain,
        agent=spec.agent,
        hyperparameters=spec.hyperparameters,
        variant=spec.variant,
    )


def evaluate_in_physics(policy: pathlib.Path, spec: CellSpec, seed: int) -> Mapping[str, float]:
    """Evaluate a stored policy in physics; see :func:`bgn.training.physics_evaluation.evaluate_policy`."""
    from safetensors.torch import load_file

    from bgn.training.physics_evaluation import evaluate_policy

    return evaluate_policy(spec, load_file(policy), seed)


@dataclass(frozen=True, kw_only=True)
class ReferenceSpec:
    """Everything that determines the row of a policy that is not trained."""

    domain: str
    reference: str
    convention: EpisodeOpening
    episodes: int
    planning_backups: int
    planning_seconds: float
    seed: int

    @property
    def id(self) -> ReferenceId:
        """The id of the row, e.g. ``hallway/sarsop/clean``."""
        return ReferenceId(self.domain, self.reference, self.convention)


def evaluate_reference(spec: ReferenceSpec) -> Mapping[str, float]:
    """Evaluate a policy that is not trained, importing the planner only now, in the worker."""
    from bgn import domains
    from bgn.planning.reference_rows import evaluate_reference as evaluate

    return evaluate(
        spec.reference,
        domains.get(spec.domain),
        episodes=spec.episodes,
        seed=spec.seed,
        convention=spec.convention,
        backups=spec.planning_backups,
        timeout=spec.planning_seconds,
    )


@dataclass(frozen=True)
class Work:
    """What workers call to get the work done; picklable by reference."""

    train_cell: TrainCell = train_cell
    save_policy: Callable[[pathlib.Path, CellSpec, Mapping[str, Any]], None] = save_policy
    evaluate_reference: Callable[[ReferenceSpec], Mapping[str, float]] = evaluate_reference
    evaluate_in_physics: Callable[[pathlib.Path, CellSpec, int], Mapping[str, float]] = evaluate_in_physics


@dataclass(frozen=True, kw_only=True)
class _Task:
    origin: Origin
    budget: str
    preset: str
    store: pathlib.Path
    cost: float
    """Estimated work, in environment steps of the cheapest kind."""
    declared: FileDomain | None = None
    """The domain where a file defines it: a worker process knows only those that modules build."""


@dataclass(frozen=True, kw_only=True)
class CellTask(_Task):
    """Train the missing seeds of a cell together."""

    kind: ClassVar[Kind] = "runs"
    identity: ClassVar[schema.Columns] = schema.RUN_IDENTITY

    spec: CellSpec
    seeds: tuple[int, ...]
    device: str
    beginnings: tuple[Beginning, ...] = ()
    """Shorter runs of other budgets, to be left on the way."""

    @property
    def name(self) -> str:
        """The cell's id, e.g. ``hallway/ah-ch+bgn``."""
        return str(CellId(self.spec.domain, self.spec.agent))

    @property
    def runs(self) -> tuple[str, ...]:
        """The run ids it yields."""
        cell = CellId(self.spec.domain, self.spec.agent)
        return tuple(str(RunId(cell, seed)) for seed in self.seeds)


@dataclass(frozen=True, kw_only=True)
class ReferenceTask(_Task):
    """Evaluate one reference policy on one domain under one convention."""

    kind: ClassVar[Kind] = "references"
    identity: ClassVar[schema.Columns] = schema.REFERENCE_IDENTITY

    spec: ReferenceSpec

    @property
    def name(self) -> str:
        """The row's id, e.g. ``hallway/sarsop/clean``."""
        return str(self.spec.id)

    @property
    def runs(self) -> tuple[str, ...]:
        """The one id it yields."""
        return (self.name,)


@dataclass(frozen=True, kw_only=True)
class PhysicsTask(_Task):
    """Evaluate stored policies of a cell in physics, which their rows lack."""

    kind: ClassVar[Kind] = "runs"
    identity: ClassVar[schema.Columns] = schema.RUN_IDENTITY

    spec: CellSpec
    seeds: tuple[int, ...]
    device: str = "cpu"

    @property
    def name(self) -> str:
        """The cell's id and what is done, e.g. ``top-plate/ah-ch+bgn in physics``."""
        return f"{CellId(self.spec.domain, self.spec.agent)} in physics"

    @property
    def runs(self) -> tuple[str, ...]:
        """The run ids it fills in."""
        cell = CellId(self.spec.domain, self.spec.agent)
        return tuple(str(RunId(cell, seed)) for seed in self.seeds)


Task = CellTask | PhysicsTask | ReferenceTask


_FINISHED: Mapping[str, str | None] = {"status": "ok", "error": None, "traceback": None, "missing": None}


@dataclass(frozen=True)
class Failure:
    """Why a task yielded nothing."""

    error: str
    traceback: str
    started_at: datetime.datetime
    device_lost: bool = False
    """Whether nothing more can be done on the device in this process."""


def execute(task: Task, work: Work, on_progress: ProgressListener) -> Failure | None:
    """Do a task and store what it yields; a failure is stored, and returned, not raised.

    Raises
    ------
    StorageError
        Nothing more can be written, which is not the task's fault.
    """
    started_at = now()
    try:
        if task.declared is not None:
            from_file.declare(task.declared)
        with writing_to(task.store):
            if isinstance(task, CellTask):
                _train(task, work, started_at, on_progress)
            elif isinstance(task, PhysicsTask):
                _fill_in(task, work)
            else:
                _evaluate(task, work, started_at)
    except StorageError:
        raise
    except Exception as error:
        lost = isinstance(error, DeviceLostError)
        failure = Failure(f"{type(error).__name__}: {error}", traceback.format_exc(), started_at, lost)
        record_failure(task, failure)
        return failure
    return None


def record_failure(task: Task, failure: Failure) -> None:
    """Store one failed row for every run the task was to yield."""
    with writing_to(task.store):
        _record_failure(task, failure)


def _record_failure(task: Task, failure: Failure) -> None:
    store = Store(task.store)
    outcome = {"status": "failed", "error": failure.error, "traceback": failure.traceback, "missing": None}
    for values in _rows(task, outcome, failure.started_at):
        store.write_failure(task.kind, values["run"], schema.row(task.identity, values, {}))


def _train(task: CellTask, work: Work, started_at: datetime.datetime, listener: ProgressListener) -> None:
    store = Store(task.store)
    checkpoint = store.checkpoint(task.name, task.origin.key, task.seeds)
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    results = work.train_cell(
        task.spec,
        task.seeds,
        device=task.device,
        checkpoint=checkpoint,
        on_progress=listener,
        physics=task.device == "cpu",  # a GPU's cells run in threads, which must not wait for physics
        beginnings=task.beginnings,
    )
    if tuple(result.seed for result in results) != task.seeds:
        raise ValueError(f"asked for seeds {task.seeds}, got {[result.seed for result in results]}")
    for result, values in zip(results, _rows(task, _FINISHED, started_at), strict=True):
        _store_run(store, task, work, result, values)
    store.discard_checkpoints(task.name, task.seeds)


def _store_run(store: Store, task: CellTask, work: Work, result: RunResult, values: dict[str, Any]) -> None:
    run = values["run"]
    schema.check_metrics(run, result.metrics, schema.RUN_METRICS)
    if task.spec.physics_episodes and not set(schema.PHYSICS_METRICS) <= set(result.metrics):
        values |= {
            "missing": f"physics: {'not evaluated yet' if has_physics() else 'MuJoCo is not installed'}"
        }
    write_atomically(store.policy(run), lambda path: work.save_policy(path, task.spec, result.policy))
    store.write("curves", run, schema.curve_table(run, task.origin.key, result.curve))
    store.write(task.kind, run, schema.row(task.identity, values, result.metrics))


def _fill_in(task: PhysicsTask, work: Work) -> None:
    """Add to finished rows what they lack; all else of them stays as it is."""
    store = Store(task.store)
    for run, seed in zip(task.runs, task.seeds, strict=True):
        row = read_shard(store.shard(task.kind, run))
        metrics = work.evaluate_in_physics(store.policy(run), task.spec, seed)
        schema.check_metrics(run, metrics, schema.PHYSICS_METRICS)
        mujoco = provenance.environment()["version_mujoco"]
        assert not isinstance(mujoco, bool)
        store.write(task.kind, run, schema.filled_in(row, metrics, {"version_mujoco": mujoco}))


def _evaluate(task: ReferenceTask, work: Work, started_at: datetime.datetime) -> None:
    metrics = work.evaluate_reference(task.spec)
    schema.check_metrics(task.name, metrics, schema.REFERENCE_METRICS)
    (values,) = _rows(task, _FINISHED, started_at)
    Store(task.store).write(task.kind, task.name, schema.row(task.identity, values, metrics))


def _rows(
    task: Task, outcome: Mapping[str, str | None], started_at: datetime.datetime
) -> list[dict[str, Any]]:
    """Return the columns of each run of a task but for its metrics."""
    common: dict[str, Any] = {
        **outcome,
        **provenance.environment("cpu" if isinstance(task, ReferenceTask) else task.device),
        "budget": task.budget,
        "preset": task.preset,
        "key": task.origin.key,
        "spec_hash": task.origin.spec,
        "code_hash": task.origin.code,
        "data_hash": task.origin.data,
        "spec": provenance.spec_json(task.spec),
        "threads": 1,
        "started_at": started_at,
        "finished_at": max(started_at, now()),  # a clock may be set back
    }
    if isinstance(task, ReferenceTask):
        spec = task.spec
        identity = {"domain": spec.domain, "reference": spec.reference, "convention": spec.convention}
        own = {"run": task.name, "seed": spec.seed, "stack_seeds": [spec.seed], "device": "cpu"}
        return [{**common, **identity, **own}]
    cell = {"domain": task.spec.domain, "agent": task.spec.agent, "device": task.device}
    stack = {**common, **cell, "stack_seeds": list(task.seeds)}
    return [{**stack, "run": run, "seed": seed} for run, seed in zip(task.runs, task.seeds, strict=True)]


def now() -> datetime.datetime:
    """Return the time in UTC."""
    return datetime.datetime.now(datetime.UTC)
