"""Where a result comes from: hashes of what determines it, and a record of what it was computed with."""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib.metadata
import json
import pathlib
import platform
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy import sparse

import bgn
from bgn.domains.domain import FOR_PEOPLE, Domain

#: Where training starts. Domains are found at run time, not imported by name: a run sees only their tables,
#: which :func:`data_hash` covers.
TRAINING_CODE = "bgn.training.trainer"
#: What a run whose final policy stays out of physics never calls.
PHYSICS_CODE = "bgn.physics.world"
#: Where the row of a reference policy starts.
PLANNING_CODE = "bgn.planning.reference_rows"

_PACKAGE = pathlib.Path(bgn.__file__).parent
_RECORDED_VERSIONS = ("bgn", "torch", "numpy", "scipy", "mujoco", "numba")


@dataclass(frozen=True)
class Origin:
    """What determines a result, as three hashes; results with equal keys are the same result."""

    spec: str
    """Of everything that was asked for."""
    code: str
    """Of the sources that computed it."""
    data: str
    """Of the domain's tables and episode rules."""

    @property
    def key(self) -> str:
        """The content key: one hash over the three."""
        return _digest(f"{self.spec} {self.code} {self.data}".encode())


def spec_hash(spec: object) -> str:
    """Hash a specification: a dataclass, or anything that JSON can hold."""
    return _digest(spec_json(spec).encode())


def spec_json(spec: object) -> str:
    """Return a specification as JSON with sorted keys."""
    return json.dumps(spec, sort_keys=True, default=_plain)


def code_hash(entry: str, *, without: str | None = None, root: pathlib.Path = _PACKAGE.parent) -> str:
    """Hash the sources a module depends on: itself, what it imports from its own package, and so on.

    Comments, docstrings and layout do not count; nor does the module ``without`` and what only it needs.
    MuJoCo's XML files count where modules beside them do.
    """
    modules = _closure(entry, without, root)
    scenes = {scene for path in modules.values() for scene in path.parent.glob("*.xml")}
    described = [f"{name} {_module_hash(path)}" for name, path in sorted(modules.items())]
    described += [f"{scene.name} {_digest(scene.read_bytes())}" for scene in sorted(scenes)]
    return _digest("\n".join(described).encode())


def data_hash(domain: Domain) -> str:
    """Hash a domain's tables and episode rules."""
    digest = hashlib.sha256()
    for piece in _pieces(domain):
        digest.update(piece)
    return digest.hexdigest()[:16]


@cache
def environment() -> Mapping[str, str | bool | None]:
    """Return the git state, the versions and the machine, under the column names of the store."""
    commit, dirty = _git_state(_PACKAGE)
    recorded: dict[str, str | bool | None] = {
        "git_commit": commit,
        "git_dirty": dirty,
        "machine": f"{platform.system()} {platform.machine()}, {_processor()}",
        "version_python": platform.python_version(),
    }
    return recorded | {f"version_{name}": _version(name) for name in _RECORDED_VERSIONS}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a specification cannot hold {type(value).__name__}: {value!r}")


def _closure(entry: str, without: str | None, root: pathlib.Path) -> dict[str, pathlib.Path]:
    """Return the modules under ``root`` that importing ``entry`` can lead to."""
    found: dict[str, pathlib.Path] = {}
    waiting = [entry]
    while waiting:
        name = waiting.pop()
        path = _source(name, root)
        if path is None or name in found or name == without:
            continue
        found[name] = path
        waiting += [name.rpartition(".")[0], *_imports(path)]
    return found


def _source(module: str, root: pathlib.Path) -> pathlib.Path | None:
    base = root.joinpath(*module.split("."))
    candidates = (base.with_suffix(".py"), base / "__init__.py") if module else ()
    return next((path for path in candidates if path.is_file()), None)


@cache
def _imports(path: pathlib.Path) -> tuple[str, ...]:
    names: list[str] = []
    for node in ast.walk(_parse(path)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(names)


def _parse(path: pathlib.Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@cache
def _module_hash(path: pathlib.Path) -> str:
    return _digest("\n".join(_syntax(_parse(path))).encode())


def _syntax(node: ast.AST) -> Iterator[str]:
    """Yield a module's meaning token by token, equal for every Python that parses it to the same tree."""
    yield f"({type(node).__name__}"
    for name, value in ast.iter_fields(node):
        if isinstance(node, ast.Constant):
            yield repr(value) if name == "value" else ""
        elif value not in (None, []):  # fields that newer versions of Python add are empty for older code
            yield f".{name}"
            for child in _without_docstring(node, value) if isinstance(value, list) else [value]:
                yield from _syntax(child) if isinstance(child, ast.AST) else [repr(child)]
    yield ")"


def _without_docstring(node: ast.AST, children: list[Any]) -> list[Any]:
    documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
    return [child for child in children if not (documented and _is_string(child))]


def _is_string(node: Any) -> bool:
    constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return constant and isinstance(node.value.value, str)


def _pieces(value: Any) -> Iterator[bytes]:
    """Yield the bytes that determine a domain, whatever its fields hold."""
    if isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, sparse.csr_array):
        rows = value.copy()
        rows.sum_duplicates()
        for part in (np.asarray(rows.shape), rows.indptr, rows.indices):
            yield from _pieces(np.asarray(part, dtype=np.int64))
        yield from _pieces(rows.data)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.metadata != FOR_PEOPLE:
                yield field.name.encode()
                yield from _pieces(getattr(value, field.name))
    elif isinstance(value, tuple):
        yield f"tuple {len(value)}".encode()
        for item in value:
            yield from _pieces(item)
    elif value is None or isinstance(value, str | bool | int | float):
        yield f"{type(value).__name__} {value!r}".encode()
    else:
        raise TypeError(f"a domain holds a {type(value).__name__}, which has no defined hash")


def _git_state(directory: pathlib.Path) -> tuple[str | None, bool | None]:
    """Return (commit, whether files differ from it); (None, None) outside a repository."""
    try:
        commit = _git(directory, "rev-parse", "HEAD")
        return commit, bool(_git(directory, "status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.CalledProcessError):
        return None, None


def _git(directory: pathlib.Path, *arguments: str) -> str:
    command = ["git", "-C", str(directory), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _processor() -> str:
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
