"""T and O of a .pomdp file: for every action and state a row of probabilities; the last entry wins.

Entries are only noted while they are read. A ``*`` in one is a slice of three arrays over (action, state):
which body the row was last set to as a whole, by which entry, and which entry was the last to say anything
about it. The probabilities are then gathered for all rows at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bgn.pomdp._contents import body_number, body_numbers, references
from bgn.pomdp._declarations import ALL, Space
from bgn.pomdp._entries import Entry
from bgn.pomdp._limits import Limits
from bgn.pomdp.errors import PomdpFormatError, fault
from bgn.pomdp.model import SUM_TOLERANCE, Floats

Ints = NDArray[np.int64]

# What a whole row was set to: a row of numbers, counted from zero, or one of these.
_NOTHING: Final = -1
_RESET: Final = -2
_IDENTITY: Final = -3
_CONSTANT: Final = -4  # and below: the same number in every column
_NAMED: Final = {"reset": _RESET, "identity": _IDENTITY}


@dataclass(frozen=True)
class _Pool:
    """Non-zero columns and values of rows, one after another; row i is at starts[i], counts[i] long."""

    columns: Ints
    values: Floats
    starts: Ints
    counts: Ints


class Table:
    """T or O."""

    def __init__(self, letter: str, actions: Space, states: Space, columns: Space, limits: Limits) -> None:
        self.letter = letter
        self.spaces = (actions, states, columns)
        self._limits = limits
        self._writes = 0
        shape = len(actions), len(states)
        self._body = np.full(shape, _NOTHING, dtype=np.int32)
        self._filled = np.full(shape, -1, dtype=np.int32)  # the entry that set the body
        self._last = np.full(shape, -1, dtype=np.int32)
        self._entries: list[Entry] = []
        self._rows: list[Floats] = []  # (k, columns) each
        self._row_count = 0
        self._constants: dict[float, int] = {}
        # Entry, action, state, column and probability of what was set one by one; ALL for ``*``.
        self._single: list[tuple[int, int, int, int]] = []
        self._probabilities: list[float] = []

    def add(self, entry: Entry) -> None:
        """Take in one entry of this letter.

        Raises
        ------
        PomdpFormatError
            It names something unknown, or its numbers are too many, too few, or no probabilities.
        """
        where = references(entry, self.spaces)
        self._entries.append(entry)
        action, state = where[0], where[1] if len(where) > 1 else ALL
        self._count(entry, action, state)
        if len(where) == 3:
            self._element(entry, action, state, where[2])
        else:
            self._fill(action, state, self._whole(entry, matrix=len(where) == 1))

    def _element(self, entry: Entry, action: int, state: int, column: int) -> None:
        p = body_number(entry, "a probability", probability=True)
        if column == ALL:
            self._fill(action, state, self._constant(p))
            return
        n = len(self._entries) - 1
        self._single.append((n, action, state, column))
        self._probabilities.append(p)
        self._last[_at(action), _at(state)] = n

    def _whole(self, entry: Entry, *, matrix: bool) -> int | Ints:
        """Return the body of a row, or the bodies of all states' rows."""
        states, columns = (len(space) for space in self.spaces[1:])
        if entry.body == "uniform":
            return self._constant(1 / columns)
        if entry.body in _NAMED:
            return _NAMED[entry.body]
        count = states if matrix else 1
        what = (
            f"a matrix of {self.letter} ({states} rows of {columns})" if matrix else f"a row of {self.letter}"
        )
        values = body_numbers(entry, count * columns, what, probabilities=True)
        self._rows.append(values.reshape(count, columns))
        first = self._row_count
        self._row_count += count
        return np.arange(first, first + count) if matrix else first

    def _constant(self, p: float) -> int:
        return _CONSTANT - self._constants.setdefault(p, len(self._constants))

    def _fill(self, action: int, state: int, body: int | Ints) -> None:
        where = _at(action), _at(state)
        self._body[where] = body
        self._filled[where] = self._last[where] = len(self._entries) - 1

    def _count(self, entry: Entry, action: int, state: int) -> None:
        actions, states, _ = self.spaces
        self._writes += (len(actions) if action == ALL else 1) * (len(states) if state == ALL else 1)
        if self._writes > self._limits.writes:
            message = f"the entries of {self.letter} up to here, with what their '*' stand for, set rows"
            wanted = f"{self._writes} times; expected at most {self._limits.writes}"
            raise fault(f"{message} {wanted}", entry.head_token)

    def resets(self) -> NDArray[np.bool_]:
        """Return which (action, state) rows are ``reset``, shape (A, S)."""
        reset: NDArray[np.bool_] = (self._body == _RESET) & (self._filled == self._last)
        return reset

    def arrays(self, restart: Floats | None, end: tuple[int, int]) -> tuple[sparse.csr_array, ...]:
        """Return one (S, columns) array per action, ``restart`` in place of ``reset`` rows.

        Raises
        ------
        PomdpFormatError
            More probabilities than the limits allow, or a row that does not sum to one: at its last entry or,
            if it has none, at ``end``.
        """
        actions, states, columns = self.spaces
        S = len(states)
        indptr, indices, data = self._gather(restart, end)
        arrays = []
        for a in range(len(actions)):
            bounds = indptr[a * S : (a + 1) * S + 1]
            here = slice(bounds[0], bounds[-1])
            local = (bounds - bounds[0]).astype(np.int32)
            array = sparse.csr_array((data[here], indices[here], local), shape=(S, len(columns)))
            sums = np.asarray(array.sum(axis=1)).ravel()
            wrong = np.abs(sums - 1) > SUM_TOLERANCE
            if wrong.any():
                s = int(wrong.argmax())
                raise self._bad_row(a, s, float(sums[s]), end)
            arrays.append(array)
        return tuple(arrays)

    def _gather(self, restart: Floats | None, end: tuple[int, int]) -> tuple[Ints, NDArray[np.int32], Floats]:
        """Return the bounds of all rows (A·S + 1,), and the columns and values of their non-zeros."""
        pool = self._pool(restart, end)
        rows = self._pool_rows()
        counts = pool.counts[rows]
        singles, total = self._singles_count()
        self._check_size(int(counts.sum()) + total, end)
        offsets = np.cumsum(counts) - counts
        at = np.repeat(pool.starts[rows] - offsets, counts) + np.arange(int(counts.sum()))
        columns, values = pool.columns[at].astype(np.int32), pool.values[at]
        if total:
            counts, columns, values = self._override(counts, columns, values, singles)
        return np.concatenate([[0], np.cumsum(counts)]), columns, values

    def _pool(self, restart: Floats | None, end: tuple[int, int]) -> _Pool:
        """Return the non-zeros of: nothing, a reset, the constants, the identity's rows, the rows of numbers."""
        width, S = len(self.spaces[2]), len(self.spaces[1])
        constants = [p for p in self._constants if p]
        self._check_size(len(constants) * width, end)
        start = np.zeros(0) if restart is None else restart
        (start_columns,) = start.nonzero()
        stacked = np.concatenate(self._rows) if self._rows else np.zeros((0, width))
        row, column = stacked.nonzero()
        everywhere = np.arange(width)
        identity = np.arange(S)
        columns = np.concatenate([start_columns, *[everywhere] * len(constants), identity, column])
        ones = np.ones(S)
        values = np.concatenate(
            [start[start_columns], np.repeat(constants, width), ones, stacked[row, column]]
        )
        counts = np.concatenate(
            [
                [0, len(start_columns)],
                [width if p else 0 for p in self._constants],
                np.ones(S, dtype=np.int64),
                np.bincount(row, minlength=len(stacked)),
            ]
        ).astype(np.int64)
        return _Pool(columns, values, np.cumsum(counts) - counts, counts)

    def _pool_rows(self) -> Ints:
        """Return which row of the pool each (action, state) row is, shape (A·S,)."""
        S, constants = len(self.spaces[1]), len(self._constants)
        body = self._body.ravel()
        rows = body.astype(np.int64) + (2 + constants + S)
        rows[body == _NOTHING] = 0
        # What is set in a reset row one by one makes it an ordinary row.
        rows[body == _RESET] = 0
        rows[self.resets().ravel()] = 1
        constant = body <= _CONSTANT
        rows[constant] = 2 + _CONSTANT - body[constant]
        (identity,) = (body == _IDENTITY).nonzero()
        rows[identity] = 2 + constants + identity % S
        return rows

    def _singles_count(self) -> tuple[Ints, int]:
        """Return the probabilities set one by one, shape (n, 4), and how many there are with every ``*``."""
        singles = np.array(self._single, dtype=np.int64).reshape(-1, 4)
        actions, states, _ = self.spaces
        many = np.where(singles[:, 1] == ALL, len(actions), 1) * np.where(
            singles[:, 2] == ALL, len(states), 1
        )
        return singles, int(many.sum())

    def _override(
        self, counts: Ints, columns: NDArray[np.int32], values: Floats, singles: Ints
    ) -> tuple[Ints, NDArray[np.int32], Floats]:
        """Put what was set one by one into rows: their lengths, columns and values."""
        actions, states, width = (len(space) for space in self.spaces)
        n_states = np.where(singles[:, 2] == ALL, states, 1)
        many = np.where(singles[:, 1] == ALL, actions, 1) * n_states
        which = np.repeat(np.arange(len(singles)), many)
        place = np.arange(len(which)) - np.repeat(np.cumsum(many) - many, many)
        entry, action, state, column = singles[which].T
        action = np.where(action == ALL, place // n_states[which], action)
        state = np.where(state == ALL, place % n_states[which], state)
        row = action * states + state
        live = entry > self._filled.ravel()[row]  # not overwritten by a later whole row
        keys = np.concatenate(
            [
                np.repeat(np.arange(len(counts)), counts) * width + columns,
                (row * width + column)[live],
            ]
        )
        merged = np.concatenate([values, np.array(self._probabilities)[which[live]]])
        order = np.argsort(keys, kind="stable")
        keys, merged = keys[order], merged[order]
        kept = np.append(keys[1:] != keys[:-1], True) & (merged != 0)
        # Of equal keys only the last may stay, and it only if it is not zero.
        keys = keys[kept]
        lengths = np.bincount(keys // width, minlength=len(counts))
        return lengths, (keys % width).astype(np.int32), merged[kept]

    def _check_size(self, size: int, end: tuple[int, int]) -> None:
        if size > self._limits.probabilities:
            message = f"{self.letter} has {size} probabilities; expected at most {self._limits.probabilities}"
            raise PomdpFormatError(message, *end)

    def _bad_row(self, a: int, s: int, total: float, end: tuple[int, int]) -> PomdpFormatError:
        actions, states, _ = self.spaces
        name = f"{self.letter}: {actions.names[a]} : {states.names[s]}"
        last = int(self._last[a, s])
        if last < 0:
            return PomdpFormatError(
                f"expected an entry for the row '{name}' before the end of the file", *end
            )
        message = f"expected the row '{name}' to sum to 1, found a sum of {total:.9g}"
        return fault(message, self._entries[last].head_token)


def _at(reference: int) -> int | slice:
    return slice(None) if reference == ALL else reference
