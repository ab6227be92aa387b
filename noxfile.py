"""Everything one does with this project: ``nox -s reproduce``, ``tests``, ``lint``, ``speed``.

All sessions share one virtual environment: torch is large, and is installed once.
"""

from __future__ import annotations

import hashlib
import os
import pathlib
import sys

import nox

nox.options.sessions = ["lint", "tests"]

ROOT = pathlib.Path(__file__).parent
ENVIRONMENT = ROOT / ".nox" / "bgn"
PROGRAMS = ENVIRONMENT / "bin"


@nox.session(venv_backend="none")
def reproduce(session: nox.Session) -> None:
    """Train what is missing and print the tables; arguments as `python -m benchmarks run`."""
    run(session, "python", "-m", "benchmarks", "run", *session.posargs)


@nox.session(venv_backend="none")
def tests(session: nox.Session) -> None:
    """Run the tests; arguments as pytest's."""
    run(session, "pytest", *session.posargs)


@nox.session(venv_backend="none")
def lint(session: nox.Session) -> None:
    """Check style, types, and that no room imports from one above it."""
    run(session, "ruff", "check")
    run(session, "ruff", "format", "--check")
    run(session, "mypy")
    run(session, "lint-imports")


@nox.session(venv_backend="none")
def speed(session: nox.Session) -> None:
    """Measure speeds into .benchmarks/speed.json; ``-- --compare [REV]``: against a git revision."""
    if "--compare" in session.posargs:
        arguments = [argument for argument in session.posargs if argument != "--compare"]
        run(session, "python", "-m", "benchmarks.speed", "compare", *arguments)
        return
    (ROOT / ".benchmarks").mkdir(exist_ok=True)
    suite = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "benchmarks").glob("test_speed_*.py"))
    report = "--benchmark-json=.benchmarks/speed.json"
    # The project's own pytest options skip benchmarks, which is what the test session wants.
    options = ("-q", "-o", "addopts=", "--benchmark-only", "--benchmark-columns=min,median,iqr,rounds")
    run(session, "pytest", *options, report, *suite, *session.posargs)
    run(session, "python", "-m", "benchmarks.speed", "table")


def run(session: nox.Session, program: str, *arguments: str) -> None:
    """Run a program of the shared environment, which is brought up to date first."""
    install(session)
    path = os.pathsep.join([str(PROGRAMS), os.environ["PATH"]])
    environment = {"PATH": path, "VIRTUAL_ENV": str(ENVIRONMENT)}
    session.run(str(PROGRAMS / program), *arguments, env=environment, external=True)


def install(session: nox.Session) -> None:
    """Make the shared environment, unless it was made for the same pyproject.toml and Python before."""
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest() + f" Python {sys.version}"
    stamp = ENVIRONMENT / "installed-for"
    if stamp.exists() and stamp.read_text(encoding="utf-8") == wanted:
        return
    python = str(PROGRAMS / "python")
    session.run(sys.executable, "-m", "venv", "--clear", str(ENVIRONMENT), external=True)
    session.run(python, "-m", "pip", "install", "--upgrade", "pip>=25.1", external=True)  # dependency groups
    groups = ("--group", "test", "--group", "lint")
    session.run(python, "-m", "pip", "install", "--editable", ".", *groups, external=True)
    stamp.write_text(wanted, encoding="utf-8")
