"""What determines a result: hashes of what was asked for, of the code that runs, and of the domain's tables."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import pathlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import bgn
from bgn.results.code import CodeTree, Scope
from bgn.results.data import data_hash
from bgn.results.environment import environment

__all__ = [
    "PLANNING",
    "TRAINING",
    "TRAINING_WITH_PHYSICS",
    "Origin",
    "code_hash",
    "data_hash",
    "environment",
    "spec_hash",
    "spec_json",
]

_DATA: Final = ("bgn.domains.domain:Domain", "bgn.domains.domain:Features")
_WITHOUT: Final = (
    "bgn.domains.registry",  # how a domain is found and built; its tables are hashed
    "bgn.domains.layout",  # for pictures
    "bgn.training.checkpoint:save",  # how a file is written
    "bgn.policies.saved:describe",  # how a file is read
    "bgn.training.trainer:Stack._resume",  # and found again: a resumed run is the same run
    "bgn.training.cuda",  # how cells share a GPU
)

#: What a run executes whose final policy is also evaluated in physics.
TRAINING_WITH_PHYSICS: Final = Scope(
    entries=("bgn.training.trainer:train_cell", *_DATA), without=_WITHOUT, data=_DATA
)
#: What any other run executes.
TRAINING: Final = replace(
    TRAINING_WITH_PHYSICS, without=(*_WITHOUT, "bgn.training.physics_evaluation:evaluate_policy")
)
#: What the row of a reference policy executes.
PLANNING: Final = replace(
    TRAINING_WITH_PHYSICS, entries=("bgn.planning.reference_rows:evaluate_reference", *_DATA)
)

_ROOT = pathlib.Path(bgn.__file__).parents[1]


@dataclass(frozen=True)
class Origin:
    """What determines a result, as three hashes; results with equal keys are the same result."""

    spec: str
    """Of everything that was asked for."""
    code: str
    """Of the code that computed it."""
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


@cache
def code_hash(scope: Scope) -> str:
    """Hash the code of a scope, as it is installed; see :mod:`bgn.results.code`."""
    return CodeTree(_ROOT).hash(scope)


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a specification cannot hold {type(value).__name__}: {value!r}")


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
