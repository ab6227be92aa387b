"""Trains one cell of the benchmark: all its seeds as one stack, from first step to final evaluation."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from bgn import domains
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.errors import BgnError
from bgn.training import checkpoint as checkpoints
from bgn.training.cell import CellSpec, Interrupted, Progress, RunResult
from bgn.training.cuda import lost_devices, own_stream
from bgn.training.evaluation import evaluate
from bgn.training.learners import make_learner
from bgn.training.physics_evaluation import evaluate_policy, has_physics
from bgn.training.update_runner import UpdateRunner

#: Points of a curve: half of them spaced evenly, half by powers, so that the start is dense.
CURVE_POINTS = 240
CHECKPOINT_SECONDS = 30.0
PROGRESS_SECONDS = 0.3

OnProgress = Callable[[Progress], None]
_LOG = logging.getLogger(__name__)


class CheckpointMismatchError(BgnError, ValueError):
    """A checkpoint that belongs to other work than what is to be resumed from it."""


def train_cell(
    spec: CellSpec,
    seeds: Sequence[int],
    *,
    device: str = "cpu",
    checkpoint: Path | None = None,
    on_progress: OnProgress | None = None,
    physics: bool = True,
) -> list[RunResult]:
    """Train and evaluate one run per seed.

    Final policies of robot domains are also run in MuJoCo, unless ``physics`` is false or MuJoCo is not there; their
    metrics then lack what :func:`bgn.training.physics_evaluation.evaluate_policy` can add later.

    Torch uses one thread meanwhile, so that the result does not depend on how many there are: run cells side
    by side instead. With ``checkpoint``, progress is saved there every half minute and taken up from there if
    the file exists; the result is bit-identical to an uninterrupted one.

    Raises
    ------
    CheckpointMismatchError
        The checkpoint was written for another specification or other seeds.
    bgn.training.cell.DeviceLostError
        The GPU failed; nothing else can be run on it in this process.
    """
    where = torch.device(device)
    with one_thread(), lost_devices(where), own_stream(where):
        return Stack(spec, tuple(seeds), where, checkpoint, on_progress, physics).run()


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep to one thread: products and factorisations add up in an order that depends on the number."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class Stack:
    """A stack of runs on its way."""

    def __init__(
        self,
        spec: CellSpec,
        seeds: tuple[int, ...],
        device: torch.device,
        checkpoint: Path | None,
        on_progress: OnProgress | None,
        physics: bool,
    ) -> None:
        self.spec, self.seeds, self.checkpoint, self.on_progress = spec, seeds, checkpoint, on_progress
        self.physics = physics and spec.physics_episodes > 0 and has_physics()
        self.domain = domains.get(spec.domain, **spec.variant)
        settings = spec.hyperparameters
        self.learner = make_learner(agent(spec.agent), self.domain, settings, seeds, device)
        self.steps_per_update = self.learner.shape.lanes * self.learner.shape.steps
        self.updates = math.ceil(spec.env_steps / self.steps_per_update)
        self.runner = UpdateRunner(self.learner, self.updates, tf32=settings.tf32)
        self.curves: list[list[dict[str, float]]] = [[] for _ in seeds]
        self.done = 0
        self.wall_seconds = self.cpu_seconds = 0.0
        self._resume()

    def run(self) -> list[RunResult]:
        """Train to the end and evaluate; returns one result per seed."""
        try:
            with closing(self.runner):
                self._train()
            self._save()  # to evaluate takes long enough to be interrupted, too
            return [self._evaluated(i) for i in range(len(self.seeds))]
        except Interrupted:
            self._save()
            raise

    def _evaluated(self, i: int) -> RunResult:
        self._report(stage="evaluate")
        return self._result(i, self.learner.networks_of(i))

    def _train(self) -> None:
        points = curve_points(self.updates)
        clock, saved, reported = _Clock(self), time.monotonic(), 0.0
        while self.done < self.updates:
            self.runner.update(self.done)
            self.done += 1
            if self.done in points:
                clock.tick()
                self._add_point()
            now = time.monotonic()
            if now - reported > PROGRESS_SECONDS:
                clock.tick()
                self._report()
                reported = now
            if now - saved > CHECKPOINT_SECONDS:
                clock.tick()
                self._save()
                saved = now
        clock.tick()

    def _add_point(self) -> None:
        readings = self.learner.recorder.read()
        for i, curve in enumerate(self.curves):
            curve.append(
                {
                    "env_steps": self.done * self.steps_per_update,
                    "return_100": readings.return_100[i],
                    "success_100": readings.success_100[i],
                    "episodes": readings.episodes[i],
                    **{name: values[i] for name, values in readings.losses.items()},
                    "seconds": self.wall_seconds,
                }
            )

    def _report(self, stage: str = "train") -> None:
        if self.on_progress is None:
            return
        steps = self.done * self.steps_per_update
        speed = steps * len(self.seeds) / self.wall_seconds if self.wall_seconds else 0.0
        latest = [curve[-1]["return_100"] for curve in self.curves if curve]
        mean = sum(latest) / len(latest) if latest else math.nan
        self.on_progress(Progress(steps, self.updates * self.steps_per_update, speed, mean, stage))

    def _result(self, i: int, networks: AgentNetworks) -> RunResult:
        last = self.curves[i][-1]
        metrics = {"train_return": last["return_100"], "train_success": last["success_100"]}
        for name, greedy in (("sampled", False), ("greedy", True)):
            summary = evaluate(
                networks,
                self.domain,
                self.spec.hyperparameters,
                self.spec.evaluation_episodes,
                greedy=greedy,
            )
            metrics |= {f"{name}_{k}": v for k, v in summary.items()}
        names = networks.actor_parameters()
        policy = {n: t for n, t in networks.parameters.of_seed(0).items() if n in names}
        if self.physics:
            metrics |= evaluate_policy(self.spec, policy, self.seeds[i])
        metrics |= {
            "env_steps_per_second": self.updates
            * self.steps_per_update
            * len(self.seeds)
            / self.wall_seconds,
            "wall_seconds": self.wall_seconds / len(self.seeds),
            "cpu_seconds": self.cpu_seconds / len(self.seeds),
        }
        return RunResult(seed=self.seeds[i], points=self.curves[i], metrics=metrics, policy=policy)

    def _identity(self) -> dict[str, Any]:
        spec = asdict(replace(self.spec, variant=dict(self.spec.variant)))
        return {"spec": spec, "seeds": list(self.seeds)}

    def _save(self) -> None:
        if self.checkpoint is None:
            return
        checkpoints.save(self.checkpoint, self._content())

    def _content(self) -> dict[str, Any]:
        return self._identity() | {
            "state": dict(self.learner.state()),
            "done": self.done,
            "curves": self.curves,
            "seconds": [self.wall_seconds, self.cpu_seconds],
        }

    def _resume(self) -> None:
        if self.checkpoint is None:
            return
        try:
            self._load(self.checkpoint)
        except checkpoints.DamagedCheckpointError as error:
            aside = checkpoints.set_aside(self.checkpoint)
            _LOG.warning("%s; it is set aside as %s, and its runs start over", error, aside.name)

    def _load(self, path: Path) -> None:
        content = checkpoints.load(path)
        if content is None:
            return
        for key, mine in self._identity().items():
            if content.get(key, mine) != mine:
                found = f"{path} is for other {key}: {content[key]}, not {mine}"
                raise CheckpointMismatchError(f"{found}; delete it to start over")
        checkpoints.check(path, content, self._content())
        self.learner.load_state(content["state"])
        self.done, self.curves = content["done"], content["curves"]
        self.wall_seconds, self.cpu_seconds = content["seconds"]


class _Clock:
    """Adds the time since it last ticked to a stack's wall and CPU seconds."""

    def __init__(self, stack: Stack) -> None:
        self.stack, self.wall, self.cpu = stack, time.perf_counter(), time.thread_time()

    def tick(self) -> None:
        wall, cpu = time.perf_counter(), time.thread_time()
        self.stack.wall_seconds += wall - self.wall
        self.stack.cpu_seconds += cpu - self.cpu
        self.wall, self.cpu = wall, cpu


def curve_points(updates: int) -> frozenset[int]:
    """Return the updates after which a point of the curve is taken: dense early, and always the last."""
    half = CURVE_POINTS // 2
    even = {max(1, round(updates * i / half)) for i in range(1, half + 1)}
    powers = {max(1, round(updates ** (i / half))) for i in range(half + 1)}
    return frozenset(even | powers | {updates})
