"""The force-feedback domains as MuJoCo scenes, and their compilation into exact tables.

Importing a domain's tables needs nothing of this package; it is imported where physics is stepped.
"""

import ctypes.util
import os
import sys
from typing import Final

from bgn.errors import BgnError

REMEDY: Final = (
    "off-screen rendering needs EGL (Debian: `apt install libegl1`) with MUJOCO_GL=egl, or OSMesa "
    "(`apt install libosmesa6`) with MUJOCO_GL=osmesa; physics without pictures needs neither, "
    "with MUJOCO_GL unset or `disable`"
)


class RenderingUnavailableError(BgnError, OSError):
    """No graphics on this machine; the message says what is missing."""


def _choose_graphics() -> None:
    """Choose off-screen graphics where there is no screen; MuJoCo reads its choice once, when imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or screen or "MUJOCO_GL" in os.environ:
        return
    for backend, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = backend
            return


def _load_mujoco() -> None:
    """Import MuJoCo, which loads the graphics it was told to use."""
    try:
        import mujoco  # noqa: F401
    except (AttributeError, RuntimeError) as error:  # what PyOpenGL and MuJoCo raise without the library
        backend = os.environ.get("MUJOCO_GL")
        raise RenderingUnavailableError(f"MUJOCO_GL={backend} does not work ({error}); {REMEDY}") from error


_choose_graphics()
_load_mujoco()
