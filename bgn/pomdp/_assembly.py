"""The entries of a .pomdp file, put together: the last entry wins, what none mentions is zero."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from lark import Token
from numpy.typing import NDArray
from scipy import sparse

from bgn.pomdp._declarations import Declarations, Space, number, numbers
from bgn.pomdp.errors import PomdpFormatError, fault
from bgn.pomdp.model import POMDP, SUM_TOLERANCE, Floats

MAX_NUMBERS = 50_000_000
"""Most non-zero probabilities of a table, and most rewards, that are held in memory (0.4 to 0.6 GB)."""

_COMMENT = re.compile(r"#[^\n]*")
_REFERENCE = r"[A-Za-z0-9_*-]+"

# A row of probabilities: the non-zero ones by column, or a whole row that may be shared, or RESET.
Row = dict[int, float] | Floats | None
RESET: Final = None


class Table:
    """T or O: one row of probabilities for every action and state."""

    def __init__(self, letter: str, actions: Space, states: Space, columns: Space) -> None:
        self.letter = letter
        self.spaces = (actions, states, columns)
        self._rows: dict[int, Row] = {}  # by action * S + state
        self._written: dict[int, Token] = {}  # the last entry's head, to point at

    def element(self, head: Token, value: Token) -> None:
        """Set one probability, or several by ``*``."""
        actions, states, columns = references(head, self.spaces)
        p = number(value, "a probability", probability=True)
        if len(columns) == len(self.spaces[2]):
            self._fill(head, actions, states, np.full(len(columns), p))
            return
        for key in self._keys(actions, states):
            row = self._rows.get(key)
            if not isinstance(row, dict):
                row = self._rows[key] = (
                    {} if row is None else {int(c): float(row[c]) for c in row.nonzero()[0]}
                )
            row.update(dict.fromkeys(columns, p))
            self._written[key] = head

    def row(self, head: Token, *body: Token) -> None:
        """Set a whole row: numbers, ``uniform`` or ``reset``."""
        actions, states = references(head, self.spaces[:2])
        n = len(self.spaces[2])
        if body[0].type == "NUMBERS":
            self._fill(head, actions, states, numbers(body, n, f"a row of {self.letter}", probabilities=True))
        else:
            self._fill(head, actions, states, RESET if body[0].type == "RESET" else np.full(n, 1 / n))

    def matrix(self, head: Token, *body: Token) -> None:
        """Set all rows of an action: numbers, ``uniform`` or ``identity``."""
        (actions,) = references(head, self.spaces[:1])
        rows, columns = len(self.spaces[1]), len(self.spaces[2])
        if body[0].type == "UNIFORM":
            self._fill(head, actions, range(rows), np.full(columns, 1 / columns))
        elif body[0].type == "IDENTITY":
            for s in range(rows):
                for key in self._keys(actions, (s,)):
                    self._rows[key] = {s: 1.0}
                    self._written[key] = head
        else:
            what = f"a matrix of {self.letter} ({rows} rows of {columns})"
            values = numbers(body, rows * columns, what, probabilities=True).reshape(rows, columns)
            for s in range(rows):
                self._fill(head, actions, (s,), values[s])

    def _keys(self, actions: Sequence[int], states: Sequence[int]) -> list[int]:
        S = len(self.spaces[1])
        return [a * S + s for a in actions for s in states]

    def _fill(self, head: Token, actions: Sequence[int], states: Sequence[int], row: Row) -> None:
        for key in self._keys(actions, states):
            self._rows[key] = row
            self._written[key] = head

    def resets(self) -> NDArray[np.bool_]:
        """Return which (action, state) rows are ``reset``, shape (A, S)."""
        actions, states, _ = self.spaces
        flags = np.zeros(len(actions) * len(states), dtype=np.bool_)
        flags[[key for key, row in self._rows.items() if row is RESET]] = True
        return flags.reshape(len(actions), len(states))

    def arrays(self, restart: Floats | None, end: tuple[int, int]) -> tuple[sparse.csr_array, ...]:
        """Return one (S, columns) array per action, ``restart`` in place of ``reset`` rows.

        Raises
        ------
        PomdpFormatError
            A row that does not sum to one, at its last entry or, if it has none, at ``end``.
        """
        actions, states, _ = self.spaces
        size = sum(len(states) if row is RESET else len(row) for row in self._rows.values())
        if size > MAX_NUMBERS:
            message = f"{self.letter} has {size} probabilities; expected at most {MAX_NUMBERS}"
            raise PomdpFormatError(message, *end)
        arrays = tuple(self._array(a, restart) for a in range(len(actions)))
        for a, array in enumerate(arrays):
            sums = np.asarray(array.sum(axis=1)).ravel()
            wrong = np.abs(sums - 1) > SUM_TOLERANCE
            if wrong.any():
                s = int(wrong.argmax())
                raise self._bad_row(a, s, float(sums[s]), end)
        return arrays

    def _array(self, a: int, restart: Floats | None) -> sparse.csr_array:
        S, width = len(self.spaces[1]), len(self.spaces[2])
        nonzeros: dict[int, tuple[NDArray[np.int64], Floats]] = {}  # of shared rows, by identity
        columns, values, counts = [], [], [0]
        for s in range(S):
            row = self._rows.get(a * S + s, {})
            if row is RESET:
                assert restart is not None  # the grammar has no reset rows in O
                row = restart
            if isinstance(row, dict):
                part = np.fromiter(row, np.int64, len(row)), np.fromiter(row.values(), np.float64, len(row))
            else:
                if id(row) not in nonzeros:
                    at = row.nonzero()[0]
                    nonzeros[id(row)] = at, row[at]
                part = nonzeros[id(row)]
            columns.append(part[0])
            values.append(part[1])
            counts.append(len(part[0]))
        indices = np.concatenate(columns).astype(np.int32)
        array = sparse.csr_array(
            (np.concatenate(values), indices, np.cumsum(counts, dtype=np.int32)), shape=(S, width)
        )
        array.eliminate_zeros()
        array.sort_indices()
        return array

    def _bad_row(self, a: int, s: int, total: float, end: tuple[int, int]) -> PomdpFormatError:
        actions, states, _ = self.spaces
        name = f"{self.letter}: {actions.names[a]} : {states.names[s]}"
        head = self._written.get(a * len(states) + s)
        if head is None:
            return PomdpFormatError(
                f"expected an entry for the row '{name}' before the end of the file", *end
            )
        return fault(f"expected the row '{name}' to sum to 1, found a sum of {total:.9g}", head)


class Rewards:
    """R: an array over (a, s, s', o) in which an axis that no entry mentions has length one."""

    def __init__(self, *spaces: Space) -> None:
        self.spaces = spaces
        self._entries: list[tuple[Token, tuple[int | slice, ...], Floats | np.float64]] = []

    def element(self, head: Token, value: Token) -> None:
        """Set R(a, s, s', o)."""
        self._write(head, np.float64(number(value, "a reward", probability=False)))

    def row(self, head: Token, *body: Token) -> None:
        """Set R(a, s, s', .)."""
        n = len(self.spaces[3])
        self._write(head, numbers(body, n, "a row of R", probabilities=False))

    def matrix(self, head: Token, *body: Token) -> None:
        """Set R(a, s, ., .)."""
        rows, columns = len(self.spaces[2]), len(self.spaces[3])
        what = f"a matrix of R ({rows} rows of {columns})"
        self._write(head, numbers(body, rows * columns, what, probabilities=False).reshape(rows, columns))

    def _write(self, head: Token, values: Floats | np.float64) -> None:
        found = references(head, self.spaces[: 4 - values.ndim])
        index = tuple(
            slice(None) if len(indices) == len(space) else indices[0]
            for indices, space in zip(found, self.spaces, strict=False)
        )
        self._entries.append((head, index, values))

    def array(self) -> Floats:
        """Return the rewards, 4-D."""
        mentioned = [False] * 4
        for _, index, _values in self._entries:
            for axis in range(4):
                mentioned[axis] |= axis >= len(index) or not isinstance(index[axis], slice)
        shape = [len(space) if used else 1 for space, used in zip(self.spaces, mentioned, strict=True)]
        if np.prod(shape, dtype=float) > MAX_NUMBERS:
            message = f"rewards over {' x '.join(map(str, shape))}: expected at most {MAX_NUMBERS} of them"
            raise fault(message, self._entries[-1][0])
        array = np.zeros(shape)
        for _, index, values in self._entries:
            array[index] = values
        return array


def references(head: Token, spaces: Sequence[Space]) -> list[Sequence[int]]:
    """Return the indices that an entry's head (``T: a : s``) refers to, one item per space."""
    parts = (_COMMENT.sub("", head) if "#" in head else head).split(":")[1:]
    found = []
    for i, (part, space) in enumerate(zip(parts, spaces, strict=True)):
        reference = part.strip()
        indices = space.find(reference)
        if indices is None:
            plain = Token.new_borrow_pos(head.type, _COMMENT.sub(lambda m: " " * len(m[0]), head), head)
            raise fault(space.unknown(reference), plain, i + 1, _REFERENCE)
        found.append(indices)
    return found


def assemble(
    declarations: Declarations,
    transitions: Table,
    observations: Table,
    rewards: Rewards,
    end: tuple[int, int],
) -> POMDP:
    """Return the model of a whole file; ``end`` is the line and column where it ends."""
    start = declarations.start_distribution()
    return POMDP(
        transitions=transitions.arrays(start, end),
        observations=observations.arrays(None, end),
        rewards=rewards.array() * declarations.sign + 0.0,  # + 0.0: a cost of 0 is a reward of 0, not -0
        start=start,
        reset=transitions.resets(),
        discount=declarations.discount_value,
        state_names=declarations.spaces["state"].names,
        action_names=declarations.spaces["action"].names,
        observation_names=declarations.spaces["observation"].names,
    )
