"""The networks of Appendix B for a stack of seeds: one branch for the actor, one for the critic.

A branch turns its input (history, belief or state) into features, and features into an output (policy logits
or a value) and, when grounded, into a reconstruction of the belief (paper, Figure 1).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from bgn.agents.hyperparameters import CommonHyperparameters
from bgn.agents.layers import EMBEDDING, HIDDEN, Body, Dense, Lookup, Recurrence, one_hot
from bgn.agents.parameters import Parameters, normal, orthogonal, uniform_fan_in
from bgn.agents.specs import AgentSpec, InputKind
from bgn.domains.domain import Domain
from bgn.simulation.table_world import Inputs

#: FC(256) + tanh layers of a feed-forward branch (paper, Tables 2 and 3).
FEEDFORWARD_LAYERS = 2
POLICY_GAIN, VALUE_GAIN = 0.01, 2**0.5


@dataclass(frozen=True)
class InputLayout:
    """How a domain's indices become network inputs, on one device."""

    n_observations: int
    """Rows of the observation look-up (one more than Ω where an episode can open without one)."""
    n_actions: int
    n_states: int
    n_hidden: int
    observation: Tensor | None  # (Ω, f); None: embedded
    action: Tensor | None  # (A + 1, 1); None: embedded
    observed: Tensor | None  # (X, f)
    state: Tensor | None  # (S, f)

    @property
    def belief_width(self) -> int:
        """Width of a belief input: (normalised x, b_Y)."""
        return self.n_hidden + (0 if self.observed is None else self.observed.shape[1])


def input_layout(domain: Domain, device: torch.device) -> InputLayout:
    """Return the inputs of ``domain``; classic ones are embedded, robot ones are features."""
    joint, features = domain.model.joint, domain.features
    if features is None:
        shape = (joint.n_observations + 1, joint.n_actions, joint.n_states, domain.model.n_hidden)
        return InputLayout(*shape, None, None, None, None)
    codes = torch.arange(joint.n_actions + 1, dtype=torch.float32) / (joint.n_actions - 1)
    codes[-1] = -1 / (joint.n_actions - 1)  # before the first action
    tensors = (
        torch.from_numpy(a).to(device) for a in (features.observation, features.observed, features.state)
    )
    observation, observed, state = tensors
    return InputLayout(
        joint.n_observations,
        joint.n_actions,
        joint.n_states,
        domain.model.n_hidden,
        observation,
        codes[:, None].to(device),
        observed,
        state,
    )


class RolloutInputs:
    """A rollout's inputs, slot by slot, in the layouts that the products want: (S, T+1, L, …)."""

    def __init__(
        self, layout: InputLayout, seeds: int, slots: int, lanes: int, belief: bool, device: torch.device
    ):
        def per_lane(dtype: torch.dtype = torch.int64) -> Tensor:
            # A slot's lanes lie side by side, as the world's do.
            return torch.zeros(slots, seeds, lanes, dtype=dtype, device=device).transpose(0, 1)

        self.layout = layout
        self.observation, self.last_action, self.state = per_lane(), per_lane(), per_lane()
        self.fresh = per_lane(torch.bool)
        width = layout.belief_width if belief else 0
        self.belief_input = torch.zeros(seeds, slots, lanes, width, device=device)
        self.belief = self.belief_input[..., max(0, width - layout.n_hidden) :]
        of_recurrence = (self.observation, self.last_action, self.fresh)
        #: What a recurrence's step takes: observation, last action and fresh, each (S, L), by slot.
        self.slots = list(zip(*(b.unbind(1) for b in of_recurrence), strict=True))
        self._flat = [
            [view.view(-1) for view in (*slot, s)]
            for slot, s in zip(self.slots, self.state.unbind(1), strict=True)
        ]
        self._beliefs = self.belief.unbind(1)

    def write(self, t: int, inputs: Inputs) -> None:
        """Copy the world's (S*L,) inputs into slot ``t``."""
        shape = self.slots[t][0].shape
        given = (inputs.observation, inputs.last_action, inputs.fresh, inputs.state)
        for slot, value in zip(self._flat[t], given, strict=True):
            slot.copy_(value)
        if self.belief_input.shape[-1]:
            self._beliefs[t].copy_(inputs.belief.view(*shape, -1))
            if self.layout.observed is not None:
                self.belief_input[:, t, :, : -self.layout.n_hidden] = self.layout.observed[
                    inputs.observed.view(shape)
                ]

    def one_hot(self, steps: int) -> Tensor:
        """Mark observation and last action of the first ``steps`` slots; (S, T*L, Ω + A + 1) float32."""
        parts = (
            one_hot(self.observation[:, :steps], self.layout.n_observations),
            one_hot(self.last_action[:, :steps], self.layout.n_actions + 1),
        )
        return torch.cat(parts, -1).flatten(1, 2)


