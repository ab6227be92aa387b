"""All parameters of a stack of runs in one flat buffer, with named views into it.

Seeds are stacked on a leading axis, so that one batched product serves all of them. On a CPU the buffer goes
parameter by parameter, so that every view (S, *shape) is contiguous. On a GPU it goes seed by seed, so that norms,
clipping and the optimiser's step are one launch each for all parameters; products take strided views as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

#: Views start on cache lines, so that a seed's arithmetic does not depend on its place in the stack.
ALIGNMENT = 16

#: Added to a run's seed for :meth:`Parameters.place_ridges`, so that all other starting values stay as they are.
RIDGE_SEED = 2**32


def by_seed_on(device: torch.device) -> bool:
    """Say whether buffers on that device go seed by seed."""
    return device.type != "cpu"


Initialiser = Callable[[tuple[int, ...], torch.Generator], Tensor]


def orthogonal(gain: float) -> Initialiser:
    """Orthogonal initialisation of an (in, out) weight, as a transposed (out, in) matrix."""

    def initialise(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
        transposed = torch.empty(shape[1], shape[0])
        torch.nn.init.orthogonal_(transposed, gain, generator=generator)
        return transposed.T.contiguous()

    return initialise


def normal(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """N(0, 1), as embeddings start."""
    return torch.randn(shape, generator=generator)


def zeros(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Zeros, as biases start."""
    return torch.zeros(shape)


def uniform_fan_in(fan_in: int) -> Initialiser:
    """U(±1/√fan_in): torch's default for linear layers, kept by the belief heads."""

    def initialise(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
        return torch.empty(shape).uniform_(-1, 1, generator=generator) / math.sqrt(fan_in)

    return initialise


class Parameters:
    """Named parameters of S seeds with their gradients and RMSProp's running mean squares.

    Declare all names with :meth:`declare`, then :meth:`allocate`; after that ``[name]`` is a view
    (S, *shape) of the values and ``gradient(name)`` of the gradients.
    """

    def __init__(self, seeds: tuple[int, ...], device: torch.device) -> None:
        self.seeds = seeds
        self.device = device
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._initialisers: dict[str, Initialiser] = {}
        self._views: dict[str, Tensor] = {}
        self._gradients: dict[str, Tensor] = {}

    def declare(self, name: str, shape: tuple[int, ...], initialise: Initialiser) -> None:
        """Add a parameter; ``shape`` is without the seed axis."""
        if name in self._shapes:
            raise ValueError(f"parameter {name!r} is declared twice")
        self._shapes[name] = shape
        self._initialisers[name] = initialise

    def allocate(self) -> None:
        """Create the buffers, all zero."""
        n = len(self.seeds)
        self.goes_by_seed = by_seed_on(self.device)
        self.values = torch.zeros(n * sum(map(_padded, self._shapes.values())), device=self.device)
        self.gradients = torch.zeros_like(self.values)
        self.mean_squares = torch.zeros_like(self.values)
        self._views = self.views(self.values)
        self._gradients = self.views(self.gradients)
        self._flat_gradients = [view.flatten(1) for view in self._gradients.values()]

    def initialise(self) -> None:
        """Initialise the values; each seed draws from a generator of its own."""
        for row, seed in enumerate(self.seeds):
            generator = torch.Generator().manual_seed(seed)
            for name, shape in self._shapes.items():
                self._views[name][row] = self._initialisers[name](shape, generator).to(self.device)

    def place_ridges(self, layer: str, features: int, steepness: float) -> None:
        """Start a layer's units as ridges across the unit cube of its first ``features`` inputs.

        Their weights become N(0, ``steepness``²), and each unit's threshold x · w + b = 0 is put through a random
        point of the cube. Orthogonal weights of a wide layer with few inputs are small (1/√out) beside zero
        biases: all its units then are nearly linear in the features, and RMSProp's steps, which have a fixed
        size, take millions of samples to bend them. Draws from a generator of its own.
        """
        weight, bias = self[f"{layer}.weight"], self[f"{layer}.bias"]
        for row, seed in enumerate(self.seeds):
            generator = torch.Generator().manual_seed(seed + RIDGE_SEED)
            slopes = steepness * torch.randn(features, weight.shape[2], generator=generator)
            points = torch.rand(slopes.shape, generator=generator)
            weight[row, :features] = slopes.to(self.device)
            bias[row] = -(slopes * points).sum(0).to(self.device)

    def __getitem__(self, name: str) -> Tensor:
        return self._views[name]

    def gradient(self, name: str) -> Tensor:
        """Return the (S, *shape) view of a parameter's gradient."""
        return self._gradients[name]

    def of_seed(self, row: int, prefix: str = "") -> Mapping[str, Tensor]:
        """Copy one seed's parameters to the host, without the seed axis."""
        return {n: v[row].detach().cpu().clone() for n, v in self._views.items() if n.startswith(prefix)}

    def load(self, row: int, tensors: Mapping[str, Tensor]) -> None:
        """Overwrite one seed's parameters; ``tensors`` must name some of them with their exact shapes."""
        for name, tensor in tensors.items():
            if name not in self._shapes or tuple(tensor.shape) != self._shapes[name]:
                expected = self._shapes.get(name, "no such parameter")
                raise ValueError(f"parameter {name!r} of shape {tuple(tensor.shape)}: expected {expected}")
            self._views[name][row] = tensor

    def by_seed(self, buffer: Tensor) -> list[list[Tensor]]:
        """View a buffer of this layout as one list of parameter-sized vectors a seed."""
        views = self.views(buffer).values()
        return [[view[row].flatten() for view in views] for row in range(len(self.seeds))]

    def views(self, buffer: Tensor) -> dict[str, Tensor]:
        """View a buffer of this layout as named tensors (S, *shape)."""
        n, views, offset = len(self.seeds), {}, 0
        for name, shape in self._shapes.items():
            size = math.prod(shape)
            if self.goes_by_seed:
                views[name] = buffer.view(n, -1)[:, offset : offset + size].view(n, *shape)
                offset += _padded(shape)
            else:
                views[name] = buffer[offset : offset + n * size].view(n, *shape)
                offset += n * _padded(shape)
        return views

    def gradient_norms(self) -> Tensor:
        """L2 norm of each seed's gradient: (S,)."""
        if self.goes_by_seed:
            whole: Tensor = torch.linalg.vector_norm(self.gradients.view(len(self.seeds), -1), dim=1)
            return whole
        parts = [torch.linalg.vector_norm(gradient, dim=1) for gradient in self._flat_gradients]
        # Along rows: down columns, torch adds up one seed's parts in another order alone than beside others.
        norms: Tensor = torch.linalg.vector_norm(torch.stack(parts, 1), dim=1)
        return norms

    @property
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shapes by name, without the seed axis."""
        return self._shapes


def _padded(shape: tuple[int, ...]) -> int:
    return -(-math.prod(shape) // ALIGNMENT) * ALIGNMENT
