"""Waits for what other processes do."""

from __future__ import annotations

import time
from collections.abc import Callable


def await_(happened: Callable[[], object], what: str, seconds: float = 60.0) -> None:
    """Wait until something happens; fail if it does not."""
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline, f"no sign of {what}"
        time.sleep(0.05)
