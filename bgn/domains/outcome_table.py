"""The compiled outcome of every move of a force-feedback domain, as data.

A table says which reading follows each (reading, move, hidden part) and what was pushed on the way. It is
compiled from physics by ``bgn compile`` and stored as ``NAME.npz`` with a ``NAME.json``
header.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bgn.errors import BgnError

SHIPPED: Final = Path(__file__).parent / "tables"


class OutcomeTableError(BgnError, ValueError):
    """A stored table is missing or damaged; the message says which and what to do."""


@dataclass(frozen=True, kw_only=True)
class Header:
    """Where a table comes from and what was checked while it was compiled."""

    domain: str
    key: str
    """SHA-256 of the scene's XML, its parameters and the MuJoCo version."""
    mujoco: str
    pairs: int
    """(x, move, y) combinations that occur."""
    histories: int
    """Fewest different histories that any pair was stepped from; all of them agreed."""
    margin: float
    """Smallest distance of any measurement to its threshold, as a fraction of the gap it splits."""
    digest: str
    """SHA-256 of the arrays."""


@dataclass(frozen=True, eq=False)
class OutcomeTable:
    """A compiled table over (reading, move, hidden part)."""

    reading: NDArray[np.int16]
    """(R, A, H) reading after the move, -1 where the combination cannot occur."""
    pushed: NDArray[np.int8]
    """(R, A, H) 0, or the 1-based index of the bump that was pushed, negative if to the left."""
    header: Header


def digest(reading: NDArray[np.int16], pushed: NDArray[np.int8]) -> str:
    """Return the SHA-256 of a table's arrays and their shape."""
    content = hashlib.sha256(repr(reading.shape).encode())
    content.update(reading.astype("<i2").tobytes())
    content.update(pushed.astype("i1").tobytes())
    return content.hexdigest()


def save(outcomes: OutcomeTable, stem: Path) -> None:
    """Write ``stem.npz`` and then ``stem.json``, so that a header implies its arrays."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(stem.with_suffix(".npz"), reading=outcomes.reading, pushed=outcomes.pushed)
    stem.with_suffix(".json").write_text(json.dumps(asdict(outcomes.header), indent=2) + "\n")


def load(stem: Path) -> OutcomeTable:
    """Read a table.

    Raises
    ------
    OutcomeTableError
        The table is missing, damaged, or not the one its header describes.
    """
    remedy = "recompile it with `bgn compile --force`"
    try:
        header = Header(**json.loads(stem.with_suffix(".json").read_text()))
        with stem.with_suffix(".npz").open("rb") as file, np.load(file) as arrays:
            reading, pushed = arrays["reading"], arrays["pushed"]
    except FileNotFoundError as error:
        raise OutcomeTableError(f"no compiled table {error.filename}; {remedy}") from None
    except Exception as error:  # zip, json and numpy each have their own way of saying that a file is damaged
        raise OutcomeTableError(f"the compiled table {stem} is damaged ({error}); {remedy}") from error
    if digest(reading, pushed) != header.digest:
        raise OutcomeTableError(f"the compiled table {stem}.npz is not the one of its header; {remedy}")
    return OutcomeTable(reading, pushed, header)
