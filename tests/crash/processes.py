"""Looks after processes from outside, in Linux's /proc."""

from __future__ import annotations

import os
import pathlib
import signal
import time


def children(pid: int) -> list[int]:
    """Return the worker processes of a parent (not multiprocessing's own resource tracker)."""
    found = []
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdecimal() and _parent(entry) == pid:
            with_arguments = _read(entry / "cmdline")
            if "spawn_main" in with_arguments:
                found.append(int(entry.name))
    return found


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


def await_death(pids: list[int], seconds: float = 10.0) -> None:
    """Fail unless all are gone soon."""
    deadline = time.monotonic() + seconds
    while left := [pid for pid in pids if alive(pid)]:
        assert time.monotonic() < deadline, f"processes {left} outlived their parent"
        time.sleep(0.02)


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
