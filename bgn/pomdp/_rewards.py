"""R of a .pomdp file."""

from __future__ import annotations

import numpy as np

from bgn.pomdp._contents import body_number, body_numbers, references
from bgn.pomdp._declarations import ALL, Space
from bgn.pomdp._entries import Entry
from bgn.pomdp._limits import Limits
from bgn.pomdp.errors import fault
from bgn.pomdp.model import Floats


class Rewards:
    """R: an array over (a, s, s', o) in which an axis that no entry mentions has length one."""

    def __init__(self, spaces: tuple[Space, Space, Space, Space], limits: Limits) -> None:
        self.spaces = spaces
        self._limits = limits
        self._entries: list[tuple[Entry, tuple[int | slice, ...], Floats | float]] = []
        self._mentioned = [False] * 4

    def add(self, entry: Entry) -> None:
        """Take in one entry: ``R: a : s : s' : o`` and a number, or fewer references and a row or a matrix.

        Raises
        ------
        PomdpFormatError
            It names something unknown, or its numbers are too many, too few, or not finite.
        """
        where = references(entry, self.spaces)
        for axis, (reference, space) in enumerate(zip(where, self.spaces, strict=False)):
            self._mentioned[axis] |= reference != ALL and len(space) > 1
        for axis in range(len(where), 4):
            self._mentioned[axis] = True
        index = tuple(slice(None) if reference == ALL else reference for reference in where)
        self._entries.append((entry, index, self._values(entry, len(where))))

    def _values(self, entry: Entry, references: int) -> Floats | float:
        rows, columns = len(self.spaces[2]), len(self.spaces[3])
        if references == 4:
            return body_number(entry, "a reward", probability=False)
        if references == 3:
            return body_numbers(entry, columns, "a row of R", probabilities=False)
        what = f"a matrix of R ({rows} rows of {columns})"
        return body_numbers(entry, rows * columns, what, probabilities=False).reshape(rows, columns)

    def array(self, sign: float) -> Floats:
        """Return the rewards times ``sign``, 4-D.

        Raises
        ------
        PomdpFormatError
            There are more of them than the limits allow.
        """
        shape = [len(space) if used else 1 for space, used in zip(self.spaces, self._mentioned, strict=True)]
        size = float(np.prod(shape, dtype=float))
        if size > self._limits.rewards:
            message = f"rewards over {' x '.join(map(str, shape))}: expected at most {self._limits.rewards}"
            raise fault(f"{message} of them", self._entries[-1][0].head_token)
        array = np.zeros(shape)
        writes = 0
        for entry, index, values in self._entries:
            place = tuple(
                0 if n == 1 and not isinstance(i, slice) else i for i, n in zip(index, shape, strict=False)
            )
            part = array[place]
            writes += part.size if isinstance(part, np.ndarray) else 1
            if writes > 4 * self._limits.rewards:
                message = (
                    f"the entries of R up to here, with what their '*' stand for, set rewards {writes} times"
                )
                raise fault(f"{message}; expected at most {4 * self._limits.rewards}", entry.head_token)
            array[place] = sign * values + 0.0  # + 0.0: a cost of 0 is a reward of 0, not -0
        return array
