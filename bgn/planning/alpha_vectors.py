"""A policy and a lower bound in one: alpha vectors, each with the action it begins with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bgn.errors import InputError
from bgn.pomdp.model import Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class AlphaVectors:
    """V(b) = max_i α_i · b; the policy takes the action of the vector that attains it.

    Raises
    ------
    ValueError
        There is no vector, an entry is not finite, or the arrays do not match.
    """

    vectors: Floats  # (n, S)
    actions: NDArray[np.int64]  # (n,)

    def __post_init__(self) -> None:
        if self.vectors.ndim != 2 or self.vectors.size == 0:
            raise InputError(f"alpha vectors of shape {self.vectors.shape}; there must be one at least")
        if self.actions.shape != self.vectors.shape[:1]:
            raise InputError(f"{self.actions.size} actions for {len(self.vectors)} alpha vectors")
        if not np.isfinite(self.vectors).all():
            raise InputError("alpha vectors must be finite")
        if self.actions.min() < 0:
            raise InputError(f"an alpha vector has action {self.actions.min()}")

    def __len__(self) -> int:
        return len(self.vectors)

    def value(self, belief: Floats) -> float:
        """Return V(b) of a belief, shape (S,)."""
        return float((self.vectors @ belief).max())

    def action(self, belief: Floats) -> int:
        """Return the policy's action at a belief, shape (S,)."""
        return int(self.actions[(self.vectors @ belief).argmax()])
