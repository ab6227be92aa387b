"""Writing a file in one step: a reader sees the old one or the new one, whatever happens meanwhile."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable

#: What unfinished files are called; :meth:`bgn.results.store.Store.lock` sweeps them up.
TORN = ".*.partial"


def write_atomically(path: pathlib.Path, write: Callable[[pathlib.Path], None]) -> None:
    """Let ``write`` fill a temporary file, flush it to the disk, and rename it to ``path``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        write(partial)
        _flush(partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    _flush(path.parent)


def write_bytes(path: pathlib.Path, content: bytes) -> None:
    """Write a file in one atomic step."""

    def write(partial: pathlib.Path) -> None:
        partial.write_bytes(content)

    write_atomically(path, write)


def _flush(path: pathlib.Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
