"""Random tabular models for property tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse

from bgn.pomdp.model import POMDP

Generator = np.random.Generator


def distributions(rng: Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Random probabilities along the last axis, about half of them zero."""
    weights = rng.random(shape) * (rng.random(shape) < 0.5)
    keep = rng.integers(shape[-1], size=shape[:-1])
    np.put_along_axis(weights, keep[..., None], 0.1 + rng.random((*shape[:-1], 1)), axis=-1)
    return weights / weights.sum(axis=-1, keepdims=True)


def random_model(rng: Generator, S: int, A: int, O: int, *, named: bool = True) -> POMDP:
    """Return a random model in which some (a, s) end the episode."""
    start = distributions(rng, (S,))
    reset = rng.random((A, S)) < 0.2
    T = distributions(rng, (A, S, S))
    T[reset] = start
    axes = [n if rng.random() < 0.6 else 1 for n in (A, S, S, O)]
    return POMDP(
        transitions=tuple(sparse.csr_array(t) for t in T),
        observations=tuple(sparse.csr_array(o) for o in distributions(rng, (A, S, O))),
        rewards=np.round(rng.normal(size=axes), int(rng.integers(17))) * (rng.random(axes) < 0.7),
        start=start,
        reset=reset,
        discount=float(rng.random()),
        state_names=tuple(f"s-{i}_" if named else str(i) for i in range(S)),
        action_names=tuple(f"a{i}" if named else str(i) for i in range(A)),
        observation_names=tuple(f"O{i}" if named else str(i) for i in range(O)),
    )


@st.composite
def models(draw: st.DrawFn) -> POMDP:
    """Random models of up to 6 states, 3 actions and 4 observations."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = st.integers(1, 6), st.integers(1, 3), st.integers(1, 4)
    S, A, O = (draw(n) for n in size)
    return random_model(rng, S, A, O, named=draw(st.booleans()))
