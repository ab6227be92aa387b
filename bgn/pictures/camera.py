"""Pictures of a MuJoCo scene, off-screen or in a window, with a clear word where there is no graphics."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import Any, Final, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from bgn.physics import REMEDY, RenderingUnavailableError
from bgn.physics.scene import FRAME_STEPS, TIMESTEP, Scene

Image = NDArray[np.uint8]

VIEW: Final = "talk"  # the camera every scene defines


class Drawable(Protocol):
    """A scene, or anything else that is a MuJoCo model with the camera ``VIEW``."""

    model: Any
    data: Any


class Camera:
    """Draws a scene off-screen."""

    def __init__(self, scene: Drawable, width: int = 640, height: int = 360) -> None:
        self._scene = scene
        # Off-screen, MuJoCo clears and resolves its whole buffer for every picture.
        scene.model.vis.global_.offwidth, scene.model.vis.global_.offheight = width, height
        try:
            self._renderer: Any = mujoco.Renderer(scene.model, height, width)
        except Exception as error:  # each OpenGL backend fails in its own way
            backend = getattr(getattr(mujoco, "GLContext", None), "__module__", "nothing")
            raise RenderingUnavailableError(
                f"no OpenGL by {backend}, which MuJoCo chose when it was first imported "
                f"({error or type(error).__name__}); {REMEDY}"
            ) from error

    def frame(self) -> Image:
        """Return the scene as it is now, uint8 of shape (height, width, 3)."""
        self._renderer.update_scene(self._scene.data, camera=VIEW)
        image: Image = self._renderer.render()
        return image.copy()

    def close(self) -> None:
        """Release the graphics context."""
        self._renderer.close()


class Window:
    """Shows a scene in a window while it moves, in real time."""

    def __init__(self, scene: Scene) -> None:
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise RenderingUnavailableError(
                'render_mode "human" needs a screen, but neither DISPLAY nor WAYLAND_DISPLAY is set; '
                'use "rgb_array"'
            )
        import mujoco.viewer  # loads a window system

        others = set(threading.enumerate())
        self._viewer: Any = mujoco.viewer.launch_passive(
            scene.model, scene.data, show_left_ui=False, show_right_ui=False
        )
        self._threads = set(threading.enumerate()) - others
        self._viewer.cam.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._viewer.cam.fixedcamid = scene.model.camera(VIEW).id
        self._due = time.perf_counter()

    def show(self) -> None:
        """Show the scene as it is now, no faster than real time."""
        now = time.perf_counter()
        self._due = max(self._due, now - FRAME_STEPS * TIMESTEP) + FRAME_STEPS * TIMESTEP
        time.sleep(max(0.0, self._due - now))
        self._viewer.sync()

    def close(self) -> None:
        """Close the window and wait until it is gone: a Python that exits first would crash."""
        self._viewer.close()
        for thread in self._threads:
            thread.join(timeout=5)
