"""What results are computed with: the git state, the versions, the machine."""

from __future__ import annotations

import importlib.metadata
import pathlib
import platform
import subprocess
from collections.abc import Mapping
from functools import cache

import bgn

_PACKAGE = pathlib.Path(bgn.__file__).parent
_RECORDED_VERSIONS = ("bgn", "torch", "numpy", "scipy", "mujoco", "numba")


@cache
def environment(device: str = "cpu") -> Mapping[str, str | bool | None]:
    """Return the git state, the versions and the machine, under the column names of the store.

    ``device`` is where torch computes; a GPU is named after the processor.
    """
    commit, dirty = git_state(_PACKAGE)
    recorded: dict[str, str | bool | None] = {
        "git_commit": commit,
        "git_dirty": dirty,
        "machine": ", ".join(
            [f"{platform.system()} {platform.machine()}", processor(), *_accelerators(device)]
        ),
        "version_python": platform.python_version(),
    }
    return recorded | {f"version_{name}": _version(name) for name in _RECORDED_VERSIONS}


def git_state(directory: pathlib.Path) -> tuple[str | None, bool | None]:
    """Return (commit, whether files differ from it); (None, None) outside a repository."""
    try:
        commit = git(directory, "rev-parse", "HEAD")
        return commit, bool(git(directory, "status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.CalledProcessError):
        return None, None


def git(directory: pathlib.Path, *arguments: str) -> str:
    """Run git in a folder and return what it prints.

    Raises
    ------
    OSError
        There is no git.
    subprocess.CalledProcessError
        Git fails; ``stderr`` says why.
    """
    command = ["git", "-C", str(directory), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def processor() -> str:
    """Return the processor's name, as Linux tells it, or what else the platform says."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def _accelerators(device: str) -> list[str]:
    if device == "cpu":
        return []
    import torch  # imported here because it takes seconds, and who asks has imported it already

    return [torch.cuda.get_device_name(device)] if torch.cuda.is_available() else []


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
