"""A hash of what a run sees of its domain: tables, features and episode rules.

This module imports nothing of the package, so that it can hash the domains of another version of it.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

if TYPE_CHECKING:
    from bgn.domains.domain import Domain

#: What :data:`bgn.domains.domain.FOR_PEOPLE` puts into the metadata of a field that no computation depends on.
_MARK = "for people"


def data_hash(domain: Domain, *, unseen: Collection[str] = ()) -> str:
    """Hash a domain's tables and episode rules.

    Fields for people do not count (``unseen`` names those that a former version did not mark so), nor do
    optional ones that are None.
    """
    digest = hashlib.sha256()
    for piece in _pieces(domain, frozenset(unseen)):
        digest.update(piece)
    return digest.hexdigest()[:16]


def unseen_fields(domain_class: type[Domain]) -> list[str]:
    """Return the names of the fields that do not count."""
    return [field.name for field in dataclasses.fields(domain_class) if _MARK in field.metadata]


def _pieces(value: Any, unseen: frozenset[str] = frozenset()) -> Iterator[bytes]:
    """Yield the bytes that determine a domain, whatever its fields hold."""
    if isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, sparse.csr_array):
        rows = value.copy()
        rows.sum_duplicates()
        for part in (np.asarray(rows.shape), rows.indptr, rows.indices):
            yield from _pieces(np.asarray(part, dtype=np.int64))
        yield from _pieces(rows.data)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            content = getattr(value, field.name)
            if content is not None and _MARK not in field.metadata and field.name not in unseen:
                yield field.name.encode()
                yield from _pieces(content)
    elif isinstance(value, tuple):
        yield f"tuple {len(value)}".encode()
        for item in value:
            yield from _pieces(item)
    elif value is None or isinstance(value, str | bool | int | float):
        yield f"{type(value).__name__} {value!r}".encode()
    else:
        raise TypeError(f"a domain holds a {type(value).__name__}, which has no defined hash")
