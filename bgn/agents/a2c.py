"""Advantage actor-critic (paper, Section 2.1 and Appendix A): returns, losses and the optimiser.

Pure functions over tensors whose leading axis is the seed; S seeds, T steps, L lanes. Losses are means over a
seed's T x L samples. Gradients are given with respect to what the heads put out; the tests hold each against
automatic differentiation.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bgn.agents.parameters import Parameters


def generalized_advantages(
    rewards: Tensor,
    values: Tensor,
    ended: Tensor,
    truncated: Tensor,
    *,
    discount: float,
    trace_decay: float,
    arrival_values: Tensor | None = None,
) -> Tensor:
    """Advantages A_t = R_t - V_t of the λ-returns that bootstrap from the trajectory's end (Appendix A).

    Parameters
    ----------
    rewards, ended, truncated
        (S, T, L); whether a step ended its episode, or the episode limit cut it.
    values
        (S, T + 1, L): V of every input, the last one for bootstrapping.
    discount, trace_decay
        γ and λ.
    arrival_values
        (S, T, L): V of where each step led, before any new episode. If given, a cut episode bootstraps from
        it; if not, a step that was cut has no advantage (the authors' rule).

    Returns
    -------
    (S, T, L) advantages.
    """
    steps = rewards.shape[1]
    goes_on = (ended | truncated).logical_not_()
    following = torch.where(goes_on, values[:, 1:], 0.0)
    if arrival_values is not None:
        following = torch.where(truncated, arrival_values, following)
    errors = rewards + discount * following - values[:, :-1]
    if arrival_values is None:
        errors = errors.masked_fill(truncated, 0.0)
    decay = goes_on * (discount * trace_decay)
    by_step = list(errors.unbind(1))
    factors = decay.unbind(1)
    for t in reversed(range(steps - 1)):
        by_step[t].addcmul_(factors[t], by_step[t + 1])
    return errors


@dataclass(frozen=True)
class HeadLoss:
    """A head's loss per seed (S,), and its gradient with respect to the head's output."""

    loss: Tensor
    gradient: Tensor


def policy_loss(
    log_policy: Tensor, actions: Tensor, advantages: Tensor, entropy_weight: Tensor
) -> tuple[HeadLoss, Tensor]:
    """Actor and entropy losses of Section 2.1 with their gradient in the logits.

    ``log_policy`` (S, N, A) is log π; ``actions`` and ``advantages`` (S, N); ``entropy_weight`` β_e is a
    scalar. Returns the loss -log π(a) A (without the entropy term; the gradient has both) and H(π) (S,).
    """
    n = log_policy.shape[1]
    policy = log_policy.exp()
    entropy = -(policy * log_policy).sum(-1, keepdim=True)
    chosen = log_policy.gather(-1, actions[..., None])
    weight = advantages[..., None]
    gradient = policy * (weight + entropy_weight * (log_policy + entropy))
    gradient.scatter_add_(-1, actions[..., None], -weight)
    return HeadLoss(-(chosen * weight).mean((1, 2)), gradient / n), entropy.mean((1, 2))


def critic_loss(advantages: Tensor, weight: float) -> HeadLoss:
    """β_c (R - V)² with R held fixed, given A = R - V (S, N); the gradient is with respect to V."""
    return HeadLoss(
        weight * (advantages * advantages).mean(1), advantages * (-2 * weight / advantages.shape[1])
    )


def belief_loss(logits: Tensor, belief: Tensor, weight: float) -> HeadLoss:
    """Cross-entropy H(b, b̂) in nats (Eq. 3), unweighted; the gradient in the logits carries ``weight``.

    ``logits`` (S, N, Y) of b̂ are overwritten; ``belief`` (S, N, Y) is b, whose rows sum to one.
    """
    share = weight / logits.shape[1]
    shifted = logits.sub_(logits.amax(-1, keepdim=True))
    explained = (belief * shifted).sum(-1)
    odds = shifted.exp_()
    total = odds.sum(-1, keepdim=True)
    loss = (total.log()[..., 0] - explained).mean(1)
    return HeadLoss(loss, odds.mul_(share / total).sub_(belief, alpha=share))


def sample_actions(policy: Tensor, variates: Tensor) -> Tensor:
    """Draw actions (S, N) from ``policy`` (S, N, A) by inversion; ``variates`` (S, N) uniform on [0, 1)."""
    cumulative = policy.cumsum(-1)
    # Rounded probabilities may add up to a little less than one; the rest is not the last action's.
    scaled = variates[..., None] * cumulative[..., -1:]
    actions: Tensor = (scaled >= cumulative[..., :-1]).sum(-1)
    return actions


class RMSProp:
    """RMSProp with a joint clip of each seed's gradient, as one fused pass over the buffers.

    The step is v ← ρ v + (1 - ρ) g², θ ← θ - η g / (√v + ε): Adam's without its first moment and bias
    correction. Torch has a fused kernel for Adam only, so that kernel is called with β₁ = 0 at a step count
    at which both corrections are exactly one; it is twice as fast as RMSProp in separate passes. Where the buffers go
    seed by seed, all of a stack's parameters are one vector and one call; else each seed's are a call of their own.
    """

    def __init__(self, parameters: Parameters, *, rate: float, decay: float, epsilon: float) -> None:
        self._parameters = parameters
        buffers = (parameters.values, parameters.gradients, parameters.mean_squares)
        self._whole = tuple([buffer] for buffer in buffers)
        self._seeds = list(zip(*map(parameters.by_seed, buffers), strict=True))
        self._steps = [torch.tensor(1e9, device=parameters.device) for _ in self._seeds[0][0]]
        self._options = {"lr": rate, "beta2": decay, "eps": epsilon}

    def step(self, max_norm: float) -> Tensor:
        """Scale each seed's gradient down to ``max_norm`` and apply it; returns the norms before (S,)."""
        norms = self._parameters.gradient_norms()
        # As torch's clip_grad_norm_: the factor is max_norm / (norm + 1e-6), at most one.
        divisors = ((norms + 1e-6) / max_norm).clamp_min_(1.0)
        if self._parameters.goes_by_seed:
            self._parameters.gradients.view(len(divisors), -1).div_(divisors[:, None])
            self._step(self._whole, None)
            return norms
        for buffers, divisor in zip(self._seeds, divisors, strict=True):
            self._step(buffers, divisor)
        return norms

    def _step(self, buffers: tuple[list[Tensor], ...], divisor: Tensor | None) -> None:
        """Step with values, gradients and mean squares, each a list of vectors."""
        values, gradients, squares = buffers
        torch._fused_adam_(
            values,
            gradients,
            gradients,  # with β₁ = 0 the first moment is the gradient
            squares,
            [],
            self._steps[: len(values)],
            beta1=0.0,
            weight_decay=0.0,
            amsgrad=False,
            maximize=False,
            grad_scale=divisor,
            found_inf=None,
            **self._options,
        )


class RewardScaler:
    """Divides rewards by the running standard deviation of the discounted return, clipped to ±10.

    One accumulator a lane (γ = 0.99, zeroed where an episode is done) and one running variance a seed, as the
    environment wrapper of the authors' code keeps them. Sums are kept instead of moments, so that a rollout
    is merged in closed form.
    """

    DISCOUNT = 0.99
    CLIP = 10.0

    def __init__(self, seeds: int, lanes: int, device: torch.device) -> None:
        self.returns = torch.zeros(seeds, lanes, device=device)
        # The running statistics start as if 1e-4 samples of mean 0 and variance 1 had been seen.
        start = torch.tensor([1e-4, 0.0, 1e-4], dtype=torch.float64, device=device)
        self.sums = start.repeat(seeds, 1)  # (S, 3): count, Σ, Σ of squares

    def scale(self, rewards: Tensor, done: Tensor) -> Tensor:
        """Scale rewards (S, T, L) of one rollout, each step by the statistics up to and with that step."""
        accumulated = []
        for reward, goes_on in zip(rewards.unbind(1), (~done).float().unbind(1), strict=True):
            accumulated.append(torch.add(reward, self.returns, alpha=self.DISCOUNT))
            torch.mul(accumulated[-1], goes_on, out=self.returns)
        samples = torch.stack(accumulated, 1).double()
        new = torch.stack((torch.ones_like(samples), samples, samples * samples), -1).sum(2)  # (S, T, 3)
        running = self.sums[:, None] + new.cumsum(1)
        count, total, squares = running.unbind(-1)
        variance = squares / count - (total / count) ** 2
        self.sums.copy_(running[:, -1])
        scale = (variance + 1e-8).rsqrt().float()
        scaled: Tensor = (rewards * scale[..., None]).clamp_(-self.CLIP, self.CLIP)
        return scaled
