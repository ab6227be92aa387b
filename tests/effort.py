"""How hard to try: a little in every test run, a lot in ``nox -s torture``."""

from __future__ import annotations

from typing import TypeVar

from hypothesis import settings

T = TypeVar("T")


def effort(tests: T, torture: T) -> T:
    """Return the first in the tests, the second in torture."""
    return torture if settings.get_current_profile_name() == "torture" else tests
