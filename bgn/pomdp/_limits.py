"""How much a .pomdp file may ask for, so that a short one cannot take hours or all memory.

A file grows with the numbers it spells out, but a count or a ``*`` stands for many. What those may come to is
bounded by constants for any file, and by more for a longer one: a megabyte of anything is read or refused in
about a second and 512 MB.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

MAX_BYTES: Final = 1 << 29
"""Longest file that is read at all."""
MAX_SIZE: Final = 1_000_000
"""Most states, actions or observations, and most pairs of state and action: beyond lies a slip of the pen."""
MAX_ACTIONS: Final = 1_000
"""Most actions: each is a table of its own."""


@dataclass(frozen=True)
class Limits:
    """What a file of a certain length may ask for."""

    probabilities: int
    """Most non-zero probabilities in T, and in O."""
    rewards: int
    """Most rewards that are told apart, zeros included; entries may set four times as many."""
    writes: int
    """Most rows that the entries of T, and of O, with what their ``*`` stand for, may set."""

    @classmethod
    def of(cls, length: int) -> Limits:
        """Return the limits of a file of so many characters."""
        return cls(
            probabilities=3_000_000 + 3 * length,
            rewards=8_000_000 + 3 * length,
            writes=30_000_000 + 100 * length,
        )
