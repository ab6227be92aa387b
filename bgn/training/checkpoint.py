"""Checkpoints of a stack of runs: one file, replaced atomically."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from bgn.errors import BgnError
from bgn.results.atomic import write_bytes


class DamagedCheckpointError(BgnError, ValueError):
    """A file that does not hold a checkpoint, or one of another version; the message names it."""


def save(path: Path, content: dict[str, Any]) -> None:
    """Write ``content`` so that a reader sees the old file or the new one, whatever happens meanwhile."""
    serialised = io.BytesIO()
    torch.save(content, serialised)  # in memory first: torch cannot tell why a disk refuses
    write_bytes(path, serialised.getvalue())


def load(path: Path) -> dict[str, Any] | None:
    """Return what was saved, or None if there is no checkpoint.

    Only tensors, numbers and texts in plain containers are read: a file cannot make anything run.

    Raises
    ------
    DamagedCheckpointError
        The file is cut short or otherwise unreadable.
    """
    if not path.exists():
        return None
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever a damaged archive makes of it
        reason = str(error).partition("\n")[0][:200]
        raise DamagedCheckpointError(f"{path} is not a checkpoint: {reason}") from error
    if not isinstance(content, dict):
        raise DamagedCheckpointError(f"{path} is not a checkpoint: it holds a {type(content).__name__}")
    return content


def check(path: Path, content: Mapping[str, Any], like: Mapping[str, Any]) -> None:
    """Raise :class:`DamagedCheckpointError` unless ``content`` is built like ``like``.

    That is, with the same keys, values of the same types and tensors of the same shapes; lists may differ.
    """
    difference = _difference(content, like, "")
    if difference:
        raise DamagedCheckpointError(f"{path} is the checkpoint of another version: {difference}")


def set_aside(path: Path) -> Path:
    """Rename a damaged checkpoint, so that it can be looked at but is not met again; return where it is."""
    aside = path.with_suffix(".damaged")
    path.replace(aside)
    return aside


def _difference(found: object, like: object, where: str) -> str:
    """Say where two contents are built differently; empty if they are built alike."""
    if type(found) is not type(like):
        return f"{where or 'it'} is a {type(found).__name__}, not a {type(like).__name__}"
    if isinstance(found, torch.Tensor) and isinstance(like, torch.Tensor):
        mine, theirs = (tuple(one.shape) for one in (like, found))
        same = mine == theirs and found.dtype == like.dtype
        return "" if same else f"{where} is {theirs} {found.dtype}, not {mine} {like.dtype}"
    if isinstance(found, dict) and isinstance(like, dict):
        if found.keys() != like.keys():
            names = ", ".join(sorted(map(str, found.keys() ^ like.keys())))
            return f"{where or 'it'} has too much or lacks {names}"
        parts = (_difference(found[key], like[key], f"{where}.{key}".lstrip(".")) for key in like)
        return next((part for part in parts if part), "")
    return ""
