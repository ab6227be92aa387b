"""A force-feedback domain on an arm as a Gymnasium environment: what a history-only policy sees is unchanged.

Observations and actions are those of ``bgn.environments.physics``. The belief is never computed here; ``info``
holds the observed part x, the hidden part as it was placed, the last action (|A| before the first) and the raw
finger angle in radians.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import InvalidAction, ResetNeeded

from bgn.domains.domain import Domain
from bgn.physics.tasks import Step, draw_start, task_of
from bgn.physics.world import observations
from bgn.robot.finger import ArmFinger
from bgn.robot.moves import MOVES

Information = dict[str, Any]


class ArmEnvironment(gymnasium.Env[np.int64, np.int64]):
    """One robot domain on a finger at an arm; ``reset`` takes ``options={"start": (x, y)}``."""

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's declaration)

    def __init__(self, domain: Domain, finger: ArmFinger) -> None:
        self.domain, self.finger = domain, finger
        self._task = task_of(domain.id)(domain, finger)
        self._seen = observations(domain)
        self._last_action = domain.model.joint.n_actions
        self._going, self._steps, self._y = False, 0, -1
        self.observation_space = spaces.Discrete(domain.model.joint.n_observations)
        self.action_space = spaces.Discrete(domain.model.joint.n_actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, Information]:
        """Begin an episode at ``options["start"]``, by default one drawn from the start distribution."""
        super().reset(seed=seed)
        x, self._y = (options or {}).get("start") or draw_start(self.domain, self.np_random)
        self._going, self._steps = False, 0
        step = self._task.reset(int(x), int(self._y))
        self._going, self._last_action = True, self.domain.model.joint.n_actions
        return self._tell(step)

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, Information]:
        """Take an action."""
        if not self._going:
            raise ResetNeeded("the episode is over or has not begun; call reset() first")
        if not self.action_space.contains(action):
            raise InvalidAction(f"action {action!r} is not in 0..{self.domain.model.joint.n_actions - 1}")
        self._going = False  # until the move has come to its end
        step = self._task.act(int(action))
        if int(action) not in MOVES[self.domain.id]:
            self.finger.grasp()
        self._last_action, self._steps = int(action), self._steps + 1
        truncated = not step.ended and self._steps >= self.domain.episode_limit
        self._going = not (step.ended or truncated)
        observation, information = self._tell(step)
        return observation, float(step.success), step.ended, truncated, information

    def _tell(self, step: Step) -> tuple[np.int64, Information]:
        information = {
            "observed": step.x,
            "hidden": self._y,
            "last_action": self._last_action,
            "angle": self.finger.measurement.angle,
        }
        return np.int64(self._seen[step.x]), information
