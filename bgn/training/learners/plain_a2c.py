"""The straightforward implementation of the benchmark's training: what speeds are compared with.

The same algorithm as :mod:`bgn.training`, written the obvious way: ``torch.nn`` modules and autograd, one
environment at a time in Python, Eq. 1 as a dense product, a second forward pass over the rollout for
training, one seed. It is also the readable specification of that algorithm: the tests hold the fast learner's
losses, gradients and parameters to this one's. Classic domains only, the time limit's default rule only.

Shapes: T steps, L lanes, S states, A actions, H = 256.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AgentSpec, InputKind
from bgn.domains.domain import Domain

HIDDEN, EMBEDDING = 256, 128
POLICY_GAIN, GAIN = 0.01, 2**0.5


class Tables:
    """A domain's dense arrays, shared by all lanes."""

    def __init__(self, domain: Domain) -> None:
        if domain.family != "classic":
            raise ValueError(f"the baseline knows classic domains only, not {domain.id!r}")
        self.domain = domain
        self.T, self.O, self.R = domain.model.joint.dense()
        self.reset = domain.model.joint.reset
        # An agent that goes on has seen that the episode did not end: that rules those states out.
        self.T_going_on = self.T * ~self.reset[:, :, None]


class Environment:
    """One lane. ``belief`` follows Eq. 1 if ``track_belief``."""

    def __init__(
        self, tables: Tables, rng: np.random.Generator, *, hidden_first_action: bool, track_belief: bool
    ) -> None:
        self.tables, self.rng = tables, rng
        self.model = tables.domain.model.joint
        self.hidden_first_action, self.track_belief = hidden_first_action, track_belief
        self.reset()

    def reset(self) -> None:
        """Open an episode, by an unseen random action where the authors' environments did."""
        self.state = self._draw(self.model.start)
        self.belief = self.model.start
        self.observation, self.last_action = self.model.n_observations, self.model.n_actions
        if self.hidden_first_action:
            self._move(int(self.rng.integers(self.model.n_actions)))
        self.fresh, self.steps = True, 0

    def step(self, action: int) -> tuple[float, bool, bool]:
        """Take an action; returns the reward, and whether the episode ended or was cut by its limit."""
        ended = bool(self.tables.reset[action, self.state])
        reward = self._move(action)
        self.fresh = False
        self.steps += 1
        truncated = not ended and self.steps >= self.tables.domain.episode_limit
        if ended or truncated:
            self.reset()
        return reward, ended, truncated

    def _move(self, a: int) -> float:
        s, s_next = self.state, self._draw(self.tables.T[a, self.state])
        o = self._draw(self.tables.O[a, s_next])
        if self.track_belief and not self.tables.reset[a, s]:
            belief = self.tables.O[a, :, o] * (self.belief @ self.tables.T_going_on[a])  # Eq. 1
            self.belief = belief / belief.sum()
        self.state, self.observation, self.last_action = s_next, o, a
        return float(self.tables.R[a, s, s_next, o])

    def _draw(self, probabilities: NDArray[np.float64]) -> int:
        cumulative = probabilities.cumsum()
        return int(cumulative.searchsorted(self.rng.random() * cumulative[-1], side="right"))


