"""The force-feedback domains as MuJoCo scenes, and their compilation into exact tables.

Importing a domain's tables needs nothing of this package; it is imported where physics is stepped.
"""

import ctypes.util
import os
import sys


def _choose_graphics() -> None:
    """Choose off-screen graphics where there is no screen; MuJoCo reads its choice once, when imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or screen or "MUJOCO_GL" in os.environ:
        return
    for backend, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = backend
            return


_choose_graphics()
