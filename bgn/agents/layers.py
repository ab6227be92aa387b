"""Seed-stacked layers with hand-written backward passes.

A rollout keeps every activation in a buffer (S, T+1, L, width): S seeds, T steps and one bootstrap slot,
L lanes. Acting fills one slot at a time; what need not be known to act is computed for all slots at once, as
one large product. The forward pass of acting *is* the forward pass of training: nothing is computed twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from bgn.agents.parameters import Initialiser, Parameters, normal, orthogonal, zeros

#: Width of every hidden layer (paper, Tables 2 and 3).
HIDDEN = 256
#: Width of an embedding (paper, Table 2).
EMBEDDING = 128


def one_hot(indices: Tensor, n: int) -> Tensor:
    """Mark ``indices`` (…) in float32 (…, n), without looking at their values as torch's own does."""
    return (indices[..., None] == torch.arange(n, device=indices.device)).float()


_MINUS_ONE = torch.tensor(-1.0)


def tanh_of_half(x: Tensor, out: Tensor | None = None) -> Tensor:
    """Return tanh(x / 2) = 2 σ(x) - 1, overwriting ``x``: on a CPU, half the time of torch's tanh.

    Off by at most 1e-7. Doubling what goes in is free where it is a product's scale, and exact.
    """
    return torch.add(_MINUS_ONE, x.sigmoid_(), alpha=2, out=out)


class Dense:
    """y = x W + b, optionally through tanh; W (in, out)."""

    def __init__(
        self,
        parameters: Parameters,
        name: str,
        n_in: int,
        n_out: int,
        *,
        tanh: bool = False,
        weight: Initialiser | None = None,
        bias: Initialiser = zeros,
    ) -> None:
        self.parameters, self.name, self.tanh = parameters, name, tanh
        self.n_in, self.n_out = n_in, n_out
        parameters.declare(f"{name}.weight", (n_in, n_out), weight or orthogonal(math.sqrt(2)))
        parameters.declare(f"{name}.bias", (n_out,), bias)

    def forward(self, x: Tensor, out: Tensor | None = None) -> Tensor:
        """Map (S, N, in) to (S, N, out); with ``out``, that is where the result of the tanh goes."""
        W, b = self.parameters[f"{self.name}.weight"], self.parameters[f"{self.name}.bias"]
        if self.n_out == 1 and out is None:
            # MKL multiplies by a single column in another order alone than in a batch: a run would depend on
            # the seeds beside it.
            return torch.sum(x * W.transpose(1, 2), -1, keepdim=True).add_(b[:, None])
        if not self.tanh:
            return torch.baddbmm(b[:, None], x, W)
        return tanh_of_half(torch.baddbmm(b[:, None], x, W, beta=2, alpha=2), out)

    def backward(self, x: Tensor, y: Tensor, dy: Tensor, *, want_dx: bool = True) -> Tensor | None:
        """Write the parameters' gradients; return the input's."""
        if self.tanh:
            dy = torch.ops.aten.tanh_backward(dy, y)
        W, dW = self.parameters[f"{self.name}.weight"], self.parameters.gradient(f"{self.name}.weight")
        torch.sum(dy, 1, out=self.parameters.gradient(f"{self.name}.bias"))
        if self.n_out == 1:  # too narrow for a product to be fast
            torch.sum(x * dy, 1, out=dW[..., 0])
            return dy * W.transpose(1, 2) if want_dx else None
        torch.bmm(x.transpose(1, 2), dy, out=dW)
        return torch.bmm(dy, W.transpose(1, 2)) if want_dx else None


