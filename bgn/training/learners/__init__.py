"""Algorithms behind one protocol; the type of a cell's hyperparameters says which one trains it.

Another algorithm is another module here, a dataclass of hyperparameters, and an entry in :data:`LEARNERS`.
"""

from __future__ import annotations

import torch

from bgn.agents.hyperparameters import CommonHyperparameters, Hyperparameters
from bgn.agents.specs import AgentSpec
from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.training.learners.a2c import A2CLearner
from bgn.training.learners.protocol import Learner, MakeLearner

#: What trains a cell with hyperparameters of that type.
LEARNERS: dict[type[CommonHyperparameters], MakeLearner] = {Hyperparameters: A2CLearner}


def make_learner(
    spec: AgentSpec,
    domain: Domain,
    hyperparameters: CommonHyperparameters,
    seeds: tuple[int, ...],
    device: torch.device,
) -> Learner:
    """Return a new stack of runs of the algorithm that ``hyperparameters`` belong to.

    Raises
    ------
    InputError
        No algorithm takes hyperparameters of that type.
    """
    kind = type(hyperparameters)
    if kind not in LEARNERS:
        known = ", ".join(sorted(known.__name__ for known in LEARNERS))
        raise InputError(f"no learner takes {kind.__name__}; known hyperparameters: {known}")
    return LEARNERS[kind](spec, domain, hyperparameters, seeds, device)
