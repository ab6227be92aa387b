"""What the trainer asks of an algorithm, and the only thing it knows about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import AgentSpec
from bgn.domains.domain import Domain
from bgn.training.recorder import Recorder


class UpdateShape(NamedTuple):
    """What one update works on: in every lane of every seed, ``steps`` steps with ``variates`` numbers each."""

    steps: int
    lanes: int
    """Of one seed."""
    variates: int
    """Uniform variates that a lane consumes per step."""


class Learner(Protocol):
    """A stack of runs of one cell that differ only in their seed, and the algorithm that trains them.

    On a GPU the trainer captures :meth:`update` as one CUDA graph: there it must never wait for the device, no
    shape in it may depend on data, and all state that it carries from one call to the next must live in tensors
    that keep their place.
    """

    @property
    def seeds(self) -> tuple[int, ...]:
        """The runs' seeds, S of them."""

    @property
    def device(self) -> torch.device:
        """Where all tensors live."""

    @property
    def shape(self) -> UpdateShape:
        """How many steps an update makes, in how many lanes, and how many random numbers these take."""

    @property
    def recorder(self) -> Recorder:
        """What a learning curve shows: returns, and the losses this algorithm reports."""

    def schedule(self, total_updates: int) -> Tensor:
        """Return what changes with an update's place in the run, row by row: (``total_updates``, …)."""

    def update(self, variates: Tensor, scheduled: Tensor) -> None:
        """Act and learn once, with ``variates`` (steps, S * lanes, variates) and a row of :meth:`schedule`."""

    def state(self) -> Mapping[str, Tensor]:
        """Return all tensors that the rest of the run depends on: a checkpoint's content."""

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from what :meth:`state` returned in an equal learner."""

    def networks_of(self, row: int) -> AgentNetworks:
        """Copy the networks of one seed (by its place in ``seeds``) out of the stack."""


class MakeLearner(Protocol):
    """Builds a learner; ``hyperparameters`` are of the type that the algorithm takes."""

    def __call__(
        self,
        spec: AgentSpec,
        domain: Domain,
        hyperparameters: Any,
        seeds: tuple[int, ...],
        device: torch.device,
        /,
    ) -> Learner:
        """Return a new stack of runs."""