class Lookup:
    """Vectors for indices, times a weight: a table of products, made once per update.

    Embed(index) · W has only as many distinct rows as there are indices. The vectors are learned (classic
    domains) or given features (robot domains).
    """

    def __init__(self, parameters: Parameters, name: str, n: int, features: Tensor | None) -> None:
        self.parameters, self.name, self.n, self.features = parameters, name, n, features
        if features is None:
            parameters.declare(name, (n, EMBEDDING), normal)
        self.width = EMBEDDING if features is None else features.shape[1]

    def vectors(self) -> Tensor:
        """(S or 1, n, width)."""
        return self.parameters[self.name] if self.features is None else self.features[None]

    def products(self, weight: Tensor) -> Tensor:
        """Return vectors · ``weight`` (S, width, m) as (S, n, m)."""
        return torch.matmul(self.vectors(), weight)

    def backward(self, weight: Tensor, d_products: Tensor, d_weight: Tensor) -> None:
        """Write the gradients of the vectors and of ``weight`` into ``d_weight``."""
        vectors = self.vectors().expand(len(weight), -1, -1)
        torch.bmm(vectors.transpose(1, 2), d_products, out=d_weight)
        if self.features is None:
            torch.bmm(d_products, weight.transpose(1, 2), out=self.parameters.gradient(self.name))


class _Slot(NamedTuple):
    """Where one step of a recurrence goes, each (S, L, width); None: into memory of its own."""

    entering: Tensor | None = None  # what is left of the memory
    recalled: Tensor | None = None  # its product with the recurrent weights of n
    rz: Tensor | None = None
    n: Tensor | None = None
    features: Tensor | None = None  # the memory after


class _GateGradients(NamedTuple):
    """Where the gradients of one step's pre-activations go, each (S, L, H)."""

    input_n: Tensor
    r: Tensor
    z: Tensor
    recurrent_n: Tensor
    recurrent: Tensor  # (S, L, 3H): the last three

    @classmethod
    def within(cls, slot: Tensor) -> _GateGradients:
        """Split (S, L, 4H)."""
        input_n, r, z, recurrent_n = slot.chunk(4, -1)
        return cls(input_n, r, z, recurrent_n, slot[..., HIDDEN:])


