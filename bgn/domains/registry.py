"""Finds the domains: every module of this package registers what it builds."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from functools import cache, lru_cache

from bgn.domains.domain import Domain
from bgn.errors import BgnError, InputError

_BUILDERS: dict[str, Callable[..., Domain]] = {}


class UnknownDomainError(BgnError, KeyError):
    """No module registers a domain of that id."""


def register(domain_id: str) -> Callable[[Callable[..., Domain]], Callable[..., Domain]]:
    """Register the decorated function as the builder of ``domain_id``; its keywords are the variants."""

    def decorate(builder: Callable[..., Domain]) -> Callable[..., Domain]:
        if domain_id in _BUILDERS:
            raise InputError(f"domain {domain_id!r} is registered twice")
        _BUILDERS[domain_id] = builder
        return builder

    return decorate


def ids() -> tuple[str, ...]:
    """Return the ids of all registered domains, sorted."""
    _discover()
    return tuple(sorted(_BUILDERS))


@lru_cache(maxsize=32)
def get(domain_id: str, **variant: str | int | float | bool) -> Domain:
    """Build a domain (once per variant).

    Raises
    ------
    UnknownDomainError
        No such domain; the message lists the known ones.
    ValueError
        The domain has no such variant, or the variant's value makes no sense.
    """
    if domain_id not in ids():
        raise UnknownDomainError(f"unknown domain {domain_id!r}; known: {', '.join(ids())}")
    builder = _BUILDERS[domain_id]
    known = inspect.signature(builder).parameters
    for name in variant:
        if name not in known:
            raise InputError(f"{domain_id} has no variant {name!r}; known: {', '.join(known) or 'none'}")
    return builder(**variant)


@cache
def _discover() -> None:
    package = importlib.import_module("bgn.domains")
    for module in pkgutil.iter_modules(package.__path__):
        if not (module.ispkg or module.name.startswith("_")):
            importlib.import_module(f"bgn.domains.{module.name}")
