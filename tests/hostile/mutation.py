"""Damages files: what a bad disk, a torn download, a careless editor or an enemy does to one."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

MAGIC = (
    b"\x00",
    b"\xff",
    b"\xff\xff\xff\x7f",
    b"\xff\xff\xff\xff\xff\xff\xff\x7f",
    b"\x80\x00\x00\x00",
    b"-1",
    b"1e999",
    b"nan",
    b"0.5",
    b"9" * 5000,
    b"0" * 5000 + b"1",
    b"1000000000",
    b"[" * 200,
    b"\xf0\x28\x8c\x28",
    "é٣".encode(),
)

Damage = Callable[[random.Random, bytearray, Sequence[bytes]], None]


def mutate(content: bytes, seed: int, pieces: Sequence[bytes] = ()) -> bytes:
    """Return the content with one to four random damages; ``pieces`` are words of the format to put in."""
    rng = random.Random(seed)
    damaged = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        rng.choice(_DAMAGES)(rng, damaged, pieces)
    return bytes(damaged)


def refusal(call: Callable[[], object], error: type[Exception]) -> str | None:
    """Return the message of the error that a call raises, None if it raises none; others pass through."""
    try:
        call()
    except error as caught:
        return str(caught)
    return None


def _place(rng: random.Random, content: bytearray) -> int:
    # Headers, at either end, matter most.
    if rng.random() < 0.5:
        return min(len(content), rng.choice((rng.randrange(64), max(0, len(content) - rng.randrange(64)))))
    return rng.randint(0, len(content))


def _flip(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    if content:
        content[min(_place(rng, content), len(content) - 1)] ^= 1 << rng.randrange(8)


def _insert(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    at = _place(rng, content)
    content[at:at] = rng.choice((*MAGIC, *pieces))


def _overwrite(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    at = _place(rng, content)
    piece = rng.choice((*MAGIC, *pieces))
    content[at : at + len(piece)] = piece


def _delete(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    at = _place(rng, content)
    del content[at : at + rng.choice((1, 4, 30, 1000))]


def _repeat(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    at = _place(rng, content)
    content[at:at] = content[at : at + rng.choice((1, 10, 100))] * rng.choice((1, 3, 50))


def _move(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    start = _place(rng, content)
    part = content[start : start + rng.choice((5, 50, 500))]
    at = _place(rng, content)
    content[at:at] = part


def _cut(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    del content[_place(rng, content) :]


def _change_number(rng: random.Random, content: bytearray, pieces: Sequence[bytes]) -> None:
    digits = [i for i in range(len(content)) if 48 <= content[i] <= 57]
    if digits:
        at = rng.choice(digits)
        content[at : at + 1] = rng.choice((b"0", b"7", b"-3", b"99999999999", b"1e400", b"0" * 4400 + b"1"))


_DAMAGES: tuple[Damage, ...] = (_flip, _insert, _overwrite, _delete, _repeat, _move, _cut, _change_number)
