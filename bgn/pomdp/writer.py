"""Writes the .pomdp file format, exactly: reading the text again gives the same model, bit for bit."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bgn.pomdp._declarations import RESERVED
from bgn.pomdp.model import POMDP, ModelError

# The non-zero columns and values of a row of probabilities; None stands for ``reset``.
_Row = tuple[list[int], list[float]] | None

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def save(model: POMDP, path: str | PathLike[str], *, comment: str = "") -> None:
    """Write a model to a .pomdp file; ``comment`` goes to its head.

    Raises
    ------
    ModelError
        The model has a name that the format cannot express, or a ``reset`` row that is not the start.
    """
    Path(path).write_text(dumps(model, comment=comment), encoding="utf-8", newline="\n")


def dumps(model: POMDP, *, comment: str = "") -> str:
    """Return the text of a model's .pomdp file; see :func:`save`."""
    _check_resets(model)
    sections = (
        (f"# {line}".rstrip() for line in comment.splitlines()),
        _preamble(model),
        _entries("T", model.transitions, model, model.state_names, model.reset),
        _entries("O", model.observations, model, model.observation_names),
        _rewards(model),
    )
    return "\n".join("\n".join(lines) + "\n" for section in sections if (lines := list(section)))


def _check_resets(model: POMDP) -> None:
    for a, s in np.argwhere(model.reset):
        row = model.transitions[a][[s]].toarray().ravel()
        if not np.array_equal(row, model.start):
            where = f"({model.action_names[a]}, {model.state_names[s]})"
            raise ModelError(f"the reset row of {where} is not the start distribution")


def _preamble(model: POMDP) -> Iterator[str]:
    yield f"discount: {_number(model.discount)}"
    yield "values: reward"
    yield f"states: {_space(model.state_names, 'state')}"
    yield f"actions: {_space(model.action_names, 'action')}"
    yield f"observations: {_space(model.observation_names, 'observation')}"
    yield _start(model)


def _space(names: tuple[str, ...], kind: str) -> str:
    if names == tuple(map(str, range(len(names)))):
        return str(len(names))
    for name in names:
        if not _NAME.fullmatch(name) or name in RESERVED:
            raise ModelError(f"the .pomdp format has no {kind} name {name!r}")
    if len(set(names)) != len(names):
        raise ModelError(f"two of the {kind}s share a name")
    return " ".join(names)


def _start(model: POMDP) -> str:
    """Return the shortest of ``include``, ``exclude`` and the row that means exactly these numbers."""
    names, start = model.state_names, model.start
    (inside,), (outside,) = np.nonzero(start), np.nonzero(start == 0)
    if not np.array_equal(start[inside], np.full(len(inside), 1 / len(inside))):
        return f"start: {_numbers(start)}"
    if len(outside) == 0:
        return "start: uniform"
    if len(inside) <= len(outside):
        return f"start include: {' '.join(names[s] for s in inside)}"
    return f"start exclude: {' '.join(names[s] for s in outside)}"


def _entries(
    letter: str,
    tables: Sequence[sparse.csr_array],
    model: POMDP,
    columns: Sequence[str],
    reset: NDArray[np.bool_] | None = None,
) -> Iterator[str]:
    """Write T or O row by row, with ``*`` where a row is the same for all actions or for all states."""
    rows = [_rows(table) for table in tables]  # rows[a][s]
    for a, s in [] if reset is None else np.argwhere(reset):
        rows[a][s] = None
    done = [all(row == of_action[0] for row in of_action) for of_action in rows]
    for a, of_action in enumerate(rows):
        if done[a]:
            yield from _row(f"{letter}: {model.action_names[a]} : *", of_action[0], columns)
    for s, state in enumerate(model.state_names):
        if not any(done) and all(of_action[s] == rows[0][s] for of_action in rows):
            yield from _row(f"{letter}: * : {state}", rows[0][s], columns)
            continue
        for a, action in enumerate(model.action_names):
            if not done[a]:
                yield from _row(f"{letter}: {action} : {state}", rows[a][s], columns)


def _rows(table: sparse.csr_array) -> list[_Row]:
    """Return every row's non-zero columns and values."""
    table = table.copy()
    table.sum_duplicates()
    table.eliminate_zeros()
    bounds = zip(table.indptr[:-1], table.indptr[1:], strict=True)
    return [(table.indices[i:j].tolist(), table.data[i:j].tolist()) for i, j in bounds]


def _row(head: str, row: _Row, columns: Sequence[str]) -> Iterator[str]:
    """Write a row element by element if it is sparse, else in full."""
    if row is None:
        yield f"{head} reset"
    elif len(row[0]) <= len(columns) / 2 or len(row[0]) == 1:
        yield from (f"{head} : {columns[c]} {_number(p)}" for c, p in zip(*row, strict=True))
    else:
        full = np.zeros(len(columns))
        full[row[0]] = row[1]
        yield f"{head}\n{_numbers(full)}"


def _rewards(model: POMDP) -> Iterator[str]:
    """Write the non-zero rewards, with ``*`` for what they do not depend on."""
    R = model.rewards
    for axis in range(4):
        first = R.take([0], axis)
        R = first if (first == R).all() else R
    names = (model.action_names, model.state_names, model.state_names, model.observation_names)
    labels = [("*",) if n == 1 else name for n, name in zip(R.shape, names, strict=True)]
    for index in np.argwhere(R):
        head = " : ".join(label[i] for label, i in zip(labels, index, strict=True))
        yield f"R: {head} {_number(R[tuple(index)])}"


def _number(value: float) -> str:
    """Return the shortest text that reads as this number."""
    return repr(float(value)).removesuffix(".0")


def _numbers(values: Iterable[float]) -> str:
    return " ".join(map(_number, values))
