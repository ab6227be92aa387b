"""Small stacks of runs for the tests."""

from __future__ import annotations

import torch

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.training.executor import Executor
from bgn.training.learner import Learner

CPU = torch.device("cpu")


def learner(agent_id: str, domain_id: str, seeds: tuple[int, ...], **settings) -> Learner:
    return Learner(AGENTS[agent_id], domains.get(domain_id), Hyperparameters(**settings), seeds, CPU)


def trained(agent_id: str, domain_id: str, seeds: tuple[int, ...], updates: int, **settings) -> Learner:
    stack = learner(agent_id, domain_id, seeds, **settings)
    executor = Executor(stack, updates)
    for i in range(updates):
        executor.update(i)
    return stack
