"""A force-feedback domain in MuJoCo as a Gymnasium environment.

An observation is the index of the finger's reading (cell and angle bin); ``info`` holds what training may
use beside it: the joint state x * |Y| + y, its parts, the belief over y, the last action (|A| before the
first) and the raw finger angle in radians. An episode is truncated at the limit of the domain's variant, so
no ``TimeLimit`` is needed. Everything is a function of the seed of ``reset``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import InvalidAction, ResetNeeded

from bgn import domains
from bgn.errors import InputError
from bgn.physics.scene import MOVE_STEPS, SETTLE_STEPS, TIMESTEP
from bgn.physics.world import PhysicsWorld
from bgn.pictures.camera import Camera, Image, Window

Information = dict[str, Any]


class PhysicsEnvironment(gymnasium.Env[np.int64, np.int64]):
    """One robot domain in physics.

    Parameters
    ----------
    domain_id
        Its name in ``bgn.domains``.
    render_mode
        ``"rgb_array"`` (a picture of the scene as it is) or ``"human"`` (a window that shows every move).
    width, height
        Pixels of a picture.
    variant
        Keywords of the domain's builder, such as ``variant="authors"`` or ``plates=5``.

    Raises
    ------
    ValueError
        The domain has no physics or no such variant, or the render mode is unknown.
    """

    metadata = {  # noqa: RUF012  (Gymnasium's declaration)
        "render_modes": ["rgb_array", "human"],
        "render_fps": round(1 / ((MOVE_STEPS + SETTLE_STEPS) * TIMESTEP)),
    }

    def __init__(
        self,
        domain_id: str,
        *,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        **variant: str | int | float | bool,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"no render mode {render_mode!r}; expected 'rgb_array' or 'human'")
        self.domain = domains.get(domain_id, **variant)
        self.world = PhysicsWorld(self.domain)
        self.render_mode = render_mode
        self._size = (width, height)
        self._camera: Camera | None = None
        self._window: Window | None = None
        self._last_action = self.domain.model.joint.n_actions
        self._going = False
        self.observation_space = spaces.Discrete(self.domain.model.joint.n_observations)
        self.action_space = spaces.Discrete(self.domain.model.joint.n_actions)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, Information]:
        """Begin an episode; ``options`` are ignored."""
        super().reset(seed=seed)
        self.world.reset(self.np_random)
        self._going = True
        self._last_action = self.domain.model.joint.n_actions
        if self.render_mode == "human":
            self._show()
        return self._seen()

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, Information]:
        """Take an action: a move takes half a second of simulated time."""
        if not self._going:
            raise ResetNeeded("the episode is over or has not begun; call reset() first")
        if not self.action_space.contains(action):
            raise InvalidAction(f"action {action!r} is not in 0..{self.domain.model.joint.n_actions - 1}")
        self._last_action = int(action)
        state = self.world.step(int(action))
        self._going = not (state.ended or state.truncated)
        observation, information = self._seen()
        return observation, float(state.success), state.ended, state.truncated, information

    def render(self) -> Image | None:
        """Return a picture in the mode ``"rgb_array"``; the window of ``"human"`` shows itself.

        Raises
        ------
        RenderingUnavailableError
            This machine has no OpenGL; the message says what to install.
        """
        if self.render_mode != "rgb_array":
            return None
        if self._camera is None:
            self._camera = Camera(self.world.scene, *self._size)
        return self._camera.frame()

    def close(self) -> None:
        """Release the graphics."""
        for view in (self._camera, self._window):
            if view is not None:
                view.close()
        self._camera = self._window = None

    def _show(self) -> None:
        if self._window is None:
            self._window = Window(self.world.scene)
            self.world.scene.observer = self._window.show
        self._window.show()

    def _seen(self) -> tuple[np.int64, Information]:
        now = self.world.now
        information = {
            "state": now.x * self.domain.model.n_hidden + now.y,
            "observed": now.x,
            "hidden": now.y,
            "belief": now.belief.copy(),
            "last_action": self._last_action,
            "angle": now.angle,
        }
        return np.int64(now.observation), information
