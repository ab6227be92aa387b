"""What an entry of a .pomdp file says: what its head refers to, and the numbers of its body."""

from __future__ import annotations

from collections.abc import Sequence

from bgn.pomdp._declarations import Space, numbers, read_numbers
from bgn.pomdp._entries import Entry
from bgn.pomdp.errors import fault
from bgn.pomdp.model import Floats

_REFERENCE = r"[A-Za-z0-9_*-]+"


def references(entry: Entry, spaces: Sequence[Space]) -> list[int]:
    """Return the indices (or ``ALL``) that an entry's head (``T: a : s``) refers to, one for each colon."""
    found = []
    for i, (reference, space) in enumerate(zip(entry.references, spaces, strict=False)):
        index = space.find(reference)
        if index is None:
            raise fault(space.unknown(reference), entry.head_token, i + 1, _REFERENCE)
        found.append(index)
    return found


def body_numbers(entry: Entry, expected: int, what: str, *, probabilities: bool) -> Floats:
    """Return the numbers of an entry's body as :func:`bgn.pomdp._declarations.numbers` does."""
    words = entry.body.split()
    if len(words) == expected:
        values, wrong = read_numbers(words, probabilities=probabilities)
        if not wrong.any():
            return values
    return numbers([entry.body_token], expected, what, probabilities=probabilities)  # raises


def body_number(entry: Entry, what: str, *, probability: bool) -> float:
    """Return the one number of an entry's body."""
    try:
        value = float(entry.body)
    except ValueError:  # several numbers
        value = float("inf")
    if 0 <= value <= 1 or (not probability and abs(value) < float("inf")):
        return value
    return float(body_numbers(entry, 1, what, probabilities=probability)[0])  # raises
