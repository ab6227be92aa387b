"""Domains that a .pomdp file defines: no module of this package builds them, whoever uses them declares them.

A declaration holds the file's text, not its path: what a worker process (or another machine) is handed is what
was hashed, whatever becomes of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from bgn.domains.domain import Domain
from bgn.domains.registry import get, ids, register
from bgn.errors import InputError
from bgn.pomdp.model import MOMDP

_DECLARED: dict[str, tuple[FileDomain, Domain]] = {}


@dataclass(frozen=True, kw_only=True)
class FileDomain:
    """A model in the .pomdp format, and the rules of its episodes."""

    id: str
    title: str
    source: str
    """Where the text comes from, for messages."""
    text: str
    """A model in the .pomdp format; taking a in s with a ``reset`` row ends the episode."""
    episode_limit: int
    """Steps after which an episode is cut."""
    training_discount: float | None = None
    """γ of the returns that agents are trained on; None: the model's own."""
    report_discount: float | None = None
    """γ of the returns that tables report; None: the model's own."""
    hidden_first_action: bool = False
    """Whether episodes of agents open with an unseen, uniformly random action."""

    def build(self) -> Domain:
        """Read the model.

        Raises
        ------
        bgn.pomdp.PomdpFormatError
            The text is not a valid model.
        """
        from bgn.pomdp.reader import loads  # imported here: the parser takes time, and few domains need it

        model = loads(self.text, source=self.source)
        given = (self.training_discount, self.report_discount)
        training, report = (model.discount if discount is None else discount for discount in given)
        return Domain(
            id=self.id,
            title=self.title,
            family="classic",
            model=MOMDP(model),
            episode_limit=self.episode_limit,
            training_discount=training,
            report_discount=report,
            hidden_first_action=self.hidden_first_action,
        )


def declare(declared: FileDomain) -> None:
    """Make a domain known to :func:`bgn.domains.get`; declared anew with another text or rules, it is replaced.

    Raises
    ------
    InputError
        A module of this package builds a domain of that id.
    bgn.pomdp.PomdpFormatError
        The text is not a valid model.
    """
    name = declared.id
    if declaration(name) == declared:
        return
    if name in ids() and name not in _DECLARED:
        raise InputError(f"domain {name!r} is built by a module of bgn.domains; a file needs another id")
    built = declared.build()
    if name in _DECLARED:
        get.cache_clear()
    else:
        register(name)(partial(_built, name))
    _DECLARED[name] = declared, built


def declaration(domain_id: str) -> FileDomain | None:
    """Return how a domain was declared; None for one that a module builds."""
    return _DECLARED[domain_id][0] if domain_id in _DECLARED else None


def _built(domain_id: str) -> Domain:
    return _DECLARED[domain_id][1]
