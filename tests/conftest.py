"""Settings of all tests."""

import os

import pytest
from hypothesis import settings

# Numerical libraries keep to one thread: test processes run side by side, and small products gain nothing.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A busy machine is slow, not wrong.
settings.register_profile("bgn", deadline=None)
settings.register_profile("torture", deadline=None)
settings.load_profile("bgn")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of ``nox -s torture``."""
    parser.addoption(
        "--torture", action="store_true", help="many more damaged files and kills (see tests/effort.py)"
    )
    parser.addoption(
        "--soak", type=float, default=3600.0, metavar="SECONDS", help="how long the soak of torture goes on"
    )
    parser.addoption(
        "--soak-seed", type=int, metavar="SEED", help="draw what the soak does as it was drawn before"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Choose the effort before any test module asks for it."""
    if config.getoption("--torture"):
        settings.load_profile("torture")
