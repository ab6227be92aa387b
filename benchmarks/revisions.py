"""The files of a git revision, in a folder of their own."""

from __future__ import annotations

import contextlib
import io
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bgn.errors import BgnError
from bgn.results.environment import git

ROOT = Path(__file__).parents[1]


class RevisionError(BgnError, RuntimeError):
    """There is no such revision; the message says why."""


def ask_git(root: Path, *arguments: str) -> str:
    """Run git in a folder and return what it prints; raises :class:`RevisionError`."""
    try:
        return git(root, *arguments)
    except FileNotFoundError as error:
        raise RevisionError("git is not installed") from error
    except subprocess.CalledProcessError as error:
        raise RevisionError(error.stderr.strip()) from error


def resolve(revision: str, root: Path = ROOT) -> str:
    """Return the full name of a commit; raises :class:`RevisionError`."""
    try:
        ask_git(root, "rev-parse", "--git-dir")
    except RevisionError as error:
        raise RevisionError(f"{root} is not a git repository: it has no revisions") from error
    try:
        return ask_git(root, "rev-parse", "--verify", "--end-of-options", f"{revision}^{{commit}}")
    except RevisionError as error:
        raise RevisionError(f"{root} has no revision {revision!r}; `git log` lists those it has") from error


@contextlib.contextmanager
def checked_out(commit: str, root: Path = ROOT) -> Iterator[Path]:
    """Give the files of a commit in a folder that is gone afterwards; the repository is only read."""
    packed = subprocess.run(
        ["git", "-C", str(root), "archive", commit], capture_output=True, check=True
    ).stdout
    with tempfile.TemporaryDirectory(prefix="bgn-revision-") as folder:
        with tarfile.open(fileobj=io.BytesIO(packed)) as files:
            files.extraction_filter = getattr(tarfile, "data_filter", None)  # Python before 3.11.4 knows none
            files.extractall(folder)
        yield Path(folder)
