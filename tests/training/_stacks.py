"""Small stacks of runs for the tests."""

from __future__ import annotations

import torch

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.training.learners.a2c import A2CLearner
from bgn.training.update_runner import UpdateRunner

CPU = torch.device("cpu")


def learner(agent_id: str, domain_id: str, seeds: tuple[int, ...], **settings) -> A2CLearner:
    return A2CLearner(AGENTS[agent_id], domains.get(domain_id), Hyperparameters(**settings), seeds, CPU)


def trained(agent_id: str, domain_id: str, seeds: tuple[int, ...], updates: int, **settings) -> A2CLearner:
    stack = learner(agent_id, domain_id, seeds, **settings)
    runner = UpdateRunner(stack, updates)
    for i in range(updates):
        runner.update(i)
    return stack
