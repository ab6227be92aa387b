"""A tabular domain as a Gymnasium environment, with the exact belief and the state in ``info``.

Episode semantics, as in the paper's experiments (authors' code):

- ``reset`` draws s from the start distribution and, in the paper's domains, takes one hidden, uniformly random
  action, whose reward is dropped. The first observation is what that action showed; ``info["last_action"]`` is
  the action.
  With ``hidden_first_action=False`` an episode starts clean: the first observation is the extra index |Ω|,
  "none yet", and the last action is the extra index |A|.
- Reaching the goal, or RockSample's terminal state, does not end the episode; the next action does,
  whichever it is, with reward 0 (``reset`` rows of the model). That step shows nothing new: observation,
  state and belief stay.
- The step limit truncates (Gymnasium's ``TimeLimit``, from ``max_episode_steps``); the hidden action is not
  counted.

Vector environments of ``gymnasium.make_vec`` use Gymnasium's next-step autoreset: the step after the end of
an episode ignores its action, returns reward 0 and the next episode's first observation. So at a truncation
the observation and the belief to bootstrap from are those returned with it.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import InvalidAction, ResetNeeded
from numpy.typing import NDArray
from scipy import sparse

from bgn.domains import registry
from bgn.domains.layout import GridLayout
from bgn.errors import InputError
from bgn.pictures import maps
from bgn.pomdp.belief import update

Render = NDArray[np.uint8] | str


class TableEnvironment(gymnasium.Env[np.int64, np.int64]):
    """One episode at a time of a domain without observed part.

    Parameters
    ----------
    domain_id
        Its name in ``bgn.domains``.
    hidden_first_action
        Open every episode with an unseen random action; see the module's description. None: as the domain's
        agents see it.
    render_mode
        ``"ansi"`` (a text) or, of a domain with a map, ``"rgb_array"`` (a picture).
    """

    metadata = {"render_modes": ["ansi", "rgb_array"], "render_fps": 2}  # noqa: RUF012  (Gymnasium's declaration)

    def __init__(
        self, domain_id: str, *, hidden_first_action: bool | None = None, render_mode: str | None = None
    ) -> None:
        domain = registry.get(domain_id)
        if domain.model.n_observed != 1:
            raise InputError(f"{domain_id} has an observed part; expected a plain POMDP")
        if not isinstance(domain.layout, GridLayout):
            self.metadata = self.metadata | {"render_modes": ["ansi"]}
        if render_mode not in (None, *self.metadata["render_modes"]):
            known = " or ".join(map(repr, self.metadata["render_modes"]))
            raise InputError(f"no render mode {render_mode!r} for {domain_id}; expected {known}")
        self.domain = domain
        self.hidden_first_action = (
            domain.hidden_first_action if hidden_first_action is None else hidden_first_action
        )
        self.render_mode = render_mode
        self._model = domain.model.joint
        unseen = 0 if self.hidden_first_action else 1
        self.observation_space = spaces.Discrete(self._model.n_observations + unseen)
        self.action_space = spaces.Discrete(self._model.n_actions)
        self._going = False
        self._observation = self._last_action = self._state = 0
        self._belief = self._model.start

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, dict[str, Any]]:
        """Start an episode; ``options`` are ignored."""
        super().reset(seed=seed)
        self._going = True
        self._belief = self._model.start
        (possible,) = self._belief.nonzero()
        self._state = self._draw(possible, self._belief[possible])
        self._observation, self._last_action = self._model.n_observations, self._model.n_actions
        if self.hidden_first_action:
            self._move(int(self.np_random.integers(self._model.n_actions)), ended=None)
        return self._seen()

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, dict[str, Any]]:
        """Take an action; the reward is the realised R(a, s, s', o)."""
        if not self._going:
            raise ResetNeeded("the episode is over or has not begun; call reset() first")
        if not self.action_space.contains(action):
            raise InvalidAction(f"action {action!r} is not in 0..{self._model.n_actions - 1}")
        if self._model.reset[action, self._state]:
            self._going = False
            self._last_action = int(action)
            reward = float(self._model.expected_rewards[action, self._state])
        else:
            reward = self._move(int(action), ended=False)
        observation, info = self._seen()
        return observation, reward, not self._going, False, info

    def render(self) -> Render | None:
        """Show the map where there is one, the true state and the belief."""
        layout = self.domain.layout
        if self.render_mode is None:
            return None
        if self.render_mode == "rgb_array":
            assert isinstance(layout, GridLayout)
            return maps.draw(layout, self._state, self._belief)
        names = self._model
        shown = (*names.observation_names, "none")[self._observation]
        action = (*names.action_names, "none")[self._last_action]
        belief = f"belief in the true state {self._belief[self._state]:.3f}"
        summary = f"{names.state_names[self._state]} after {action}, observing {shown}; {belief}"
        drawing = f"{maps.text(layout, self._state)}\n" if isinstance(layout, GridLayout) else ""
        return f"{drawing}{summary}\n"

    def _move(self, action: int, *, ended: bool | None) -> float:
        """Draw s' and o, update the belief and return R(a, s, s', o)."""
        state, model = self._state, self._model
        self._state = self._draw(*_row(model.transitions[action], state))
        self._observation = self._draw(*_row(model.observations[action], self._state))
        self._last_action = action
        self._belief = update(model, self._belief, action, self._observation, ended=ended)
        index = (action, state, self._state, self._observation)
        return float(
            model.rewards[tuple(min(i, n - 1) for i, n in zip(index, model.rewards.shape, strict=True))]
        )

    def _draw(self, outcomes: NDArray[np.integer[Any]], probabilities: NDArray[np.float64]) -> int:
        bounds = probabilities.cumsum()
        at = np.searchsorted(bounds[:-1], self.np_random.random() * bounds[-1], side="right")
        return int(outcomes[at])

    def _seen(self) -> tuple[np.int64, dict[str, Any]]:
        info = {"state": self._state, "belief": self._belief.copy(), "last_action": self._last_action}
        return np.int64(self._observation), info


def _row(table: sparse.csr_array, row: int) -> tuple[NDArray[np.integer[Any]], NDArray[np.float64]]:
    """Return the columns and the probabilities of one row of a table."""
    part = slice(table.indptr[row], table.indptr[row + 1])
    return table.indices[part], table.data[part]
