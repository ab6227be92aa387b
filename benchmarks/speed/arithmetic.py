"""How many multiply-adds a training step needs: the floor that speeds are held against.

Counted from the networks' shapes, with the savings that change no number: one forward pass, look-up tables
for embedded inputs, no gradient where none is needed. Only products count; element-wise work, beliefs and the
optimiser come on top, in time but not here.
"""

from __future__ import annotations

import torch

from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.layers import EMBEDDING, HIDDEN
from bgn.agents.networks import FEEDFORWARD_LAYERS, InputLayout, input_layout
from bgn.agents.specs import AgentSpec, InputKind
from bgn.domains.domain import Domain


def multiply_adds(spec: AgentSpec, domain: Domain, settings: Hyperparameters) -> float:
    """Multiply-adds per environment step of one seed, forward and backward."""
    layout, T = input_layout(domain, torch.device("cpu")), settings.rollout
    samples = settings.lanes * T
    bootstrapped = samples + settings.lanes  # the critic also sees the state after the rollout
    shared = settings.shared_recurrence and spec.actor == spec.critic == "history"
    branches = (
        (spec.actor, samples, layout.n_actions),
        (spec.critic, bootstrapped, 1),
    )
    total = sum(
        _branch(kind, layout, settings, forward, samples, outputs, grounded=spec.grounded)
        for kind, forward, outputs in branches
    )
    for kind, forward, _ in branches[1:] if shared else branches:
        if kind == "history":
            total += _recurrence(layout, forward, samples, settings.lanes)
    return total / samples


def _branch(
    kind: InputKind,
    layout: InputLayout,
    settings: Hyperparameters,
    forward: int,
    samples: int,
    outputs: int,
    *,
    grounded: bool,
) -> int:
    """Layers and heads of one branch: ``forward`` rows one way, ``samples`` rows back."""
    embedded_state = kind == "state" and layout.state is None
    width = {
        "history": HIDDEN,
        "belief": layout.belief_width,
        "state": EMBEDDING if layout.state is None else layout.state.shape[1],
    }[kind]
    layers = settings.recurrent_hidden_layers if kind == "history" else FEEDFORWARD_LAYERS
    wants_gradient = kind == "history" or embedded_state
    total = width * HIDDEN * (forward + samples * (2 if wants_gradient else 1))
    total += (layers - 1) * HIDDEN * HIDDEN * (forward + 2 * samples)
    total += HIDDEN * outputs * (forward + 2 * samples)
    if grounded:
        total += HIDDEN * layout.n_hidden * 3 * samples
    return total


def _recurrence(layout: InputLayout, forward: int, samples: int, lanes: int) -> int:
    """One GRU; no gradient flows into the memory that a rollout starts from."""
    gates = 3 * HIDDEN
    total = HIDDEN * gates * (forward + samples + samples - lanes)
    observations, actions = layout.n_observations, layout.n_actions + 1
    if layout.observation is None or layout.action is None:
        return total + 3 * EMBEDDING * gates * (observations + actions)
    widths = observations * layout.observation.shape[1] + actions * layout.action.shape[1]
    return total + 2 * widths * gates
