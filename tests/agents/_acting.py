"""One step of an agent's actors."""

from __future__ import annotations

from torch import Tensor

from bgn.agents.networks import AgentNetworks
from bgn.simulation.table_world import Inputs


def act(networks: AgentNetworks, inputs: Inputs, hidden: Tensor) -> tuple[Tensor, Tensor]:
    """Advance the actors by one input: ((S, N, H) new memory, (S, N, A) policy logits)."""
    features, hidden = networks.actor_features(inputs, hidden)
    return hidden, networks.actor.head.forward(features)
