"""What a policy is to every world it may act in: tables, physics, Gymnasium environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:  # physics needs no torch
    import torch

    from bgn.simulation.table_world import Inputs


class Policy(Protocol):
    """Acts on the history of one episode."""

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Forget the history: a new episode begins, in which a policy that samples uses ``generator``."""
        ...

    def act(self, observation: int, last_action: int | None) -> int:
        """Return the next action after ``last_action`` (None at a clean start) led to ``observation``."""
        ...


@runtime_checkable
class LanePolicy(Policy, Protocol):
    """A policy that keeps nothing in mind but the belief, and so acts in many lanes of a table world at once."""

    sees_beliefs: bool
    """Whether the world must track beliefs for it."""

    def act_in_lanes(self, inputs: Inputs, generator: torch.Generator) -> torch.Tensor:
        """Return the next action of every lane, shape (N,), int64."""
        ...
