"""The exact belief along one episode, for policies that are functions of the belief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bgn.domains.domain import Domain
from bgn.simulation.belief_rules import next_belief, start_belief


class BeliefTracker:
    """Tracks (x, b_Y) from observations and actions."""

    def __init__(self, domain: Domain) -> None:
        self._domain, self._model = domain, domain.model
        self.x = 0
        self.belief = np.full(self._model.n_hidden, 1 / self._model.n_hidden)

    def see(self, observation: int, last_action: int | None, *, fresh: bool) -> None:
        """Take in one observation; on an episode's first, start from the start distribution."""
        if fresh:
            self.x = self._arrival(self._model.joint.start, observation, action=0)
            self.belief = start_belief(self._domain, self.x)
        if last_action is None or (fresh and not self._domain.hidden_first_action):
            return
        here = slice(self.x * self._model.n_hidden, (self.x + 1) * self._model.n_hidden)
        arrival = self.belief @ self._model.joint.transitions[last_action][here]
        x_next = self._arrival(arrival, observation, last_action)
        self.belief = next_belief(
            self._domain, self.belief, last_action, observation, x=self.x, x_next=x_next
        )
        self.x = x_next

    def _arrival(self, probability: NDArray[np.float64], observation: int, action: int) -> int:
        """Return the x that an observation leaves possible among states of these probabilities."""
        if self._model.n_observed == 1:
            return 0
        seen = self._model.joint.observations[action][:, [observation]].toarray()[:, 0]
        return int((probability * seen).reshape(self._model.n_observed, -1).sum(axis=1).argmax())
