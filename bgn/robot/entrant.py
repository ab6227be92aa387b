"""A policy that is evaluated on a robot: loaded, checked, and named by what it is."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import bgn
from bgn.domains.domain import Domain
from bgn.policies.saved import NetworkPolicy
from bgn.robot.errors import UsageError

ROOT: Final = Path(bgn.__file__).resolve().parents[1]
#: Trained with the paper's budget; seed 0 of each task.
PUBLISHED: Final = "results/published/short-robots/calibrated/policies/{task}/ah-ch+bgn/seed-0.safetensors"


@dataclass(frozen=True)
class Entrant:
    """A policy to be evaluated."""

    domain: Domain
    policy: NetworkPolicy
    path: Path
    digest: str
    """SHA-256 of its file."""

    @property
    def place(self) -> str:
        """Where its file is: from the repository's root if it lies in the repository."""
        path = self.path.resolve()
        return str(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)


def enter(task: str, path: Path) -> Entrant:
    """Load a policy for a task.

    Raises
    ------
    UsageError
        It is a policy of another task, or one that acts on the belief, which is never computed on a robot.
    """
    policy = NetworkPolicy.load(path)
    if policy.domain.id != task:
        raise UsageError(f"{path} is a policy of {policy.domain.id}, not of {task}")
    if policy.spec.actor != "history":
        raise UsageError(
            f"{path} acts on the {policy.spec.actor}; on a robot only a policy of the history can act"
        )
    return Entrant(policy.domain, policy, path, hashlib.sha256(path.read_bytes()).hexdigest())
