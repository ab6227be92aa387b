"""The preamble of a .pomdp file: discount, values, the three spaces and the start distribution."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from lark import Token
from numpy.typing import NDArray

from bgn.pomdp._limits import MAX_ACTIONS, MAX_SIZE
from bgn.pomdp.errors import PomdpFormatError, fault, shown, without_comments
from bgn.pomdp.model import SUM_TOLERANCE, Floats

RESERVED = frozenset(
    (
        *("discount", "values", "states", "actions", "observations", "start", "include", "exclude"),
        *("reward", "cost", "uniform", "identity", "reset", "T", "O", "R"),
    )
)

ALL: Final = -1
"""What :meth:`Space.find` returns for ``*``."""


class Space:
    """The states, actions or observations of a file, and the ways to refer to them."""

    def __init__(self, kind: str, names: tuple[str, ...], *, numbered: bool = False) -> None:
        self.kind = kind
        self.names = names
        self._found = {"*": ALL}
        if not numbered:  # indices are found as they are met: of a million most never are
            self._found.update((name, i) for i, name in enumerate(names))

    def __len__(self) -> int:
        return len(self.names)

    def find(self, reference: str) -> int | None:
        """Return the index meant by a name or an index, ``ALL`` for ``*``; None if there is no such thing."""
        found = self._found.get(reference)
        if found is None and reference.isdecimal():
            digits = reference.lstrip("0") or "0"
            if len(digits) <= len(str(len(self))) and int(digits) < len(self):
                found = self._found[reference] = int(digits)
        return found

    def unknown(self, reference: str) -> str:
        """Say why :meth:`find` found nothing."""
        if reference.isdecimal():
            return f"{self.kind} index {shown(reference)} is out of range; expected 0 to {len(self) - 1}"
        known = ", ".join(map(shown, self.names[:8])) + (", …" if len(self) > 8 else "")
        return f"unknown {self.kind} '{shown(reference)}'; expected one of {known}"


def words(tokens: Iterable[Token]) -> list[str]:
    """Return the words of several runs of them."""
    return [word for token in tokens for word in without_comments(token).split()]


def numbers(tokens: Sequence[Token], expected: int, what: str, *, probabilities: bool) -> Floats:
    """Return the ``expected`` finite numbers in the tokens (each a run of numbers), shape (expected,).

    Raises
    ------
    PomdpFormatError
        Too few or too many, an infinite one or, of probabilities, one outside [0, 1].
    """
    found = words(tokens)
    if len(found) != expected:
        raise fault(f"expected {expected} number(s) for {what}, found {len(found)}", tokens[0])
    values, wrong = read_numbers(found, probabilities=probabilities)
    if wrong.any():
        at = int(wrong.argmax())
        wanted = "a probability between 0 and 1" if probabilities else "a finite number"
        raise fault_at(f"expected {wanted} for {what}, found {shown(found[at])}", tokens, at)
    return values


def read_numbers(words: Sequence[str], *, probabilities: bool) -> tuple[Floats, NDArray[np.bool_]]:
    """Return numbers, and which of them are infinite or no probabilities."""
    values = np.fromiter(map(float, words), np.float64, len(words))
    return values, (values < 0) | (values > 1) if probabilities else ~np.isfinite(values)


def fault_at(message: str, tokens: Sequence[Token], part: int) -> PomdpFormatError:
    """Return the error at the ``part``-th word of several tokens."""
    for token in tokens:
        count = len(words([token]))
        if part < count:
            return fault(message, token, part)
        part -= count
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
        self.discount_value = float(numbers([value], 1, "the discount", probabilities=True)[0])

    def values(self, key: Token, kind: Token) -> None:
        """``values: reward`` or ``values: cost``."""
        self._once(key)
        self.sign = -1.0 if kind == "cost" else 1.0

    def space(self, key: Token, *items: Token) -> None:
        """``states: 3`` or ``states: left right`` and so on."""
        self._once(key)
        kind = str(key).removesuffix("s")
        if items[0].type == "COUNT":
            count = self._count(key, items[0])
            self.spaces[kind] = Space(kind, tuple(map(str, range(count))), numbered=True)
            return
        names = words(items)
        seen: set[str] = set()
        for i, name in enumerate(names):
            if name in RESERVED:
                raise fault_at(f"{name!r} is a keyword; expected a name for a {kind}", items, i)
            if name in seen:
                raise fault_at(f"{kind} {shown(name)!r} is named twice", items, i)
            seen.add(name)
        self.spaces[kind] = Space(kind, tuple(names))

    @staticmethod
    def _count(key: Token, token: Token) -> int:
        digits = token.lstrip("0") or "0"
        count = int(digits) if len(digits) <= len(str(MAX_SIZE)) else MAX_SIZE + 1
        if not 1 <= count <= MAX_SIZE:
            raise fault(f"expected 1 to {MAX_SIZE} {key}, found {shown(token)}", token)
        return count

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
        actions = len(self.spaces["action"])
        if actions > MAX_ACTIONS:
            raise PomdpFormatError(f"expected at most {MAX_ACTIONS} actions, found {actions}", line, column)
        pairs = len(self.spaces["state"]) * actions
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
        named = words(tokens)
        for i, word in enumerate(named):
            found = states.find(word)
            if found is None:
                raise fault_at(states.unknown(word), tokens, i)
            chosen[found] = True
        if form == "exclude":
            chosen = ~chosen
            if not chosen.any():
                message = "expected a state left to start in, but every one is excluded"
                raise fault_at(message, tokens, len(named) - 1)
        return np.where(chosen, 1 / chosen.sum(), 0.0)