class Recurrence:
    """A GRU over (observation, last action) pairs, with truncated back-propagation through one rollout.

    Gates are the usual r, z, n (Cho et al. 2014). The input weights hold them in the order (n, r, z), the
    recurrent ones as (r, z, n): then the gradients of both are slices of one buffer (dn_i, dr, dz, dn_h).
    """

    def __init__(self, parameters: Parameters, name: str, observations: Lookup, actions: Lookup) -> None:
        self.parameters, self.name = parameters, name
        self.observations, self.actions = observations, actions
        width = observations.width + actions.width
        parameters.declare(f"{name}.input.weight", (width, 3 * HIDDEN), orthogonal(1.0))
        parameters.declare(f"{name}.input.bias", (3 * HIDDEN,), zeros)
        parameters.declare(f"{name}.recurrent.weight", (HIDDEN, 3 * HIDDEN), orthogonal(1.0))
        parameters.declare(f"{name}.recurrent.bias", (3 * HIDDEN,), zeros)

    def allocate(self, slots: int, lanes: int) -> None:
        """Create the activation buffers and the carried hidden state (zero)."""
        seeds, device = len(self.parameters.seeds), self.parameters.device

        def buffer(width: int) -> Tensor:
            return torch.zeros(seeds, slots, lanes, width, device=device)

        self.entering, self.features = buffer(HIDDEN), buffer(HIDDEN)
        self.recalled, self.rz, self.n = buffer(HIDDEN), buffer(2 * HIDDEN), buffer(HIDDEN)
        self.d_gates = buffer(4 * HIDDEN)
        self._d_slots = [_GateGradients.within(slot) for slot in self.d_gates.unbind(1)]
        written = (self.entering, self.recalled, self.rz, self.n, self.features)
        self._memories = self.features.unbind(1)
        self._slots = [_Slot(*views) for views in zip(*(b.unbind(1) for b in written), strict=True)]
        self.hidden = torch.zeros(seeds, lanes, HIDDEN, device=device)

    def prepare(self) -> None:
        """Make this update's look-up tables, (S, Ω, 3H) and (S, A + 1, 3H)."""
        W, split = self.parameters[f"{self.name}.input.weight"], self.observations.width
        bias = self.parameters[f"{self.name}.input.bias"]
        seed = torch.arange(len(W), device=W.device)[:, None]
        self._first_observation, self._first_action = seed * self.observations.n, seed * self.actions.n
        self._observation_rows = self.observations.products(W[:, :split]).add_(bias[:, None]).flatten(0, 1)
        self._action_rows = self.actions.products(W[:, split:]).flatten(0, 1)

    def _gates_of_input(self, observation: Tensor, last_action: Tensor) -> Tensor:
        """(S, N) indices to (S, N, 3H) pre-activations."""
        seen = (self._first_observation + observation).flatten()
        done = (self._first_action + last_action).flatten()
        gates = self._observation_rows.index_select(0, seen).add_(self._action_rows.index_select(0, done))
        return gates.view(*observation.shape, -1)

    def step(self, t: int, observation: Tensor, last_action: Tensor, fresh: Tensor) -> Tensor:
        """Fill slot ``t`` from (S, L) indices, memory being empty where ``fresh``; returns (S, L, H)."""
        before = self.hidden if t == 0 else self._memories[t - 1]
        return self._advance(before, observation, last_action, fresh, self._slots[t])

    def carry(self, steps: int) -> None:
        """Keep the memory after ``steps`` steps for the next rollout."""
        self.hidden.copy_(self.features[:, steps - 1])

    def infer(self, hidden: Tensor, observation: Tensor, last_action: Tensor, fresh: Tensor) -> Tensor:
        """Advance any (S, N, H) memory by one step, keeping nothing for training."""
        return self._advance(hidden, observation, last_action, fresh, _Slot())

    def _advance(
        self, hidden: Tensor, observation: Tensor, last_action: Tensor, fresh: Tensor, slot: _Slot
    ) -> Tensor:
        """Return the memory after one input, keeping in ``slot`` what it has place for."""
        W = self.parameters[f"{self.name}.recurrent.weight"]
        b = self.parameters[f"{self.name}.recurrent.bias"].unsqueeze(1)
        input_n, input_rz = self._gates_of_input(observation, last_action).split_with_sizes(
            (HIDDEN, 2 * HIDDEN), -1
        )
        h = torch.mul(hidden, (~fresh).float().unsqueeze(2), out=slot.entering)
        recurrent_rz, recalled = torch.baddbmm(b, h, W).split_with_sizes((2 * HIDDEN, HIDDEN), -1)
        if slot.recalled is not None:
            slot.recalled.copy_(recalled)
        r, z = torch.add(input_rz, recurrent_rz, out=slot.rz).sigmoid_().chunk(2, -1)
        n = tanh_of_half(input_n.addcmul_(r, recalled).mul_(2), slot.n)
        return torch.lerp(n, h, z, out=slot.features)

    def backward(self, d_features: Tensor, steps: int, one_hot: Tensor, fresh: Tensor) -> None:
        """Back-propagate (S, T, L, H) through the T steps of the rollout and write all gradients.

        ``one_hot`` (S, T*L, Ω + A + 1) marks each input's observation and last action; ``fresh`` (S, T, L).
        """
        W = self.parameters[f"{self.name}.recurrent.weight"].transpose(1, 2)
        h, n = self.entering[:, :steps], self.n[:, :steps]
        r, z = self.rz[:, :steps, :, :HIDDEN], self.rz[:, :steps, :, HIDDEN:]
        per_z = torch.ops.aten.sigmoid_backward(h - n, z)
        per_n = torch.ops.aten.tanh_backward(1 - z, n)
        per_r = torch.ops.aten.sigmoid_backward(self.recalled[:, :steps], r)
        goes_on = (~fresh).float()[..., None]
        through = z * goes_on
        factors = (d_features, per_n, per_r, per_z, r, goes_on, through)
        by_step = list(zip(*(factor.unbind(1) for factor in factors), self._d_slots[:steps], strict=True))
        d_hidden: Tensor | None = None
        for t in reversed(range(steps)):
            d, by_n, by_r, by_z, r_t, on, kept, slot = by_step[t]
            dh = d if d_hidden is None else d_hidden.add_(d)
            dn = torch.mul(dh, by_n, out=slot.input_n)
            torch.mul(dn, by_r, out=slot.r)
            torch.mul(dh, by_z, out=slot.z)
            torch.mul(dn, r_t, out=slot.recurrent_n)
            if t > 0:
                d_hidden = torch.bmm(slot.recurrent, W).mul_(on).addcmul_(dh, kept)
        gates = self.d_gates[:, :steps].flatten(1, 2)  # (S, T*L, 4H)
        self._write_gradients(gates, h.flatten(1, 2), one_hot)

    def _write_gradients(self, gates: Tensor, h: Tensor, one_hot: Tensor) -> None:
        p, name = self.parameters, self.name
        torch.bmm(h.transpose(1, 2), gates[..., HIDDEN:], out=p.gradient(f"{name}.recurrent.weight"))
        sums = gates.sum(1)
        p.gradient(f"{name}.recurrent.bias").copy_(sums[:, HIDDEN:])
        p.gradient(f"{name}.input.bias").copy_(sums[:, : 3 * HIDDEN])
        d_rows = torch.bmm(one_hot.transpose(1, 2), gates[..., : 3 * HIDDEN])  # (S, Ω + A + 1, 3H)
        W, dW = p[f"{name}.input.weight"], p.gradient(f"{name}.input.weight")
        n, split = self.observations.n, self.observations.width
        self.observations.backward(W[:, :split], d_rows[:, :n], dW[:, :split])
        self.actions.backward(W[:, split:], d_rows[:, n:], dW[:, split:])


