"""The preamble of a .pomdp file: discount, values, the three spaces and the start distribution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite

import numpy as np
from lark import Token

from bgn.pomdp.errors import PomdpFormatError, fault
from bgn.pomdp.model import SUM_TOLERANCE, Floats

RESERVED = frozenset(
    (
        *("discount", "values", "states", "actions", "observations", "start", "include", "exclude"),
        *("reward", "cost", "uniform", "identity", "reset", "T", "O", "R"),
    )
)

MAX_SIZE = 1_000_000
"""Most states, actions or observations, and most pairs of state and action: beyond lies a slip of the pen."""


class Space:
    """The states, actions or observations of a file, and the ways to refer to them."""

    def __init__(self, kind: str, names: tuple[str, ...]) -> None:
        self.kind = kind
        self.names = names
        self._found: dict[str, Sequence[int]] = {"*": range(len(names))}
        self._found.update((name, (i,)) for i, name in enumerate(names))

    def __len__(self) -> int:
        return len(self.names)

    def find(self, reference: str) -> Sequence[int] | None:
        """Return the indices meant by a name, an index or ``*``; None if there is no such thing."""
        found = self._found.get(reference)
        if found is None and reference.isdecimal() and len(reference.lstrip("0")) <= len(str(len(self))):
            index = int(reference)
            found = (index,) if index < len(self) else None
            if found:
                self._found[reference] = found
        return found

    def unknown(self, reference: str) -> str:
        """Say why :meth:`find` found nothing."""
        if reference.isdecimal():
            return f"{self.kind} index {reference} is out of range; expected 0 to {len(self) - 1}"
        shown = ", ".join(self.names[:8]) + (", …" if len(self) > 8 else "")
        return f"unknown {self.kind} '{reference}'; expected one of {shown}"


def numbers(tokens: Sequence[Token], expected: int, what: str, *, probabilities: bool) -> Floats:
    """Return the ``expected`` finite numbers in the tokens (each a run of numbers), shape (expected,).

    Raises
    ------
    PomdpFormatError
        Too few or too many, an infinite one or, of probabilities, one outside [0, 1].
    """
    words = [word for token in tokens for word in token.split()]
    if len(words) != expected:
        raise fault(f"expected {expected} number(s) for {what}, found {len(words)}", tokens[0])
    values = np.array(words, dtype=np.float64)
    wrong = (values < 0) | (values > 1) if probabilities else ~np.isfinite(values)
    if wrong.any():
        at = int(wrong.argmax())
        wanted = "a probability between 0 and 1" if probabilities else "a finite number"
        raise _fault_at(f"expected {wanted} for {what}, found {words[at]}", tokens, at)
    return values


def number(token: Token, what: str, *, probability: bool) -> float:
    """Return the one number in the token, as :func:`numbers` does."""
    try:
        value = float(token)
    except ValueError:  # a run of several numbers
        value = inf
    if 0 <= value <= 1 or (isfinite(value) and not probability):
        return value
    return float(numbers([token], 1, what, probabilities=probability)[0])  # raises


def _fault_at(message: str, tokens: Sequence[Token], part: int) -> PomdpFormatError:
    """Return the error at the ``part``-th word of several tokens."""
    for token in tokens:
        words = len(token.split())
        if part < words:
            return fault(message, token, part)
        part -= words
    raise IndexError("no such word")


@dataclass
class Declarations:
    """Collects the preamble. Its methods are named after the rules of grammar.lark."""

    discount_value: float = 0.0
    sign: float = 1.0  # -1 for ``values: cost``
    spaces: dict[str, Space] = field(default_factory=dict)
    _start: tuple[str, list[Token]] | None = None
    _seen: dict[str, int] = field(default_factory=dict)  # the line of every declaration

    def discount(self, key: Token, value: Token) -> None:
        """``discount: 0.95``."""
        self._once(key)
        self.discount_value = number(value, "the discount", probability=True)

    def values(self, key: Token, kind: Token) -> None:
        """``values: reward`` or ``values: cost``."""
        self._once(key)
        self.sign = -1.0 if kind == "cost" else 1.0

    def space(self, key: Token, *items: Token) -> None:
        """``states: 3`` or ``states: left right`` and so on."""
        self._once(key)
        kind = str(key).removesuffix("s")
        if items[0].type == "COUNT":
            count = int(items[0]) if len(items[0].lstrip("0")) <= len(str(MAX_SIZE)) else MAX_SIZE + 1
            if not 1 <= count <= MAX_SIZE:
                raise fault(f"expected 1 to {MAX_SIZE} {key}, found {items[0]}", items[0])
            self.spaces[kind] = Space(kind, tuple(map(str, range(count))))
            return
        names: set[str] = set()
        for item in items:
            if item in RESERVED:
                raise fault(f"{str(item)!r} is a keyword; expected a name for a {kind}", item)
            if item in names:
                raise fault(f"{kind} {str(item)!r} is named twice", item)
            names.add(str(item))
        self.spaces[kind] = Space(kind, tuple(map(str, items)))

    def start(self, key: Token, *items: Token) -> None:
        """``start:`` a distribution, ``uniform``, a name or an index."""
        self._once(key)
        self._start = ("start", list(items))

    def start_include(self, key: Token, _: Token, *items: Token) -> None:
        """``start include: s1 s2``: uniform over these states."""
        self._once(key)
        self._start = ("include", list(items))

    def start_exclude(self, key: Token, _: Token, *items: Token) -> None:
        """``start exclude: s1 s2``: uniform over all others."""
        self._once(key)
        self._start = ("exclude", list(items))

    def _once(self, key: Token) -> None:
        if key in self._seen:
            raise fault(f"'{key}:' was already declared on line {self._seen[key]}", key)
        self._seen[str(key)] = key.line or 0

    def check_complete(self, line: int, column: int) -> None:
        """Raise at this place if a declaration is missing or the model is absurdly large."""
        for key in ("discount", "values", "states", "actions", "observations"):
            if key not in self._seen:
                raise PomdpFormatError(f"expected a '{key}:' declaration before this", line, column)
        pairs = len(self.spaces["state"]) * len(self.spaces["action"])
        if pairs > MAX_SIZE:
            message = f"expected at most {MAX_SIZE} pairs of state and action, found {pairs}"
            raise PomdpFormatError(message, line, column)

    def start_distribution(self) -> Floats:
        """Return the start distribution, shape (S,); uniform if the file does not say."""
        states = self.spaces["state"]
        form, tokens = self._start or ("start", [])
        if not tokens or tokens[0].type == "UNIFORM":
            return np.full(len(states), 1 / len(states))
        is_index = len(tokens) == 1 and tokens[0].isdecimal()
        if (
            form == "start"
            and tokens[0].type == "NUMBERS"
            and not (is_index and (len(states), tokens[0]) != (1, "1"))
        ):
            row = numbers(tokens, len(states), "the start distribution", probabilities=True)
            if abs(row.sum() - 1) > SUM_TOLERANCE:
                raise fault(
                    f"expected a start distribution that sums to 1, found a sum of {row.sum():.9g}", tokens[0]
                )
            return row
        chosen = np.zeros(len(states), dtype=np.bool_)
        for token in tokens:
            found = states.find(token)
            if found is None:
                raise fault(states.unknown(token), token)
            chosen[found] = True
        if form == "exclude":
            chosen = ~chosen
            if not chosen.any():
                raise fault("expected a state left to start in, but every one is excluded", tokens[-1])
        return np.where(chosen, 1 / chosen.sum(), 0.0)