class RewardScaler:
    """Divide rewards by the running standard deviation of the lanes' discounted returns; clip to ±10."""

    def __init__(self, lanes: int) -> None:
        self.returns = np.zeros(lanes)
        self.count, self.mean, self.variance = 1e-4, 0.0, 1.0

    def scale(self, rewards: NDArray[np.float64], done: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Scale the rewards (L,) of one step, by the statistics up to and with it."""
        self.returns = self.returns * 0.99 + rewards
        n, delta = len(rewards), self.returns.mean() - self.mean
        total = self.count + n
        squares = self.variance * self.count + self.returns.var() * n + delta**2 * self.count * n / total
        self.mean, self.variance, self.count = self.mean + delta * n / total, squares / total, total
        self.returns[done] = 0.0
        scaled: NDArray[np.float64] = np.clip(rewards / np.sqrt(self.variance + 1e-8), -10, 10)
        return scaled


@dataclass
class Seen:
    """What agents may look at in one step (L, …), or in a rollout and after it (T + 1, L, …)."""

    observation: Tensor
    last_action: Tensor
    state: Tensor
    belief: Tensor
    fresh: Tensor

    def at(self, t: int) -> Seen:
        """Return one step."""
        return Seen(*(getattr(self, field.name)[t] for field in fields(self)))


@dataclass
class Rollout:
    """What happened in T steps; ``rewards`` as the losses take them, scaled."""

    seen: Seen  # (T + 1, L, …)
    memories: list[Tensor]  # (L, H) of each GRU, before the first step
    actions: Tensor  # (T, L)
    rewards: Tensor  # (T, L)
    ended: Tensor  # (T, L)
    truncated: Tensor  # (T, L)
    values: Tensor  # (T + 1, L)


@dataclass
class Losses:
    """The parts of Eq. 2 and Eq. 5; ``cross_entropy`` is the actor's, None without grounding."""

    policy: Tensor
    entropy: Tensor
    critic: Tensor
    cross_entropy: Tensor | None
    total: Tensor


def linear(n_in: int, n_out: int, gain: float = GAIN) -> nn.Linear:
    """Return a layer with orthogonal weights and zero biases."""
    layer = nn.Linear(n_in, n_out)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class History(nn.Module):
    """A GRU over embedded observations and last actions (paper, Appendix B)."""

    def __init__(self, domain: Domain) -> None:
        super().__init__()
        model = domain.model.joint
        self.observation = nn.Embedding(model.n_observations + 1, EMBEDDING)
        self.action = nn.Embedding(model.n_actions + 1, EMBEDDING)
        self.gru = nn.GRU(2 * EMBEDDING, HIDDEN)
        for name, parameter in self.gru.named_parameters():
            nn.init.orthogonal_(parameter) if "weight" in name else nn.init.zeros_(parameter)

    def forward(self, seen: Seen, memory: Tensor) -> Tensor:
        """Advance the memory (L, H) by one step, emptying it where an episode opens."""
        x = torch.cat((self.observation(seen.observation), self.action(seen.last_action)), -1)
        memory = memory * ~seen.fresh[:, None]
        _, memory = self.gru(x[None], memory[None])
        return memory[0]


class Branch(nn.Module):
    """Actor or critic: an input, two layers, a head, and a belief head if grounded."""

    def __init__(
        self, kind: InputKind, domain: Domain, layers: int, outputs: int, gain: float, *, grounded: bool
    ) -> None:
        super().__init__()
        self.kind, S = kind, domain.model.n_hidden
        self.state = nn.Embedding(S, EMBEDDING) if kind == "state" else None
        width = {"history": HIDDEN, "state": EMBEDDING, "belief": S}[kind]
        steps: list[nn.Module] = []
        for _ in range(layers if kind == "history" else 2):
            steps += [linear(width, HIDDEN), nn.Tanh()]
            width = HIDDEN
        self.body = nn.Sequential(*steps)
        self.head = linear(HIDDEN, outputs, gain)
        self.belief = nn.Linear(HIDDEN, S) if grounded else None

    def forward(self, seen: Seen, features: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Return the output and the belief logits; ``features`` are the GRU's, if the input is history."""
        x = features
        if self.kind == "belief":
            x = seen.belief
        elif self.state is not None:
            x = self.state(seen.state)
        x = self.body(x)
        return self.head(x), None if self.belief is None else self.belief(x)


class Agent(nn.Module):
    """Actor and critic with their memories: none, one each, or one that both share."""

    def __init__(self, spec: AgentSpec, domain: Domain, settings: Hyperparameters) -> None:
        super().__init__()
        layers, n_actions = settings.recurrent_hidden_layers, domain.model.joint.n_actions
        self.shared = settings.shared_recurrence and spec.actor == spec.critic == "history"
        kinds = [spec.actor] if self.shared else [spec.actor, spec.critic]
        self.histories = nn.ModuleList(History(domain) for kind in kinds if kind == "history")
        self.actor = Branch(spec.actor, domain, layers, n_actions, POLICY_GAIN, grounded=spec.grounded)
        self.critic = Branch(spec.critic, domain, layers, 1, GAIN, grounded=spec.grounded)

    def remember(self, seen: Seen, memories: list[Tensor]) -> list[Tensor]:
        """Advance all memories by one step."""
        return [history(seen, memory) for history, memory in zip(self.histories, memories, strict=True)]

    def act(self, seen: Seen, memories: list[Tensor]) -> tuple[Tensor, Tensor]:
        """Return π (L, A) and V (L,) after :meth:`remember`."""
        logits, _ = self.actor(seen, memories[0] if memories else None)
        values, _ = self.critic(seen, memories[-1] if memories else None)
        return logits.softmax(-1), values[:, 0]


class Baseline:
    """One run of one agent: :meth:`update` collects a rollout and learns from it."""

    def __init__(self, spec: AgentSpec, domain: Domain, settings: Hyperparameters, seed: int) -> None:
        if settings.time_limit != "zero-advantage" or settings.stale_reset_info:
            raise ValueError("the baseline knows the zero-advantage rule and current reset infos only")
        torch.manual_seed(seed)
        rng = np.random.default_rng(seed)
        self.settings, self.discount = settings, domain.training_discount
        tables, hidden = Tables(domain), settings.hidden_first_action and domain.hidden_first_action
        self.lanes = [
            Environment(tables, rng, hidden_first_action=hidden, track_belief=spec.needs_beliefs)
            for _ in range(settings.lanes)
        ]
        self.scaler = RewardScaler(settings.lanes)
        self.agent = Agent(spec, domain, settings)
        self.memories = [torch.zeros(settings.lanes, HIDDEN) for _ in self.agent.histories]
        self.optimiser = torch.optim.RMSprop(
            self.agent.parameters(),
            lr=settings.learning_rate,
            alpha=settings.rmsprop_decay,
            eps=settings.rmsprop_epsilon,
        )

    def update(self, entropy_weight: float) -> Losses:
        """Act for T steps in every lane, then take one gradient step."""
        losses = self.losses(self.collect(), entropy_weight)
        self.learn(losses)
        return losses

    @torch.no_grad()
    def collect(self) -> Rollout:
        """Act for T steps."""
        seen, memories = [self._look()], self.memories
        columns: list[tuple[Tensor, ...]] = []
        for _ in range(self.settings.rollout):
            self.memories = self.agent.remember(seen[-1], self.memories)
            policy, values = self.agent.act(seen[-1], self.memories)
            actions = torch.multinomial(policy, 1)[:, 0]
            columns.append((actions, *self._step(actions.tolist()), values))
            seen.append(self._look())
        _, bootstrap = self.agent.act(seen[-1], self.agent.remember(seen[-1], self.memories))
        taken, rewards, ended, truncated, worth = map(torch.stack, zip(*columns, strict=True))
        stacked = Seen(*(torch.stack([getattr(s, f.name) for s in seen]) for f in fields(Seen)))
        worth = torch.cat((worth, bootstrap[None]))
        return Rollout(stacked, memories, taken, rewards, ended, truncated, worth)

    def _step(self, actions: list[int]) -> tuple[Tensor, Tensor, Tensor]:
        """Step every lane; returns scaled rewards, ended and truncated, (L,) each."""
        results = [lane.step(action) for lane, action in zip(self.lanes, actions, strict=True)]
        rewards, ended, truncated = (np.array(column) for column in zip(*results, strict=True))
        if self.settings.reward_scaling:
            rewards = self.scaler.scale(rewards, ended | truncated)
        return torch.from_numpy(rewards).float(), torch.from_numpy(ended), torch.from_numpy(truncated)

    def returns(self, rollout: Rollout) -> Tensor:
        """λ-returns R_t that bootstrap from the rollout's end (Appendix A), (T, L); R_t = V_t where cut."""
        values, trace = rollout.values, self.settings.trace_decay
        returns, advantage = torch.empty_like(rollout.rewards), torch.zeros_like(values[0])
        for t in reversed(range(len(returns))):
            goes_on = ~(rollout.ended[t] | rollout.truncated[t])
            error = rollout.rewards[t] + self.discount * values[t + 1] * goes_on - values[t]
            advantage = error + self.discount * trace * goes_on * advantage
            advantage = advantage * ~rollout.truncated[t]
            returns[t] = advantage + values[t]
        return returns

    def losses(self, rollout: Rollout, entropy_weight: float) -> Losses:
        """Run over the rollout a second time, with gradients (Eq. 2 and Eq. 5; means over T x L)."""
        settings, T = self.settings, self.settings.rollout
        seen, memories, features = rollout.seen, rollout.memories, []
        for t in range(T):
            memories = self.agent.remember(seen.at(t), memories)
            features.append(memories)
        actor, critic = (torch.stack([f[i] for f in features]) if memories else None for i in (0, -1))
        now = Seen(*(getattr(seen, field.name)[:T] for field in fields(seen)))
        logits, belief_logits = self.agent.actor(now, actor)
        values, critic_belief_logits = self.agent.critic(now, critic)
        log_policy = logits.log_softmax(-1)
        chosen = log_policy.gather(-1, rollout.actions[..., None])[..., 0]
        returns = self.returns(rollout)
        advantages = returns - rollout.values[:T]
        policy = -(chosen * advantages).mean()
        entropy = -(log_policy.exp() * log_policy).sum(-1).mean()
        error = settings.critic_weight * ((returns - values[..., 0]) ** 2).mean()
        total = policy - entropy_weight * entropy + error
        cross_entropies = [
            -(now.belief * b.log_softmax(-1)).sum(-1).mean()
            for b in (belief_logits, critic_belief_logits)
            if b is not None
        ]
        total = total + settings.belief_weight * sum(cross_entropies)
        return Losses(policy, entropy, error, cross_entropies[0] if cross_entropies else None, total)

    def learn(self, losses: Losses) -> None:
        """Take one clipped RMSProp step."""
        self.optimiser.zero_grad()
        losses.total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.agent.parameters(), self.settings.max_gradient_norm)
        self.optimiser.step()

    def _look(self) -> Seen:
        lanes = self.lanes
        return Seen(
            torch.tensor([lane.observation for lane in lanes]),
            torch.tensor([lane.last_action for lane in lanes]),
            torch.tensor([lane.state for lane in lanes]),
            torch.from_numpy(np.stack([lane.belief for lane in lanes]).astype(np.float32)),
            torch.tensor([lane.fresh for lane in lanes]),
        )
