"""The policy that takes every action with the same probability."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from bgn.domains.domain import Domain
from bgn.simulation.table_world import Inputs


class RandomPolicy:
    """Uniformly random actions, whatever is seen."""

    sees_beliefs = False

    def __init__(self, domain: Domain) -> None:
        self._n_actions = domain.model.joint.n_actions
        self.reset()

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Draw this episode's actions from ``generator``."""
        self._generator = generator or np.random.default_rng(0)

    def act(self, observation: int, last_action: int | None) -> int:
        """Return a random action."""
        return int(self._generator.integers(self._n_actions))

    def act_in_lanes(self, inputs: Inputs, generator: torch.Generator) -> Tensor:
        """Return a random action for every lane."""
        return torch.randint(self._n_actions, inputs.state.shape, generator=generator)
