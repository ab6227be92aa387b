"""A domain of the benchmark: a model, its episode rules, and how agents see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from bgn.domains.layout import GridLayout, TouchLayout
from bgn.pomdp.model import MOMDP

#: Marks a field that no computation depends on: changing it makes no stored result older.
FOR_PEOPLE: Final[Mapping[str, Any]] = MappingProxyType({"for people": True})


@dataclass(frozen=True, eq=False, kw_only=True)
class Features:
    """Physically meaningful network inputs, min-max normalised into [0, 1] (paper, Appendix B)."""

    observation: NDArray[np.float32]  # (Ω, f): what the history agents see
    observed: NDArray[np.float32]  # (X, f): the known part of a belief input (x, b_Y)
    state: NDArray[np.float32]  # (S, f): what Ah-Cs's critic sees


@dataclass(frozen=True, eq=False, kw_only=True)
class Domain:
    """One domain: everything a simulator, an agent or a planner needs to know about it."""

    id: str
    """Stable name in the registry, the store and the command line, e.g. ``rocksample-4-4``."""
    title: str = field(metadata=FOR_PEOPLE)
    """The name as the paper prints it, e.g. ``RockSample[4,4]``."""
    family: Literal["classic", "robot"]
    """``classic`` inputs are indices (embedded); ``robot`` inputs are the normalised ``features``."""
    model: MOMDP
    """Exact tables. Taking a in s with ``reset[a, s]`` earns its reward and ends the episode."""
    episode_limit: int
    """Counted steps after which an episode is cut (paper, Tables 4 and 5)."""
    training_discount: float
    """γ of the returns the agents are trained on."""
    report_discount: float
    """γ of the returns the tables report: the model's own for classic domains, 1 for success rates."""
    hidden_first_action: bool = False
    """Whether an episode opens with an unseen uniformly random action (authors' code, classic domains)."""
    features: Features | None = None
    """Network inputs of a robot domain; ``None`` where states, observations and actions are embedded."""
    prior: NDArray[np.float64] | None = None
    """(X, Y) start belief given x where a variant's belief differs from its sampler; ``None``: Bayes."""
    elimination: NDArray[np.bool_] | None = None
    """(X, Y) hidden parts an elimination belief keeps on seeing x; ``None``: the exact filter."""
    layout: GridLayout | TouchLayout | None = field(default=None, metadata=FOR_PEOPLE)
    """Where the states lie on a map; for a robot domain, where finger and objects are."""
