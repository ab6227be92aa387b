"""What a training run can be set to; the values are data and live in ``benchmarks/registry.toml``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class CommonHyperparameters:
    """What the networks, the world and the device are set to, whatever the algorithm."""

    shared_recurrence: bool = True
    """Ah-Ch agents: one GRU (and one pair of embeddings) for actor and critic, or one each."""
    recurrent_hidden_layers: int = 2
    """FC(256) + tanh layers after the GRU."""
    feature_steepness: float = 0.0
    """Robot domains: standard deviation of the weights that read features, at the start, with each unit's threshold
    at a random point of the unit cube; 0 keeps the authors' start (orthogonal weights, zero biases)."""
    hidden_first_action: bool = True
    """Open classic episodes with an unseen random action, where the domain has it."""
    stale_reset_info: bool = False
    """Show the old episode's belief and state on a new episode's first step, as the authors' code did."""
    tf32: bool = False
    """CUDA only: allow TensorFloat-32 products."""


@dataclass(frozen=True, kw_only=True)
class Hyperparameters(CommonHyperparameters):
    """Settings of A2C and of the networks (paper, Table 1 and Appendix B)."""

    lanes: int = 16
    """Environment instances acting side by side ("number of actors")."""
    rollout: int = 5
    """Steps between updates, T."""
    trace_decay: float = 0.95
    """λ of the λ-returns."""
    critic_weight: float = 0.5
    """β_c: weight of the critic's squared error."""
    entropy_weight_start: float = 0.01
    """β_e at the first step."""
    entropy_weight_end: float = 0.01
    """β_e at the last step; in between it moves exponentially with the fraction of the run done."""
    belief_weight: float = 1.0
    """Weight of each head's belief cross-entropy H(b, b̂) (paper, Eq. 3)."""
    learning_rate: float = 7e-4
    """RMSProp step size."""
    rmsprop_decay: float = 0.99
    """Decay of RMSProp's running mean square."""
    rmsprop_epsilon: float = 1e-5
    """Added to RMSProp's root mean square."""
    max_gradient_norm: float = 0.5
    """The joint gradient of a run is scaled down to this L2 norm."""
    reward_scaling: bool = True
    """Divide rewards by the running standard deviation of the discounted return, clipped to ±10."""
    time_limit: Literal["zero-advantage", "bootstrap"] = "zero-advantage"
    """What a step cut off by the episode limit teaches: nothing, or a bootstrapped return."""
