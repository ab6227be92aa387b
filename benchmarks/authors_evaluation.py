"""The Hallways as the authors measured them.

Their test runs the policy greedily in 16 environments side by side, each starting over when its episode ends, and
averages the first 100 episodes to finish. That favours short episodes: one that takes long is likelier not to be among
the first. It is a metric of its own beside the unbiased one.
"""

from __future__ import annotations

import numpy as np
import torch

from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.domains.domain import Domain
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld

EPISODES, LANES = 100, 16
COLUMNS = ("first_100_return", "first_100_return_se")


def first_to_finish(
    networks: AgentNetworks, domain: Domain, settings: Hyperparameters, rng: np.random.Generator
) -> list[float]:
    """Return the discounted returns of the first 100 greedy episodes to finish in 16 lanes."""
    world = TableWorld(
        domain,
        LANES,
        hidden_first_action=settings.hidden_first_action,
        track_beliefs=networks.actor.kind == "belief",
    )
    networks.prepare()
    world.reset(_uniform(rng, START_VARIATES))
    hidden = torch.zeros(1, LANES, networks.hidden_width)
    returns, discounts = torch.zeros(LANES, dtype=torch.double), torch.ones(LANES, dtype=torch.double)
    finished: list[float] = []
    with torch.no_grad():
        while len(finished) < EPISODES:
            features, hidden = networks.actor_features(world.inputs, hidden)
            action = networks.actor.head.forward(features).argmax(-1)[0]
            openings = world.openings(_uniform(rng, START_VARIATES))
            step = world.step(action, _uniform(rng, STEP_VARIATES), openings)
            returns += discounts * step.reward
            discounts *= domain.report_discount
            done = step.ended | step.truncated
            finished += returns[done].tolist()
            returns[done], discounts[done] = 0.0, 1.0
    return finished[:EPISODES]


def _uniform(rng: np.random.Generator, width: int) -> torch.Tensor:
    return torch.from_numpy(rng.random((LANES, width), dtype=np.float32))
