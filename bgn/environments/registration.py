"""Makes every domain known to Gymnasium, as ``bgn/`` and its title: ``bgn/RockSample44-v0``."""

from __future__ import annotations

import re
from typing import Any

import gymnasium

from bgn import domains
from bgn.domains.domain import Domain


def environment_id(domain: Domain) -> str:
    """Return Gymnasium's name of a domain: its title without what such a name may not hold."""
    return f"bgn/{re.sub(r'[^0-9A-Za-z]', '', domain.title)}-v0"


def register() -> None:
    """Register every domain: on its tables, or in MuJoCo where it has physics."""
    for domain in map(domains.get, domains.ids()):
        gymnasium.register(environment_id(domain), kwargs={"domain_id": domain.id}, **_played_by(domain))


def _played_by(domain: Domain) -> dict[str, Any]:
    if domain.family == "robot":  # cuts episodes itself, at the limit of its variant
        return {"entry_point": "bgn.environments.physics:PhysicsEnvironment"}
    entry_point = "bgn.environments.tabular:TableEnvironment"
    return {"entry_point": entry_point, "max_episode_steps": domain.episode_limit}
