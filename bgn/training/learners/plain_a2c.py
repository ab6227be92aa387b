"""A2C as one would write it down: the readable specification that the fast learner is held to.

``torch.nn`` modules and autograd, one environment at a time in Python, Eq. 1 as a dense product, a second
forward pass over the rollout for training, one seed after another. It takes the same random numbers as
:class:`bgn.training.learners.a2c.A2CLearner` and starts from the same parameters, so the tests ask for the same
runs, and speeds are compared with it. CPU, classic domains and the time limit's default rule only.

Shapes: T steps, L lanes, S states, A actions, H = 256.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.layers import EMBEDDING, HIDDEN
from bgn.agents.networks import FEEDFORWARD_LAYERS, AgentNetworks
from bgn.agents.specs import AgentSpec, InputKind
from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.training.learners.a2c import LOSSES, VARIATES, entropy_weights
from bgn.training.learners.protocol import UpdateShape
from bgn.training.random_streams import Purpose, RandomStreams
from bgn.training.recorder import Recorder

Floats = NDArray[np.float64]


class PlainA2CLearner:
    """Runs that differ only in their seed, one after another; a :class:`~bgn.training.learners.protocol.Learner`."""

    def __init__(
        self,
        spec: AgentSpec,
        domain: Domain,
        settings: Hyperparameters,
        seeds: tuple[int, ...],
        device: torch.device,
    ) -> None:
        if domain.family != "classic" or device.type != "cpu":
            raise InputError(
                f"plain A2C knows classic domains on the CPU only, not {domain.id!r} on {device}"
            )
        if settings.time_limit != "zero-advantage" or settings.stale_reset_info:
            raise InputError("plain A2C knows the zero-advantage rule and current reset infos only")
        self.spec, self.domain, self.settings, self.seeds = spec, domain, settings, seeds
        self.device = device
        self.shape = UpdateShape(settings.rollout, settings.lanes, VARIATES)
        self.recorder = Recorder(len(seeds), settings.lanes, domain.report_discount, LOSSES, device)
        self.runs = [Run(spec, Tables(domain), settings, seed) for seed in seeds]

    def schedule(self, total_updates: int) -> Tensor:
        """Return β_e of every update."""
        return entropy_weights(self.settings, total_updates)

    def update(self, variates: Tensor, entropy_weight: Tensor) -> None:
        """Act for T steps with ``variates`` (T, S*L, 7), then take one gradient step, in each run."""
        of_runs = variates.view(len(variates), len(self.runs), self.shape.lanes, -1).unbind(1)
        rollouts, losses = [], []
        for run, numbers in zip(self.runs, of_runs, strict=True):
            rollouts.append(run.collect(numbers.numpy()))
            parts = run.losses(rollouts[-1], float(entropy_weight))
            run.learn(parts)
            unknown = torch.tensor(torch.nan)
            cross_entropy = unknown if parts.cross_entropy is None else parts.cross_entropy
            losses.append(torch.stack((parts.entropy, parts.policy, parts.critic, cross_entropy)).detach())
        rewards = torch.stack([rollout.earned for rollout in rollouts])
        done = torch.stack([rollout.ended | rollout.truncated for rollout in rollouts])
        self.recorder.record(rewards, done, torch.stack(losses))

    def state(self) -> Mapping[str, Tensor]:
        """Return all tensors that the rest of the runs depends on."""
        state = {f"recorder.{name}": tensor for name, tensor in self.recorder.state().items()}
        for i, run in enumerate(self.runs):
            state |= {f"{i}.{name}": tensor for name, tensor in run.state().items()}
        return state

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from what :meth:`state` returned in an equal learner."""
        for name, tensor in self.recorder.state().items():
            tensor.copy_(state[f"recorder.{name}"])
        for i, run in enumerate(self.runs):
            own = {name.removeprefix(f"{i}."): t for name, t in state.items() if name.startswith(f"{i}.")}
            run.load_state(own)

    def networks_of(self, row: int) -> AgentNetworks:
        """Copy one seed's networks out of its run."""
        networks = AgentNetworks(self.spec, self.domain, self.settings, (self.seeds[row],), self.device)
        for theirs, ours in self.runs[row].agent.pairs(networks):
            theirs.copy_(ours)
        return networks


