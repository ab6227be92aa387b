"""What the sub-commands share of argument parsing."""

from __future__ import annotations

import argparse
from typing import TypeAlias

from bgn import domains
from bgn.errors import InputError

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""Where a command adds its parser."""

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells report it."""


def robot_domains() -> tuple[str, ...]:
    """Return the ids of the domains that are stepped in physics."""
    return tuple(name for name in domains.ids() if domains.get(name).family == "robot")


def check_robot_domain(name: str) -> None:
    """Raise :class:`~bgn.errors.InputError` unless ``name`` is a domain with physics."""
    if name not in robot_domains():
        raise InputError(f"{name!r} is not a robot domain; those are {', '.join(robot_domains())}")
