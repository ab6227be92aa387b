"""Ends a worker process with its parent, whatever it is doing and however the parent died."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import platform
import signal
import threading
from multiprocessing.connection import wait

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def hold(parent: int) -> None:
    """Tie this process to its parent, whose process id is ``parent``.

    On Linux the kernel sees to it, as soon as the thread that started this process ends. Elsewhere a thread here
    waits for the parent to end, which a long call into compiled code can delay.
    """
    if platform.system() == "Linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:  # it died before the kernel knew
            os._exit(1)
        return
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