class Tables:
    """A domain's dense arrays, shared by all lanes."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain
        self.T, self.O, self.R = domain.model.joint.dense()
        self.reset = domain.model.joint.reset
        # An agent that goes on has seen that the episode did not end: that rules those states out.
        self.T_going_on = self.T * ~self.reset[:, :, None]


class Environment:
    """One lane. ``belief`` follows Eq. 1 if ``track_belief``.

    Numbers on [0, 1) choose by inversion: ``opening`` (4,) picks a state, the hidden first action, where it leads and
    what it shows; a step's (2,) pick where it leads and what is seen there.
    """

    def __init__(
        self, tables: Tables, opening: Floats, *, hidden_first_action: bool, track_belief: bool
    ) -> None:
        self.tables = tables
        self.model = tables.domain.model.joint
        self.hidden_first_action, self.track_belief = hidden_first_action, track_belief
        self.reset(opening)

    def reset(self, opening: Floats) -> None:
        """Open an episode, by an unseen random action where the authors' environments did."""
        self.state = _choose(self.model.start, opening[0])
        self.belief = self.model.start
        self.observation, self.last_action = self.model.n_observations, self.model.n_actions
        if self.hidden_first_action:
            self._move(min(int(opening[1] * self.model.n_actions), self.model.n_actions - 1), opening[2:])
        self.fresh, self.steps = True, 0

    def step(self, action: int, u: Floats, opening: Floats) -> tuple[float, bool, bool]:
        """Take an action; returns the reward, and whether the episode ended or was cut by its limit."""
        ended = bool(self.tables.reset[action, self.state])
        reward = self._move(action, u)
        self.fresh = False
        self.steps += 1
        truncated = not ended and self.steps >= self.tables.domain.episode_limit
        if ended or truncated:
            self.reset(opening)
        return reward, ended, truncated

    def _move(self, a: int, u: Floats) -> float:
        s, s_next = self.state, _choose(self.tables.T[a, self.state], u[0])
        o = _choose(self.tables.O[a, s_next], u[1])
        if self.track_belief and not self.tables.reset[a, s]:
            belief = self.tables.O[a, :, o] * (self.belief @ self.tables.T_going_on[a])  # Eq. 1
            self.belief = belief / belief.sum()
        self.state, self.observation, self.last_action = s_next, o, a
        return float(self.tables.R[a, s, s_next, o])

    def position(self) -> Tensor:
        """Return all that is known of the episode but for the belief, as integers."""
        return torch.tensor([self.state, self.observation, self.last_action, self.fresh, self.steps])

    def go_to(self, position: Tensor, belief: Tensor) -> None:
        """Go on from a :meth:`position` and a belief."""
        self.state, self.observation, self.last_action, fresh, self.steps = position.tolist()
        self.fresh, self.belief = bool(fresh), belief.numpy().copy()


def _choose(probabilities: Floats, u: float) -> int:
    cumulative = probabilities.cumsum()
    return int(cumulative.searchsorted(u * cumulative[-1], side="right"))


class RewardScaler:
    """Divide rewards by the running standard deviation of the lanes' discounted returns; clip to ±10."""

    def __init__(self, lanes: int) -> None:
        self.returns = np.zeros(lanes)
        self.count, self.mean, self.variance = 1e-4, 0.0, 1.0

    def scale(self, rewards: Floats, done: NDArray[np.bool_]) -> Floats:
        """Scale the rewards (L,) of one step, by the statistics up to and with it."""
        self.returns = self.returns * 0.99 + rewards
        n, delta = len(rewards), self.returns.mean() - self.mean
        total = self.count + n
        squares = self.variance * self.count + self.returns.var() * n + delta**2 * self.count * n / total
        self.mean, self.variance, self.count = self.mean + delta * n / total, squares / total, total
        self.returns[done] = 0.0
        scaled: Floats = np.clip(rewards / np.sqrt(self.variance + 1e-8), -10, 10)
        return scaled


