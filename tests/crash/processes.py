"""Looks after processes from outside, in Linux's /proc."""

from __future__ import annotations

import contextlib
import os
import pathlib
import signal
import subprocess
import time
from collections.abc import Iterator


def children(pid: int) -> list[int]:
    """Return the worker processes of a parent (not multiprocessing's own resource tracker)."""
    found = [int(entry.name) for entry in _all() if _parent(entry) == pid]
    return [one for one in found if "spawn_main" in _command(one)]


def others(pid: int) -> list[int]:
    """Return all running children of a process but for multiprocessing's own resource tracker."""
    found = [int(entry.name) for entry in _all() if _parent(entry) == pid]
    return [one for one in found if alive(one) and "resource_tracker" not in _command(one)]


def marked(variable: str) -> list[int]:
    """Return the running processes that were given an environment variable, such as ``NAME=value``."""
    wanted = f"\0{variable}\0"
    return [int(entry.name) for entry in _all() if wanted in f"\0{_read(entry / 'environ')}\0"]


def alive(pid: int) -> bool:
    """Say whether a process runs; one that is dead but not buried does not."""
    return _field(pathlib.Path("/proc") / str(pid), 0) not in ("", "Z")


def kill(pid: int) -> bool:
    """Kill a process; False if it was gone before."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def wait_until(process: subprocess.Popen[str], moment: float) -> None:
    """Wait until a moment, but no longer than the process runs."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(max(0.0, moment - time.monotonic()))


def await_death(pids: list[int], seconds: float = 10.0) -> None:
    """Fail unless all are gone soon."""
    deadline = time.monotonic() + seconds
    while left := [pid for pid in pids if alive(pid)]:
        assert time.monotonic() < deadline, f"processes {left} outlived their parent"
        time.sleep(0.02)


def _all() -> Iterator[pathlib.Path]:
    return (entry for entry in pathlib.Path("/proc").iterdir() if entry.name.isdecimal())


def _command(pid: int) -> str:
    return _read(pathlib.Path("/proc") / str(pid) / "cmdline")


def _parent(entry: pathlib.Path) -> int:
    return int(_field(entry, 1) or 0)


def _field(entry: pathlib.Path, index: int) -> str:
    # The name, in brackets, may hold blanks.
    fields = _read(entry / "stat").rpartition(")")[2].split()
    return fields[index] if fields else ""


def _read(path: pathlib.Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
