"""A window that shows the twin's arm while it feels its way."""

from __future__ import annotations

import os
import sys
import time
from typing import Any, Final

from bgn.robot.errors import UsageError
from bgn.robot.twin.plant import Plant

PERIOD: Final = 1 / 30  # s between pictures


class Window:
    """Shows one plant after another."""

    def __init__(self) -> None:
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise UsageError("--window needs a screen, but neither DISPLAY nor WAYLAND_DISPLAY is set")
        self._plant: Plant | None = None
        self._viewer: Any = None
        self._due = 0.0

    def show(self, plant: Plant) -> None:
        """Show a plant as it is now, if a picture is due."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + PERIOD
        if plant is not self._plant:
            import mujoco.viewer  # loads a window system

            if self._viewer is not None:
                self._viewer.close()
            self._plant = plant
            self._viewer = mujoco.viewer.launch_passive(plant.model, plant.data)
        self._viewer.sync()