class Body:
    """The FC(256) + tanh layers between an input and its heads."""

    def __init__(self, parameters: Parameters, name: str, n_in: int, layers: int) -> None:
        widths = [n_in] + [HIDDEN] * layers
        self.layers = [
            Dense(parameters, f"{name}.{i}", widths[i], widths[i + 1], tanh=True) for i in range(layers)
        ]

    def allocate(self, parameters: Parameters, slots: int, lanes: int) -> None:
        """Create the activation buffers."""
        shape = (len(parameters.seeds), slots, lanes, HIDDEN)
        self.outputs = [torch.zeros(shape, device=parameters.device) for _ in self.layers]
        self._slots = [output.unbind(1) for output in self.outputs]

    def step(self, t: int, x: Tensor) -> Tensor:
        """Fill slot ``t`` from x (S, L, in); returns the features (S, L, H)."""
        for layer, slots in zip(self.layers, self._slots, strict=True):
            x = layer.forward(x, out=slots[t])
        return x

    def all_slots(self, x: Tensor) -> Tensor:
        """Fill all slots from x (S, T+1, L, in) in one product a layer; returns (S, T+1, L, H)."""
        flat = x.flatten(1, 2)
        for layer, output in zip(self.layers, self.outputs, strict=True):
            flat = layer.forward(flat, out=output.flatten(1, 2))
        return self.outputs[-1]

    def infer(self, x: Tensor) -> Tensor:
        """Map (S, N, in) to features (S, N, H), keeping nothing."""
        for layer in self.layers:
            x = layer.forward(x)
        return x

    def backward(self, x: Tensor, d_features: Tensor, steps: int, *, want_dx: bool) -> Tensor | None:
        """Back-propagate (S, T*L, H); ``x`` is the input buffer (S, T+1, L, in)."""
        d: Tensor | None = d_features
        for i in reversed(range(len(self.layers))):
            below = x if i == 0 else self.outputs[i - 1]
            inputs, outputs = (b[:, :steps].flatten(1, 2) for b in (below, self.outputs[i]))
            assert d is not None
            d = self.layers[i].backward(inputs, outputs, d, want_dx=want_dx or i > 0)
        return d
