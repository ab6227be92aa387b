"""A2C (paper, Section 2.1 and Appendix A) for a stack of runs, as fast as one thread or one CUDA graph can be.

The same algorithm in a straightforward form is :mod:`bgn.training.learners.plain_a2c`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from bgn.agents.a2c import (
    RewardScaler,
    RMSProp,
    belief_loss,
    critic_loss,
    generalized_advantages,
    policy_loss,
    sample_actions,
)
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks, RolloutInputs
from bgn.agents.specs import AgentSpec
from bgn.domains.domain import Domain
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, Inputs, StepResult, TableWorld
from bgn.training.learners.protocol import UpdateShape
from bgn.training.random_streams import Purpose, RandomStreams
from bgn.training.recorder import Recorder

#: Uniform variates a lane consumes per training step: its action, its step, and a possible new episode.
VARIATES = 1 + STEP_VARIATES + START_VARIATES
#: What an update reports, in the order of the recorder's last axis.
LOSSES = ("entropy", "actor_loss", "critic_loss", "belief_cross_entropy")


class _Taken(NamedTuple):
    """Where one step of a rollout goes."""

    action: Tensor  # (S, L)
    log_policy: Tensor  # (S, L, A)
    reward: Tensor  # (S*L,)
    ended: Tensor  # (S*L,)
    truncated: Tensor  # (S*L,)


class A2CLearner:
    """A stack of runs that differ only in their seed; a :class:`~bgn.training.learners.protocol.Learner`.

    :meth:`update` makes T steps in every lane and one gradient step.
    """

    def __init__(
        self,
        spec: AgentSpec,
        domain: Domain,
        settings: Hyperparameters,
        seeds: tuple[int, ...],
        device: torch.device,
    ) -> None:
        self.spec, self.domain, self.settings, self.seeds = spec, domain, settings, seeds
        self.device = device
        self.shape = UpdateShape(settings.rollout, settings.lanes, VARIATES)
        self.networks = AgentNetworks(spec, domain, settings, seeds, device)
        self.networks.initialise()
        self.networks.allocate(settings.rollout + 1, settings.lanes)
        parameters = self.networks.parameters
        self.optimiser = RMSProp(
            parameters,
            rate=settings.learning_rate,
            decay=settings.rmsprop_decay,
            epsilon=settings.rmsprop_epsilon,
        )
        self.world = TableWorld(
            domain,
            len(seeds) * settings.lanes,
            device=device,
            hidden_first_action=settings.hidden_first_action,
            track_beliefs=spec.needs_beliefs,
        )
        size = (len(seeds), settings.lanes)
        self.inputs = RolloutInputs(
            self.networks.layout, len(seeds), settings.rollout + 1, settings.lanes, spec.needs_beliefs, device
        )
        self.scaler = RewardScaler(*size, device)
        self.recorder = Recorder(*size, domain.report_discount, LOSSES, device)
        openings = RandomStreams(seeds, Purpose.OPENING, device)
        self.world.reset(openings.block(0, 1, settings.lanes, START_VARIATES)[0])
        #: What the networks see next: the world's inputs, but for the ``stale_reset_info`` variant.
        self.seen = self.world.inputs
        # (S, T, L), but a step's lanes lie side by side, as the world's do.
        shape = (settings.rollout, len(seeds), settings.lanes)
        self.actions = torch.zeros(shape, dtype=torch.int64, device=device).transpose(0, 1)
        self.rewards = torch.zeros(shape, device=device).transpose(0, 1)
        self.ended = torch.zeros(shape, dtype=torch.bool, device=device).transpose(0, 1)
        self.truncated = torch.zeros_like(self.ended)
        self.log_policy = torch.zeros(
            *size[:1], settings.rollout, settings.lanes, domain.model.joint.n_actions, device=device
        )
        self.arrival_values = torch.zeros_like(self.rewards)
        self._taken = self._steps()
        self.keep_in_place()

    def _steps(self) -> list[_Taken]:
        flat = (b.transpose(0, 1).flatten(1) for b in (self.rewards, self.ended, self.truncated))
        buffers = (self.actions.unbind(1), self.log_policy.unbind(1), *flat)
        return [_Taken(*views) for views in zip(*buffers, strict=True)]

    def schedule(self, total_updates: int) -> Tensor:
        """Return β_e of every update, see :func:`entropy_weights`."""
        return entropy_weights(self.settings, total_updates)

    def update(self, variates: Tensor, entropy_weight: Tensor) -> None:
        """Act for T steps with ``variates`` (T, S*L, 7), then take one gradient step.

        ``entropy_weight`` is the scalar β_e of this update.
        """
        self._act(variates)
        values = self._values()
        self._learn(values, entropy_weight)
        for recurrence in self.networks.recurrences:
            recurrence.carry(self.settings.rollout)
        self.keep_in_place()

    def _act(self, variates: Tensor) -> None:
        networks, inputs, T = self.networks, self.inputs, self.settings.rollout
        networks.prepare()
        openings = self.world.openings(variates[:, :, 1 + STEP_VARIATES :].flatten(0, 1)).split(T)
        inputs.write(0, self.seen)
        for t in range(T):
            actor = networks.actor
            if actor.recurrence is not None:
                actor.recurrence.step(t, *inputs.slots[t])
            log_policy = torch.log_softmax(actor.step(t, inputs), -1)
            self._taken[t].log_policy.copy_(log_policy)
            u, for_world, _ = variates[t].split_with_sizes((1, STEP_VARIATES, START_VARIATES), 1)
            self._taken[t].action.copy_(sample_actions(log_policy.exp(), u.view(log_policy.shape[:2])))
            before = self.seen
            result = self._step_world(t, for_world, openings[t])
            if self.settings.time_limit == "bootstrap":
                self.arrival_values[:, t] = self._arrival_value(t, result)
            if self.settings.stale_reset_info:
                fresh = self.world.inputs.fresh
                stale = replace(self.world.inputs, state=before.state, belief=before.belief)
                self.seen = stale.select(fresh, self.world.inputs)
            inputs.write(t + 1, self.seen)

    def _step_world(self, t: int, variates: Tensor, openings: Inputs) -> StepResult:
        taken = self._taken[t]
        result = self.world.step(taken.action.view(-1), variates, openings)
        taken.reward.copy_(result.reward)
        taken.ended.copy_(result.ended)
        taken.truncated.copy_(result.truncated)
        self.seen = self.world.inputs
        return result

    def _arrival_value(self, t: int, result: StepResult) -> Tensor:
        """V of where the step led before any new episode: (S, L)."""
        critic, arrival = self.networks.critic, result.arrival
        hidden = None
        if critic.recurrence is not None:
            if critic.recurrence is not self.networks.actor.recurrence:
                self._step_critic(t)
            shape = self.rewards[:, t].shape
            seen = (arrival.observation, arrival.last_action, arrival.fresh)
            hidden = critic.recurrence.infer(
                critic.recurrence.features[:, t], *(indices.view(shape) for indices in seen)
            )
        return critic.infer(critic.infer_inputs(arrival, hidden))[..., 0]

    def _step_critic(self, t: int) -> None:
        recurrence = self.networks.critic.recurrence
        assert recurrence is not None
        recurrence.step(t, *self.inputs.slots[t])

    def _values(self) -> Tensor:
        """V of all slots: (S, T + 1, L)."""
        critic, T = self.networks.critic, self.settings.rollout
        if critic.recurrence is not None:
            shared = critic.recurrence is self.networks.actor.recurrence
            # Acting has stepped a shared recurrence through all slots but the last, which is for bootstrapping.
            for t in range(T if shared else 0, T + 1):
                self._step_critic(t)
        return critic.all_slots(self.inputs)[..., 0]

    def _learn(self, values: Tensor, entropy_weight: Tensor) -> None:
        settings = self.settings
        done = self.ended | self.truncated
        rewards = self.scaler.scale(self.rewards, done) if settings.reward_scaling else self.rewards
        advantages = generalized_advantages(
            rewards,
            values,
            self.ended,
            self.truncated,
            discount=self.domain.training_discount,
            trace_decay=settings.trace_decay,
            arrival_values=self.arrival_values if settings.time_limit == "bootstrap" else None,
        ).flatten(1)
        policy, entropy = policy_loss(
            self.log_policy.flatten(1, 2), self.actions.flatten(1), advantages, entropy_weight
        )
        critic = critic_loss(advantages, settings.critic_weight)
        cross_entropy = self._backward(policy.gradient, critic.gradient[..., None])
        self.optimiser.step(settings.max_gradient_norm)
        losses = torch.stack((entropy, policy.loss, critic.loss, cross_entropy), 1)
        self.recorder.record(self.rewards, done, losses)

    def _backward(self, d_policy: Tensor, d_values: Tensor) -> Tensor:
        """Write all gradients; returns the actor's belief cross-entropy (S,), NaN without a belief head."""
        T, inputs = self.settings.rollout, self.inputs
        cross_entropy = torch.full((len(self.seeds),), torch.nan, device=d_policy.device)
        d_features: dict[int, Tensor] = {}
        for branch, d_output in ((self.networks.critic, d_values), (self.networks.actor, d_policy)):
            d_belief = None
            if branch.grounding is not None:
                target = inputs.belief[:, :T].flatten(1, 2)
                grounded = belief_loss(branch.belief_logits(T), target, self.settings.belief_weight)
                cross_entropy, d_belief = grounded.loss, grounded.gradient
            d = branch.backward(inputs, d_output, d_belief, T)
            if branch.recurrence is not None and d is not None:  # both branches' gradients, if they share it
                key = id(branch.recurrence)
                d_features[key] = d_features[key].add_(d) if key in d_features else d
        if self.networks.recurrences:
            one_hot = inputs.one_hot(T)
            for recurrence in self.networks.recurrences:
                d = d_features[id(recurrence)].view(len(self.seeds), T, self.settings.lanes, -1)
                recurrence.backward(d, T, one_hot, inputs.fresh[:, :T])
        return cross_entropy

    def networks_of(self, row: int) -> AgentNetworks:
        """Copy one seed's networks out of the stack."""
        device = self.networks.parameters.device
        networks = AgentNetworks(self.spec, self.domain, self.settings, (self.seeds[row],), device)
        networks.parameters.load(0, self.networks.parameters.of_seed(row))
        return networks

    def keep_in_place(self) -> None:
        """Move what the next update starts from into tensors that keep their place."""
        if not hasattr(self, "_in_place"):
            self._in_place = (self.world.inputs.clone(), self.seen.clone())
        else:
            self._in_place[0].copy_(self.world.inputs)
            self._in_place[1].copy_(self.seen)
        self.world.inputs, self.seen = self._in_place

    def state(self) -> Mapping[str, Tensor]:
        """Return all tensors that the rest of the run depends on, in place: a checkpoint's content."""
        parameters = self.networks.parameters
        # By name: how the buffers are laid out depends on the device.
        state = {f"values.{name}": view for name, view in parameters.views(parameters.values).items()}
        state |= {f"mean_squares.{k}": v for k, v in parameters.views(parameters.mean_squares).items()}
        state |= {
            "steps": self.world.steps,
            "scaler.returns": self.scaler.returns,
            "scaler.sums": self.scaler.sums,
        }
        state |= {f"recorder.{k}": v for k, v in self.recorder.state().items()}
        state |= {f"hidden.{i}": r.hidden for i, r in enumerate(self.networks.recurrences)}
        for name, inputs in (("world", self.world.inputs), ("seen", self.seen)):
            state |= {f"{name}.{k}": v for k, v in vars(inputs).items()}
        return state

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Go on from what :meth:`state` returned in an equal learner."""
        for name, tensor in self.state().items():
            tensor.copy_(state[name])


def entropy_weights(settings: Hyperparameters, total_updates: int) -> Tensor:
    """β_e of every update: exponential from start to end in the fraction of the run done (Table 1)."""
    fraction = torch.arange(total_updates, dtype=torch.float64) / max(1, total_updates)
    ratio = settings.entropy_weight_end / settings.entropy_weight_start
    return (settings.entropy_weight_start * ratio**fraction).float()
