"""Saved policies of every kind, told apart by what their files hold."""

from __future__ import annotations

import os
from pathlib import Path

from bgn import domains
from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.policies import alpha_file
from bgn.policies.alpha_vectors import AlphaVectorPolicy
from bgn.policies.saved import NetworkPolicy, PolicyFileError

SavedPolicy = NetworkPolicy | AlphaVectorPolicy


def load(
    path: str | os.PathLike[str], domain: Domain | str | None = None, *, greedy: bool = True
) -> SavedPolicy:
    """Read a saved policy; see :func:`bgn.policies.load`."""
    file = Path(path)
    if not file.is_file():
        raise PolicyFileError(f"{file}: no such policy file")
    wanted = domains.get(domain) if isinstance(domain, str) else domain
    with file.open("rb") as opened:
        is_xml = opened.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")
    if is_xml:
        made_for, alpha = alpha_file.model_name(file), alpha_file.load(file)
        if wanted is None and made_for not in domains.ids():
            raise InputError(f"{file} is for the model {made_for!r}, not for a known domain: name the domain")
        return AlphaVectorPolicy(alpha, domains.get(made_for) if wanted is None else wanted)
    policy = NetworkPolicy.load(file, greedy=greedy)
    if wanted is not None and policy.domain.id != wanted.id:
        raise InputError(f"{file} is a policy of {policy.domain.id}, not of {wanted.id}")
    return policy