@dataclass
class Seen:
    """What agents may look at in one step (L, …), or in a rollout and after it (T + 1, L, …)."""

    observation: Tensor
    last_action: Tensor
    state: Tensor
    belief: Tensor
    fresh: Tensor

    def at(self, t: int | slice) -> Seen:
        """Return one step, or several."""
        return Seen(*(getattr(self, field.name)[t] for field in fields(self)))


@dataclass
class Rollout:
    """What happened in T steps."""

    seen: Seen  # (T + 1, L, …)
    memories: list[Tensor]  # (L, H) of each GRU, before the first step
    actions: Tensor  # (T, L)
    earned: Tensor  # (T, L) rewards
    rewards: Tensor  # (T, L) as the losses take them, scaled
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


class History(nn.Module):
    """A GRU over embedded observations and last actions (paper, Appendix B)."""

    def __init__(self, domain: Domain) -> None:
        super().__init__()
        model = domain.model.joint
        self.observation = nn.Embedding(model.n_observations + 1, EMBEDDING)
        self.action = nn.Embedding(model.n_actions + 1, EMBEDDING)
        self.gru = nn.GRU(2 * EMBEDDING, HIDDEN)

    def forward(self, seen: Seen, memory: Tensor) -> Tensor:
        """Advance the memory (L, H) by one step, emptying it where an episode opens."""
        x = torch.cat((self.observation(seen.observation), self.action(seen.last_action)), -1)
        memory = memory * ~seen.fresh[:, None]
        _, memory = self.gru(x[None], memory[None])
        return memory[0]


