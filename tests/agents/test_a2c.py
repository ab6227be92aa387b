from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from bgn.agents.a2c import (
    RewardScaler,
    RMSProp,
    belief_loss,
    critic_loss,
    generalized_advantages,
    policy_loss,
    sample_actions,
)
from bgn.agents.parameters import Parameters, normal

seeds = st.integers(0, 2**32 - 1)
BELOW_ONE = float(np.nextafter(np.float32(1), np.float32(0)))


def advantages(rewards, values, *, ended=(), truncated=(), arrival=None, discount=0.5, trace_decay=0.5):
    """One seed, one lane; ``ended`` and ``truncated`` name steps."""
    T = len(rewards)
    flags = [torch.tensor([[[t in which] for t in range(T)]]) for which in (ended, truncated)]
    lane = [torch.tensor(v, dtype=torch.float32)[None, :, None] for v in (rewards, values)]
    arrivals = None if arrival is None else torch.tensor(arrival, dtype=torch.float32)[None, :, None]
    options = {"discount": discount, "trace_decay": trace_decay, "arrival_values": arrivals}
    return generalized_advantages(*lane, *flags, **options)[0, :, 0].tolist()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        # Errors r + V'/2 - V: 1 + 1 - 1 = 1, 5 + 1.5 - 2 = 4.5, 3 + 2 - 3 = 2; they decay by a quarter.
        ({}, [1 + (4.5 + 2 / 4) / 4, 4.5 + 2 / 4, 2]),
        ({"ended": [1]}, [1 + 3 / 4, 3, 2]),  # 5 - 2, and nothing flows back from the next episode
        ({"truncated": [1]}, [1, 0, 2]),  # the cut step has no advantage
        ({"truncated": [1], "arrival": [9, 6, 9]}, [1 + 6 / 4, 6, 2]),  # 5 + 6/2 - 2
        ({"ended": [2]}, [1 + (4.5 + 0 / 4) / 4, 4.5, 0]),  # 3 - 3 at the rollout's last step
        ({"ended": [0, 1], "truncated": [2]}, [0, 3, 0]),
        ({"trace_decay": 0.0}, [1, 4.5, 2]),  # TD errors
        ({"trace_decay": 1.0}, [1 + (4.5 + 2 / 2) / 2, 4.5 + 2 / 2, 2]),  # Monte-Carlo returns
    ],
)
def test_advantages_by_hand(options, expected):
    assert advantages([1, 5, 3], [1, 2, 3, 4], **options) == pytest.approx(expected)


def lambda_return(t, rewards, values, ended, truncated, arrival, discount, decay):
    """Appendix A: (1 - λ) Σ λ^(n-1) R^(n), the last of the trajectory's n-step returns taking the rest."""
    T = len(rewards)
    stop = next((i for i in range(t, T) if ended[i] or truncated[i]), T - 1)
    if ended[stop]:
        final, last = 0.0, stop
    elif truncated[stop] and arrival is None:
        final, last = values[stop], stop - 1  # the cut step is left out: bootstrap from where it was taken
    elif truncated[stop]:
        final, last = arrival[stop], stop
    else:
        final, last = values[stop + 1], stop
    n_max = last - t + 1
    if n_max == 0:
        return values[t]
    total = 0.0
    for n in range(1, n_max + 1):
        bootstrap = final if n == n_max else values[t + n]
        n_step = sum(discount**k * rewards[t + k] for k in range(n)) + discount**n * bootstrap
        total += decay ** (n - 1) * (1 if n == n_max else 1 - decay) * n_step
    return total


@settings(max_examples=100, deadline=None)
@given(seeds, st.booleans())
def test_advantages_are_lambda_returns_less_values(seed, bootstrap):
    rng = np.random.default_rng(seed)
    S, T, L = 2, int(rng.integers(1, 8)), 3
    rewards, arrival = rng.normal(size=(2, S, T, L))
    values = rng.normal(size=(S, T + 1, L))
    ended, truncated = rng.random((2, S, T, L)) < 0.2
    truncated &= ~ended
    discount, decay = rng.random(2)
    ours = generalized_advantages(
        *(torch.from_numpy(a) for a in (rewards, values, ended, truncated)),
        discount=discount,
        trace_decay=decay,
        arrival_values=torch.from_numpy(arrival) if bootstrap else None,
    )
    for i, t, j in np.ndindex(S, T, L):
        lane = (a[i, :, j] for a in (rewards, values, ended, truncated))
        expected = lambda_return(t, *lane, arrival[i, :, j] if bootstrap else None, discount, decay)  # type: ignore[call-arg]
        assert ours[i, t, j].item() == pytest.approx(expected - values[i, t, j], abs=1e-6)  # γλ is float32


