"""The unit of work: a cell of the benchmark (domain x agent) as a specification, and what its runs yield."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bgn.agents.hyperparameters import CommonHyperparameters
from bgn.errors import BgnError

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd
    from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class CellSpec:
    """Everything that determines the results of a cell's runs, but for the seeds."""

    domain: str
    """Domain id, see :func:`bgn.domains.get`."""
    agent: str
    """Agent id, see :data:`bgn.agents.specs.AGENTS`."""
    hyperparameters: CommonHyperparameters
    """The settings of one preset for this cell; their type says which algorithm trains it."""
    env_steps: int
    """Environment steps a run trains for, over all its lanes."""
    evaluation_episodes: int = 1000
    """Episodes of the final evaluation, once with sampled and once with greedy actions."""
    physics_episodes: int = 0
    """Episodes of the final policy in MuJoCo physics (robot domains)."""
    variant: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    """Keywords for the domain's builder; empty for the paper's definition."""


@dataclass(frozen=True, kw_only=True)
class Beginning:
    """A shorter run of some seeds of a stack, see :mod:`bgn.training.beginnings`."""

    spec: CellSpec
    seeds: tuple[int, ...]
    checkpoint: Path
    """Where that run would look for its checkpoint."""


class DeviceLostError(BgnError, RuntimeError):
    """A GPU, or this process's access to it, does not work any more; only a fresh process can go on."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """One finished run: a cell trained with one seed."""

    seed: int
    points: Sequence[Mapping[str, float]]
    """The learning curve, point by point: env_steps, return_100 and success_100 (means over the last 100 training
    episodes, the return discounted as the domain reports it), episodes, what the algorithm reports (A2C: entropy,
    actor_loss, critic_loss and belief_cross_entropy of the actor's head in nats, NaN without one), seconds."""
    metrics: Mapping[str, float]
    """``train_return``/``train_success`` (last point of the curve); ``sampled_*`` and ``greedy_*``, each with
    return, return_se, return_sd, success, success_se, length (of the fixed evaluation), and belief_kl of a
    grounded actor; ``physics_success``, ``physics_success_se``, ``physics_length``, ``physics_episodes``
    where physics was run; ``env_steps_per_second``, ``wall_seconds``, ``cpu_seconds`` (this run's share of its
    stack)."""
    policy: Mapping[str, Tensor]
    """The trained actor's parameters by name, without the seed axis; see :mod:`bgn.policies.saved`."""

    @property
    def curve(self) -> pd.DataFrame:
        """The learning curve as a frame."""
        import pandas as pd  # imported here because training needs torch, numpy and scipy only

        return pd.DataFrame(list(self.points))


@dataclass(frozen=True)
class Progress:
    """How far a stack of runs has come; sent to the caller a few times a second."""

    env_steps: int
    """Steps done by each run of the stack."""
    total_env_steps: int
    steps_per_second: float
    """Over all runs of the stack."""
    return_100: float
    """Mean over the stack's runs."""
    stage: str = "train"
    """``train`` or ``evaluate``."""


class Interrupted(BaseException):
    """What a listener of progress raises to stop the work; not a failure, so not an ``Exception``.

    Where there is a checkpoint, it is written first.
    """