def belief_input(layout: InputLayout, inputs: Inputs, seeds: int) -> Tensor:
    """(S, N, width) belief inputs straight from a world's lanes."""
    belief = inputs.belief.view(seeds, -1, inputs.belief.shape[-1])
    if layout.observed is None:
        return belief
    return torch.cat((layout.observed[inputs.observed.view(seeds, -1)], belief), -1)


class Branch:
    """Input, hidden layers and heads of the actor or of the critic."""

    def __init__(
        self,
        parameters: Parameters,
        name: str,
        kind: InputKind,
        layout: InputLayout,
        recurrence: Recurrence | None,
        *,
        outputs: int,
        gain: float,
        grounded: bool,
        layers: int,
    ) -> None:
        self.parameters, self.name, self.kind, self.layout = parameters, name, kind, layout
        self.recurrence = recurrence
        self._embedded_state = kind == "state" and layout.state is None
        if self._embedded_state:
            parameters.declare(f"{name}.state", (layout.n_states, EMBEDDING), normal)
        self.body = Body(parameters, f"{name}.body", self._input_width(), layers)
        self.head = Dense(parameters, f"{name}.head", HIDDEN, outputs, weight=orthogonal(gain))
        self.grounding: Dense | None = None
        if grounded:
            default = uniform_fan_in(HIDDEN)
            self.grounding = Dense(
                parameters, f"{name}.belief", HIDDEN, layout.n_hidden, weight=default, bias=default
            )

    def _input_width(self) -> int:
        if self.kind == "history":
            return HIDDEN
        if self.kind == "belief":
            return self.layout.belief_width
        return EMBEDDING if self.layout.state is None else self.layout.state.shape[1]

    def allocate(self, slots: int, lanes: int) -> None:
        """Create the activation buffers."""
        self.body.allocate(self.parameters, slots, lanes)

    def step(self, t: int, rollout: RolloutInputs) -> Tensor:
        """Output for slot ``t``: (S, L, outputs). A recurrent input must have stepped already."""
        return self.head.forward(self.body.step(t, self._inputs(rollout)[:, t]))

    def all_slots(self, rollout: RolloutInputs) -> Tensor:
        """Compute the outputs of all slots at once: (S, T+1, L, outputs)."""
        features = self.body.all_slots(self._inputs(rollout))
        return self.head.forward(features.flatten(1, 2)).view(*features.shape[:3], -1)

    def belief_logits(self, steps: int) -> Tensor:
        """Reconstructed belief b̂ of the first ``steps`` slots before the softmax: (S, T*L, Y)."""
        assert self.grounding is not None
        return self.grounding.forward(self.body.outputs[-1][:, :steps].flatten(1, 2))

    def infer(self, inputs: Tensor) -> Tensor:
        """Map inputs (S, N, in) to outputs (S, N, outputs), keeping nothing for training."""
        return self.head.forward(self.body.infer(inputs))

    def infer_inputs(self, inputs: Inputs, hidden: Tensor | None) -> Tensor:
        """Lay out a world's lanes as this branch's inputs (S, N, in); ``hidden`` if it is recurrent."""
        seeds = len(self.parameters.seeds)
        if self.kind == "history":
            assert hidden is not None
            return hidden
        if self.kind == "belief":
            return belief_input(self.layout, inputs, seeds)
        return self._state_vectors(inputs.state.view(seeds, -1))

    def _state_vectors(self, state: Tensor) -> Tensor:
        if self.layout.state is not None:
            return self.layout.state[state]
        table = self.parameters[f"{self.name}.state"]
        seed = torch.arange(len(table), device=table.device).view(-1, *(1,) * (state.ndim - 1))
        return table[seed, state]

    def _inputs(self, rollout: RolloutInputs) -> Tensor:
        if self.recurrence is not None:
            return self.recurrence.features
        if self.kind == "belief":
            return rollout.belief_input
        self._vectors = self._state_vectors(rollout.state)
        return self._vectors

    def backward(
        self, rollout: RolloutInputs, d_output: Tensor, d_belief: Tensor | None, steps: int
    ) -> Tensor | None:
        """Write gradients from those of the outputs (S, T*L, outputs) and the belief logits (S, T*L, Y).

        Returns the gradient of the recurrence's features (S, T*L, H), for a recurrent branch.
        """
        features = self.body.outputs[-1][:, :steps].flatten(1, 2)
        d = self.head.backward(features, features, d_output)
        assert d is not None
        if self.grounding is not None and d_belief is not None:
            grounded = self.grounding.backward(features, features, d_belief)
            assert grounded is not None
            d += grounded
        inputs = self._vectors if self.kind == "state" else self._inputs(rollout)
        wanted = self.recurrence is not None or self._embedded_state
        d_inputs = self.body.backward(inputs, d, steps, want_dx=wanted)
        if self._embedded_state and d_inputs is not None:
            marks = one_hot(rollout.state[:, :steps].flatten(1, 2), self.layout.n_states)
            torch.bmm(marks.transpose(1, 2), d_inputs, out=self.parameters.gradient(f"{self.name}.state"))
        return d_inputs


