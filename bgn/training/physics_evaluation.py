"""The final policy of a robot domain in MuJoCo: what of a run's metrics needs no GPU, and can be filled in later."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from typing import TYPE_CHECKING

from bgn import domains
from bgn.errors import BgnError
from bgn.training.cell import CellSpec

if TYPE_CHECKING:
    from torch import Tensor


class MissingPhysicsError(BgnError, RuntimeError):
    """The machine cannot run the physics; the message says what it lacks."""


def has_physics() -> bool:
    """Say whether MuJoCo is installed."""
    return importlib.util.find_spec("mujoco") is not None


def evaluate_policy(spec: CellSpec, tensors: Mapping[str, Tensor], seed: int) -> dict[str, float]:
    """Return the success of a trained policy, sampling its actions as in training, in MuJoCo.

    Returns
    -------
    ``physics_success``, ``physics_success_se``, ``physics_length`` and ``physics_episodes``.

    Raises
    ------
    MissingPhysicsError
        MuJoCo is not installed.
    """
    if not has_physics():
        raise MissingPhysicsError("MuJoCo is not installed: `pip install mujoco`")
    # Imported here because only robot domains need MuJoCo, and only this the files of policies.
    from bgn.physics.world import evaluate_in_physics
    from bgn.policies.saved import NetworkPolicy

    domain = domains.get(spec.domain, **spec.variant)
    policy = NetworkPolicy(tensors, domain, spec.agent, spec.hyperparameters, greedy=False)
    result = evaluate_in_physics(spec.domain, policy, spec.physics_episodes, seed, **spec.variant)
    return {
        "physics_success": result["success"],
        "physics_success_se": result["success_se"],
        "physics_length": result["length"],
        "physics_episodes": float(result["episodes"]),
    }
