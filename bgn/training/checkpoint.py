"""Checkpoints of a stack of runs: one file, replaced atomically."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from bgn.results.atomic import write_atomically


def save(path: Path, content: dict[str, Any]) -> None:
    """Write ``content`` so that a reader sees the old file or the new one, whatever happens meanwhile."""

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            torch.save(content, file)

    write_atomically(path, write)


def load(path: Path) -> dict[str, Any] | None:
    """Return what was saved, or None if there is no checkpoint."""
    if not path.exists():
        return None
    content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    return content