def test_policy_loss_by_hand():
    policy = torch.tensor([[[0.5, 0.25, 0.25], [0.5, 0.5, 1e-30]]])
    head, entropy = policy_loss(
        policy.log(), torch.tensor([[1, 0]]), torch.tensor([[2.0, -3.0]]), torch.tensor(0.1)
    )
    # -2 log 1/4 and +3 log 1/2, averaged; entropies 1.5 log 2 and log 2.
    assert head.loss.item() == pytest.approx((4 - 3) * math.log(2) / 2)
    assert entropy.item() == pytest.approx(1.25 * math.log(2))
    H = 1.5 * math.log(2)  # gradient of the first sample: (π - 1_a) A + β π (log π + H), over two samples
    expected = [
        (0.5 * 2 + 0.1 * 0.5 * (-math.log(2) + H)) / 2,
        (-0.75 * 2 + 0.1 * 0.25 * (-math.log(4) + H)) / 2,
        (0.25 * 2 + 0.1 * 0.25 * (-math.log(4) + H)) / 2,
    ]
    assert head.gradient[0, 0].tolist() == pytest.approx(expected, rel=1e-5)


def test_critic_and_belief_losses_by_hand():
    critic = critic_loss(torch.tensor([[1.0, -3.0]]), 0.5)
    assert critic.loss.tolist() == [2.5]
    assert critic.gradient.tolist() == [[-0.5, 1.5]]
    belief = belief_loss(torch.tensor([[[0.0, math.log(3.0)]]]), torch.tensor([[[0.5, 0.5]]]), 0.2)
    assert belief.loss.item() == pytest.approx(-0.5 * math.log(0.25) - 0.5 * math.log(0.75))
    assert belief.gradient[0, 0].tolist() == pytest.approx([0.2 * -0.25, 0.2 * 0.25], rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_loss_gradients_equal_automatic_differentiation(seed):
    """Plain formulas of Section 2.1 and Eq. 3; each seed of the stack has losses of its own."""
    generator = torch.Generator().manual_seed(seed)
    S, N, A, Y = 2, 7, 4, 5

    def normals(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    logits, belief_logits = normals(S, N, A).requires_grad_(), normals(S, N, Y).requires_grad_()
    values, returns = normals(S, N).requires_grad_(), normals(S, N)
    belief = normals(S, N, Y).softmax(-1)
    actions = torch.randint(A, (S, N), generator=generator)
    given_advantages = (returns - values).detach()

    law = torch.distributions.Categorical(logits=logits)
    actor = -(law.log_prob(actions) * given_advantages).mean(1)
    cross = functional.cross_entropy(belief_logits.flatten(0, 1), belief.flatten(0, 1), reduction="none")
    cross = cross.view(S, N).mean(1)
    squares = 0.7 * ((returns - values) ** 2).mean(1)
    total = (actor - 0.3 * law.entropy().mean(1) + squares + 0.4 * cross).sum()
    d_logits, d_values, d_belief = torch.autograd.grad(total, (logits, values, belief_logits))

    head, entropy = policy_loss(
        logits.detach().log_softmax(-1), actions, given_advantages, torch.tensor(0.3, dtype=torch.float64)
    )
    critic, grounded = critic_loss(given_advantages, 0.7), belief_loss(belief_logits.detach(), belief, 0.4)
    for ours, expected in (
        (head.loss, actor),
        (entropy, law.entropy().mean(1)),
        (head.gradient, d_logits),
        (critic.loss, squares),
        (critic.gradient, d_values),
        (grounded.loss, cross),
        (grounded.gradient, d_belief),
    ):
        torch.testing.assert_close(ours, expected.detach(), rtol=1e-9, atol=1e-12)


def test_sampled_actions_invert_the_distribution():
    policy = torch.tensor([[0.0, 0.25, 0.5, 0.0, 0.25]])
    grid = (torch.arange(1000) + 0.5) / 1000
    actions = sample_actions(policy[:, None].expand(1, 1000, 5), grid[None])
    assert actions[0].bincount(minlength=5).tolist() == [0, 250, 500, 0, 250]
    edges = torch.tensor([[0.0, BELOW_ONE]])
    assert sample_actions(policy[:, None].expand(1, 2, 5), edges).tolist() == [[1, 4]]
    certain = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    for u in (0.0, BELOW_ONE):
        assert sample_actions(certain, torch.full((1, 2), u)).tolist() == [[0, 2]]


def test_impossible_actions_are_never_chosen():
    """Float32 probabilities may add up to less than one; what is missing must not go to the last action."""
    logits = torch.randn(1, 20_000, 6, generator=torch.Generator().manual_seed(0))
    logits[..., 5] = -torch.inf
    logits[..., 0] = -torch.inf
    policy = logits.log_softmax(-1).exp()
    for u in (0.0, BELOW_ONE):
        actions = sample_actions(policy, torch.full((1, 20_000), u))
        assert (policy.gather(-1, actions[..., None]) > 0).all()


def stacked(n_seeds, shapes):
    parameters = Parameters(tuple(range(n_seeds)), torch.device("cpu"))
    for i, shape in enumerate(shapes):
        parameters.declare(f"p{i}", shape, normal)
    parameters.allocate()
    parameters.initialise()
    return parameters


def test_rmsprop_is_torchs_with_a_joint_clip_for_each_seed():
    shapes, names = [(3, 5), (7,), (40, 3)], ["p0", "p1", "p2"]
    parameters = stacked(3, shapes)
    options = {"lr": 7e-4, "alpha": 0.99, "eps": 1e-5}
    theirs = [[parameters[n][row].clone().requires_grad_() for n in names] for row in range(3)]
    optimisers = [torch.optim.RMSprop(p, **options) for p in theirs]
    ours = RMSProp(parameters, rate=7e-4, decay=0.99, epsilon=1e-5)
    generator = torch.Generator().manual_seed(3)
    clipped = 0
    for step in range(300):
        scale = 10.0 ** torch.linspace(-4, 1, 3).roll(
            step
        )  # every seed is clipped at times, and at times not
        for row in range(3):
            for name, tensor in zip(names, theirs[row], strict=True):
                tensor.grad = torch.randn(tensor.shape, generator=generator) * scale[row]
                parameters.gradient(name)[row] = tensor.grad
        norms = ours.step(0.5)
        for row in range(3):
            norm = torch.nn.utils.clip_grad_norm_(theirs[row], 0.5)
            assert norms[row].item() == pytest.approx(norm.item(), rel=1e-5)
            clipped += int(norm > 0.5)
            optimisers[row].step()
    assert 100 < clipped < 800
    for row in range(3):
        for name, tensor in zip(names, theirs[row], strict=True):
            torch.testing.assert_close(parameters[name][row], tensor.detach(), rtol=1e-5, atol=2e-6)


class NaiveScaler:
    """One seed's reward wrapper, a step at a time: batches of Welford's update (authors' code)."""

    def __init__(self, lanes):
        self.returns, self.count, self.mean, self.variance = np.zeros(lanes), 1e-4, 0.0, 1.0

    def scale(self, rewards, done):
        self.returns = self.returns * 0.99 + rewards
        n, delta = len(rewards), self.returns.mean() - self.mean
        total = self.count + n
        squares = self.variance * self.count + self.returns.var() * n + delta**2 * self.count * n / total
        self.mean, self.variance, self.count = self.mean + delta * n / total, squares / total, total
        self.returns[done] = 0
        return np.clip(rewards / np.sqrt(self.variance + 1e-8), -10, 10)


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from([1e-3, 1.0, 100.0]))
def test_reward_scaling_equals_a_running_variance(seed, size):
    rng = np.random.default_rng(seed)
    S, T, L = 2, 4, 3
    scaler, naive = RewardScaler(S, L, torch.device("cpu")), [NaiveScaler(L) for _ in range(S)]
    clipped = False
    for _ in range(12):
        rewards = (rng.normal(size=(S, T, L)) * size * (rng.random((S, T, L)) < 0.2)).astype(np.float32)
        done = rng.random((S, T, L)) < 0.15
        ours = scaler.scale(torch.from_numpy(rewards), torch.from_numpy(done)).numpy()
        for i in range(S):
            expected = np.stack([naive[i].scale(rewards[i, t].astype(float), done[i, t]) for t in range(T)])
            np.testing.assert_allclose(ours[i], expected, rtol=2e-4, atol=1e-6)
            clipped |= bool((np.abs(expected) == 10).any())


def test_scaled_rewards_are_clipped_at_ten():
    scaler = RewardScaler(1, 1, torch.device("cpu"))
    quiet, going_on = torch.zeros(1, 500, 1), torch.zeros(1, 500, 1, dtype=torch.bool)
    scaler.scale(quiet, going_on)
    loud = torch.tensor([[[1e4], [-1e4]]])
    assert scaler.scale(loud, torch.ones(1, 2, 1, dtype=torch.bool)).flatten().tolist() == [10, -10]
