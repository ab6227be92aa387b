"""Readable ids of what is stored: cells, runs and reference rows; made and parsed here and nowhere else.

- a cell is a domain and an agent: ``hallway/ah-ch+bgn``;
- a run is a cell and a seed: ``hallway/ah-ch+bgn/seed-3``;
- a reference row is a policy that is not trained, on a domain, under a convention: ``hallway/sarsop/clean``.

``str()`` makes the text, ``parse`` takes it apart. The parts are names of the registry, which are folder names
in the store as well.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self, cast, get_args

from bgn.domains.episode_opening import EpisodeOpening
from bgn.errors import InputError

_NAME = re.compile(r"[a-z0-9][a-z0-9.+_-]*")
_SEED = re.compile(r"seed-(0|[1-9][0-9]*)")


class RunIdError(InputError):
    """A text is not an id, or a name cannot be part of one; the message says what an id looks like."""


def check_name(name: str) -> None:
    """Raise :class:`RunIdError` unless a name may be part of an id."""
    if not _NAME.fullmatch(name):
        raise RunIdError(
            f"{name!r} cannot be part of an id: lower-case letters, digits, '.', '+', '_' and '-' only"
        )


@dataclass(frozen=True, order=True)
class CellId:
    """A domain and an agent."""

    domain: str
    agent: str

    def __post_init__(self) -> None:
        check_name(self.domain)
        check_name(self.agent)

    def __str__(self) -> str:
        return f"{self.domain}/{self.agent}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``hallway/ah-ch+bgn``."""
        return cls(*_split(text, 2, "a cell id: DOMAIN/AGENT, such as hallway/ah-ch+bgn"))


@dataclass(frozen=True, order=True)
class RunId:
    """A cell and a seed."""

    cell: CellId
    seed: int

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise RunIdError(f"seed {self.seed} is negative; seeds are 0, 1, 2, …")

    def __str__(self) -> str:
        return f"{self.cell}/seed-{self.seed}"

    @classmethod
    def of(cls, domain: str, agent: str, seed: int) -> Self:
        """Return the id of a run from its parts."""
        return cls(CellId(domain, agent), seed)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``hallway/ah-ch+bgn/seed-3``."""
        expected = "a run id: DOMAIN/AGENT/seed-N, such as hallway/ah-ch+bgn/seed-3"
        domain, agent, last = _split(text, 3, expected)
        seed = _SEED.fullmatch(last)
        if not seed:
            raise RunIdError(f"{text!r} is not {expected}")
        return cls(CellId(domain, agent), int(seed[1]))


@dataclass(frozen=True, order=True)
class ReferenceId:
    """A policy that is not trained, on a domain, with its episodes opened in one way."""

    domain: str
    reference: str
    convention: EpisodeOpening

    def __post_init__(self) -> None:
        check_name(self.domain)
        check_name(self.reference)

    def __str__(self) -> str:
        return f"{self.domain}/{self.reference}/{self.convention}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``hallway/sarsop/clean``."""
        conventions = get_args(EpisodeOpening)
        expected = (
            f"a reference id: DOMAIN/REFERENCE/{' or '.join(conventions)}, such as hallway/sarsop/clean"
        )
        domain, reference, convention = _split(text, 3, expected)
        if convention not in conventions:
            raise RunIdError(f"{text!r} is not {expected}")
        return cls(domain, reference, cast("EpisodeOpening", convention))


def _split(text: str, parts: int, expected: str) -> list[str]:
    names = text.split("/")
    if len(names) != parts or not all(map(_NAME.fullmatch, names)):
        raise RunIdError(f"{text!r} is not {expected}")
    return names