class AgentNetworks:
    """Actor and critic of one agent for a stack of seeds; parameters are zero until initialised or loaded."""

    def __init__(
        self,
        spec: AgentSpec,
        domain: Domain,
        settings: CommonHyperparameters,
        seeds: tuple[int, ...],
        device: torch.device,
    ) -> None:
        self.spec, self.settings = spec, settings
        self.layout = input_layout(domain, device)
        self.parameters = Parameters(seeds, device)
        shared = settings.shared_recurrence and spec.actor == spec.critic == "history"
        layers = {"history": settings.recurrent_hidden_layers}
        self.recurrences: list[Recurrence] = []
        actor_memory = self._recurrence("shared" if shared else "actor") if spec.actor == "history" else None
        self.actor = Branch(
            self.parameters,
            "actor",
            spec.actor,
            self.layout,
            actor_memory,
            outputs=self.layout.n_actions,
            gain=POLICY_GAIN,
            grounded=spec.grounded,
            layers=layers.get(spec.actor, FEEDFORWARD_LAYERS),
        )
        own_memory = None if shared or spec.critic != "history" else self._recurrence("critic")
        self.critic = Branch(
            self.parameters,
            "critic",
            spec.critic,
            self.layout,
            actor_memory if shared else own_memory,
            outputs=1,
            gain=VALUE_GAIN,
            grounded=spec.grounded,
            layers=layers.get(spec.critic, FEEDFORWARD_LAYERS),
        )
        self.parameters.allocate()

    def initialise(self) -> None:
        """Give every seed's parameters their random starting values."""
        self.parameters.initialise()
        if self.settings.feature_steepness:
            for layer, features in self._feature_layers():
                self.parameters.place_ridges(layer, features, self.settings.feature_steepness)

    def _feature_layers(self) -> Iterator[tuple[str, int]]:
        """Layers whose first inputs are features, and how many these are; none where inputs are embedded."""
        layout = self.layout
        if (
            layout.observation is None
            or layout.action is None
            or layout.observed is None
            or layout.state is None
        ):
            return
        for recurrence in self.recurrences:
            yield f"{recurrence.name}.input", layout.observation.shape[1] + layout.action.shape[1]
        widths = {"belief": layout.observed.shape[1], "state": layout.state.shape[1]}
        for branch in (self.actor, self.critic):
            if branch.kind != "history":
                yield f"{branch.name}.body.0", widths[branch.kind]

    def _recurrence(self, name: str) -> Recurrence:
        layout = self.layout
        observations = Lookup(
            self.parameters, f"{name}.observation", layout.n_observations, layout.observation
        )
        actions = Lookup(self.parameters, f"{name}.action", layout.n_actions + 1, layout.action)
        recurrence = Recurrence(self.parameters, f"{name}.gru", observations, actions)
        self.recurrences.append(recurrence)
        return recurrence

    def allocate(self, slots: int, lanes: int) -> None:
        """Create all activation buffers of a rollout with ``slots`` = T + 1."""
        for recurrence in self.recurrences:
            recurrence.allocate(slots, lanes)
        for branch in (self.actor, self.critic):
            branch.allocate(slots, lanes)

    def prepare(self) -> None:
        """Make this update's look-up tables; call after every change of the parameters."""
        for recurrence in self.recurrences:
            recurrence.prepare()

    @property
    def hidden_width(self) -> int:
        """Width of the actor's memory; zero for an actor without one."""
        return 0 if self.actor.recurrence is None else HIDDEN

    def actor_features(self, inputs: Inputs, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Features before the actor's heads (S, N, H), and its new memory."""
        if self.actor.recurrence is not None:
            shape = hidden.shape[:2]
            indices = (inputs.observation, inputs.last_action, inputs.fresh)
            hidden = self.actor.recurrence.infer(hidden, *(i.view(shape) for i in indices))
        return self.actor.body.infer(self.actor.infer_inputs(inputs, hidden)), hidden

    def actor_parameters(self) -> frozenset[str]:
        """Names of all parameters that acting and reconstructing the belief need."""
        own = (
            ("actor.",) if self.actor.recurrence is None else ("actor.", self._prefix(self.actor.recurrence))
        )
        return frozenset(name for name in self.parameters.shapes if name.startswith(own))

    @staticmethod
    def _prefix(recurrence: Recurrence) -> str:
        return recurrence.name.removesuffix("gru")
