"""Shorter runs on the way of a longer one: equal settings and seeds make equal first steps.

Where nothing that an agent learns from depends on how long its run is, a shorter run is the beginning of a longer one,
bit for bit, but for where the points of its curve are. A stack that is told of shorter ones writes the checkpoints that
they would end with, and they need only be evaluated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from bgn.training.cell import Beginning, CellSpec, RunResult
from bgn.training.cuda import lost_devices, own_stream
from bgn.training.trainer import OnProgress, Stack, curve_points, one_thread
from bgn.training.update_runner import UpdateRunner


def may_begin(short: CellSpec, long: CellSpec) -> bool:
    """Say whether two specifications differ only in their length and in how the final policy is evaluated.

    Whether a schedule depends on the length, the stack finds out by itself.
    """
    lengths = {name: getattr(long, name) for name in ("env_steps", "evaluation_episodes", "physics_episodes")}
    return short.env_steps < long.env_steps and replace(short, **lengths) == long


def train_cell(
    spec: CellSpec,
    seeds: Sequence[int],
    *,
    beginnings: Sequence[Beginning],
    device: str = "cpu",
    checkpoint: Path | None = None,
    on_progress: OnProgress | None = None,
    physics: bool = True,
) -> list[RunResult]:
    """Train a cell as :func:`bgn.training.trainer.train_cell` does, with checkpoints of shorter runs left on the way.

    A beginning whose schedule depends on the length of the run, or which this stack has passed already, is left out:
    nothing is left for it, and it has to be trained by itself.

    Raises
    ------
    bgn.training.trainer.CheckpointMismatchError, bgn.training.cell.DeviceLostError
        As there.
    """
    where = torch.device(device)
    with one_thread(), lost_devices(where), own_stream(where):
        stack = _LeadingStack(spec, tuple(seeds), where, checkpoint, on_progress, physics)
        stack.lead(beginnings)
        return stack.run()


class _LeadingStack(Stack):
    """A stack that takes shorter ones along."""

    followers: Sequence[_FollowingStack] = ()

    def lead(self, beginnings: Sequence[Beginning]) -> None:
        """Take along those beginnings that lie ahead."""
        stacks = [_FollowingStack(beginning, self) for beginning in beginnings]
        self.followers = [stack for stack in stacks if stack.lies_ahead()]
        self.runner = _LeadingRunner(self)

    def _save(self) -> None:
        for follower in self.followers:  # first, so that none is ever behind
            follower.save_along()
        super()._save()


class _LeadingRunner(UpdateRunner):
    """Tells the shorter stacks of every update."""

    def __init__(self, stack: _LeadingStack) -> None:
        super().__init__(stack.learner, stack.updates, tf32=stack.spec.hyperparameters.tf32)
        self._stack = stack

    def update(self, index: int) -> None:
        """Run an update, and let the stacks that it belongs to take note of it."""
        recorder = self.learner.recorder
        before = recorder.losses.clone()
        recorder.losses.zero_()
        super().update(index)
        of_update = recorder.losses.clone()
        recorder.losses.add_(before)
        for follower in self._stack.followers:
            if follower.done == index < follower.updates:
                follower.follow(of_update)


class _FollowingStack(Stack):
    """A shorter stack, of all or some of a longer one's seeds, which learns nothing by itself.

    Its learner is a place for what the longer one's holds; only the curve's mean losses are its own, since they are
    taken between its own points.
    """

    def __init__(self, beginning: Beginning, leader: _LeadingStack) -> None:
        device = leader.learner.device
        beginning.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        super().__init__(beginning.spec, beginning.seeds, device, beginning.checkpoint, None, physics=False)
        self.leader = leader
        self.rows = torch.tensor([leader.seeds.index(seed) for seed in self.seeds], device=device)
        self.points = curve_points(self.updates)

    def lies_ahead(self) -> bool:
        """Say whether the longer stack will do what this one still lacks."""
        mine, theirs = (stack.learner.schedule(stack.updates) for stack in (self, self.leader))
        return (
            self.leader.done <= self.done < self.updates
            and torch.equal(mine, theirs[: self.updates])
            and self._can_be_taken()
        )

    def _can_be_taken(self) -> bool:
        """Say whether these seeds can be told apart in the longer stack's state."""
        if len(self.seeds) == len(self.leader.seeds):
            return self.seeds == self.leader.seeds
        return self.learner.state().keys() == self.leader.learner.state().keys()

    def follow(self, losses: Tensor) -> None:
        """Count the longer stack's latest update, whose ``losses`` are (S, k), as an own one."""
        recorder = self.learner.recorder
        recorder.losses += losses[self.rows]
        recorder.updates += 1
        self.done += 1
        if self.done in self.points:
            self._take_over()
            self._add_point()
        if self.done == self.updates:
            self._save()

    def save_along(self) -> None:
        """Write a checkpoint while the longer stack does, unless this one is ahead of it or at its end."""
        if self.leader.done == self.done < self.updates:
            self._take_over()
            self._save()

    def _take_over(self) -> None:
        """Stand where the longer stack stands, but for the losses."""
        recorder = self.learner.recorder
        own = recorder.losses.clone(), recorder.updates.clone()
        self.learner.load_state(_of_rows(self.leader.learner.state(), self.learner.state(), self.rows))
        recorder.losses.copy_(own[0])
        recorder.updates.copy_(own[1])
        share = len(self.seeds) / len(self.leader.seeds)
        self.wall_seconds = self.leader.wall_seconds * share
        self.cpu_seconds = self.leader.cpu_seconds * share


def _of_rows(state: Mapping[str, Tensor], like: Mapping[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
    """Take some seeds' part of a stack's state, shaped ``like`` that of a stack of them alone."""
    return {name: _rows_of(tensor, like[name].shape, rows) for name, tensor in state.items()}


def _rows_of(tensor: Tensor, shape: torch.Size, rows: Tensor) -> Tensor:
    """Take some seeds' part of a tensor: of the one axis along which the seeds lie, each with as many entries."""
    axes = [axis for axis, size in enumerate(shape) if tensor.shape[axis] != size]
    if not axes:  # the same seeds, or nothing of a seed's own
        return tensor
    (axis,) = axes
    entries = torch.arange(tensor.shape[axis], device=tensor.device).view(-1, shape[axis] // len(rows))
    return tensor.index_select(axis, entries[rows].flatten())