class Branch(nn.Module):
    """Actor or critic: an input, two layers, a head, and a belief head if grounded."""

    def __init__(self, kind: InputKind, domain: Domain, layers: int, outputs: int, *, grounded: bool) -> None:
        super().__init__()
        self.kind, S = kind, domain.model.n_hidden
        self.state = nn.Embedding(S, EMBEDDING) if kind == "state" else None
        width = {"history": HIDDEN, "state": EMBEDDING, "belief": S}[kind]
        self.layers = nn.ModuleList()
        for _ in range(layers if kind == "history" else FEEDFORWARD_LAYERS):
            self.layers.append(nn.Linear(width, HIDDEN))
            width = HIDDEN
        self.head = nn.Linear(HIDDEN, outputs)
        self.belief = nn.Linear(HIDDEN, S) if grounded else None

    def forward(self, seen: Seen, features: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Return the output and the belief logits; ``features`` are the GRU's, if the input is history."""
        x = features
        if self.kind == "belief":
            x = seen.belief
        elif self.state is not None:
            x = self.state(seen.state)
        for layer in self.layers:
            x = torch.tanh(layer(x))
        return self.head(x), None if self.belief is None else self.belief(x)


class Agent(nn.Module):
    """Actor and critic with their memories: none, one each, or one that both share."""

    def __init__(self, spec: AgentSpec, domain: Domain, settings: Hyperparameters) -> None:
        super().__init__()
        layers, n_actions = settings.recurrent_hidden_layers, domain.model.joint.n_actions
        self.shared = settings.shared_recurrence and spec.actor == spec.critic == "history"
        kinds = [spec.actor] if self.shared else [spec.actor, spec.critic]
        self.histories = nn.ModuleList(History(domain) for kind in kinds if kind == "history")
        self.actor = Branch(spec.actor, domain, layers, n_actions, grounded=spec.grounded)
        self.critic = Branch(spec.critic, domain, layers, 1, grounded=spec.grounded)

    def remember(self, seen: Seen, memories: list[Tensor]) -> list[Tensor]:
        """Advance all memories by one step."""
        return [history(seen, memory) for history, memory in zip(self.histories, memories, strict=True)]

    def act(self, seen: Seen, memories: list[Tensor]) -> tuple[Tensor, Tensor]:
        """Return π (L, A) and V (L,) after :meth:`remember`."""
        logits, _ = self.actor(seen, memories[0] if memories else None)
        values, _ = self.critic(seen, memories[-1] if memories else None)
        return logits.softmax(-1), values[:, 0]

    def pairs(
        self, networks: AgentNetworks, of: Callable[[Tensor], Tensor] = lambda parameter: parameter.data
    ) -> Iterator[tuple[Tensor, Tensor]]:
        """Pair views of the parameters of one-seed ``networks`` with equal views of this agent's.

        ``of`` may return something else of a parameter's shape, such as its gradient. Weights of the networks
        are (in, out), torch's (out, in); the networks' GRU keeps its input gates in the order n, r, z, torch in
        the order r, z, n.
        """

        def named(name: str) -> Tensor:
            return networks.parameters[name][0]

        for recurrence, history in zip(networks.recurrences, self.histories, strict=True):
            assert isinstance(history, History)
            gru = history.gru
            yield named(recurrence.observations.name), of(history.observation.weight)
            yield named(recurrence.actions.name), of(history.action.weight)
            for kind in ("weight", "bias"):
                theirs, ours = named(f"{recurrence.name}.input.{kind}"), of(getattr(gru, f"{kind}_ih_l0")).t()
                yield theirs[..., :HIDDEN], ours[..., 2 * HIDDEN :]
                yield theirs[..., HIDDEN:], ours[..., : 2 * HIDDEN]
                yield named(f"{recurrence.name}.recurrent.{kind}"), of(getattr(gru, f"{kind}_hh_l0")).t()
        for name, branch in (("actor", self.actor), ("critic", self.critic)):
            if branch.state is not None:
                yield named(f"{name}.state"), of(branch.state.weight)
            parts = {f"body.{i}": layer for i, layer in enumerate(branch.layers)} | {"head": branch.head}
            if branch.belief is not None:
                parts["belief"] = branch.belief
            for part, layer in parts.items():
                assert isinstance(layer, nn.Linear)
                yield named(f"{name}.{part}.weight"), of(layer.weight).T
                yield named(f"{name}.{part}.bias"), of(layer.bias)


class Run:
    """One run of one agent: its environments, its networks, and how they learn."""

    def __init__(self, spec: AgentSpec, tables: Tables, settings: Hyperparameters, seed: int) -> None:
        domain = tables.domain
        self.settings, self.discount = settings, domain.training_discount
        openings = RandomStreams((seed,), Purpose.OPENING, torch.device("cpu"))
        self.lanes = [
            Environment(
                tables,
                opening,
                hidden_first_action=settings.hidden_first_action and domain.hidden_first_action,
                track_belief=spec.needs_beliefs,
            )
            for opening in openings.block(0, 1, settings.lanes, 4)[0].numpy()
        ]
        self.scaler = RewardScaler(settings.lanes)
        self.agent = Agent(spec, domain, settings)
        start = AgentNetworks(spec, domain, settings, (seed,), torch.device("cpu"))
        start.initialise()
        for theirs, ours in self.agent.pairs(start):
            ours.copy_(theirs)
        self.memories = [torch.zeros(settings.lanes, HIDDEN) for _ in self.agent.histories]
        self.optimiser = torch.optim.RMSprop(
            self.agent.parameters(),
            lr=settings.learning_rate,
            alpha=settings.rmsprop_decay,
            eps=settings.rmsprop_epsilon,
        )
        for (
            p
        ) in self.agent.parameters():  # what it would make at its first step, so that it can be loaded before
            self.optimiser.state[p] = {"step": torch.tensor(0.0), "square_avg": torch.zeros_like(p)}

    @torch.no_grad()
    def collect(self, variates: NDArray[np.float32]) -> Rollout:
        """Act for T steps with ``variates`` (T, L, 7): an action's, a step's two, and an opening's four."""
        seen, memories = [self._look()], self.memories
        columns: list[tuple[Tensor, ...]] = []
        for u in variates:
            self.memories = self.agent.remember(seen[-1], self.memories)
            policy, values = self.agent.act(seen[-1], self.memories)
            actions = torch.tensor([_choose(p, u[i, 0]) for i, p in enumerate(policy.numpy())])
            columns.append((actions, *self._step(actions.tolist(), u), values))
            seen.append(self._look())
        _, bootstrap = self.agent.act(seen[-1], self.agent.remember(seen[-1], self.memories))
        taken, earned, rewards, ended, truncated, worth = map(torch.stack, zip(*columns, strict=True))
        stacked = Seen(*(torch.stack([getattr(s, f.name) for s in seen]) for f in fields(Seen)))
        worth = torch.cat((worth, bootstrap[None]))
        return Rollout(stacked, memories, taken, earned, rewards, ended, truncated, worth)

    def _step(self, actions: list[int], u: NDArray[np.float32]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Step every lane; returns rewards as earned and as scaled, ended and truncated, (L,) each."""
        results = [lane.step(a, x[1:3], x[3:]) for lane, a, x in zip(self.lanes, actions, u, strict=True)]
        earned, ended, truncated = (np.array(column) for column in zip(*results, strict=True))
        rewards = self.scaler.scale(earned, ended | truncated) if self.settings.reward_scaling else earned
        as_earned, scaled = (torch.from_numpy(column).float() for column in (earned, rewards))
        return as_earned, scaled, torch.from_numpy(ended), torch.from_numpy(truncated)

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
        now = seen.at(slice(T))
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

    def state(self) -> dict[str, Tensor]:
        """Return copies of all that the rest of the run depends on."""
        scaler = self.scaler
        state = {
            "positions": torch.stack([lane.position() for lane in self.lanes]),
            "beliefs": torch.from_numpy(np.stack([lane.belief for lane in self.lanes])),
            "scaler.returns": torch.from_numpy(scaler.returns.copy()),
            "scaler.moments": torch.tensor([scaler.count, scaler.mean, scaler.variance], dtype=torch.float64),
        }
        state |= {f"memory.{i}": memory.clone() for i, memory in enumerate(self.memories)}
        for name, p in self.agent.named_parameters():
            state[f"values.{name}"] = p.detach().clone()
            state[f"mean_squares.{name}"] = self.optimiser.state[p]["square_avg"].clone()
        return state

    @torch.no_grad()
    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from what :meth:`state` returned."""
        for lane, position, belief in zip(self.lanes, state["positions"], state["beliefs"], strict=True):
            lane.go_to(position, belief)
        scaler = self.scaler
        scaler.returns = state["scaler.returns"].numpy().copy()
        scaler.count, scaler.mean, scaler.variance = state["scaler.moments"].tolist()
        self.memories = [state[f"memory.{i}"].clone() for i in range(len(self.memories))]
        for name, p in self.agent.named_parameters():
            p.copy_(state[f"values.{name}"])
            self.optimiser.state[p]["square_avg"].copy_(state[f"mean_squares.{name}"])

    def _look(self) -> Seen:
        lanes = self.lanes
        return Seen(
            torch.tensor([lane.observation for lane in lanes]),
            torch.tensor([lane.last_action for lane in lanes]),
            torch.tensor([lane.state for lane in lanes]),
            torch.from_numpy(np.stack([lane.belief for lane in lanes]).astype(np.float32)),
            torch.tensor([lane.fresh for lane in lanes]),
        )
