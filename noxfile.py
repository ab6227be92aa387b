"""Everything one does with this project; ``nox -l`` lists the sessions.

All sessions but one share one virtual environment: torch is large, and is installed once. ``other_torch`` has its own.
"""

from __future__ import annotations

import hashlib
import os
import pathlib
import sys
import tomllib

import nox
from nox.command import CommandFailed

nox.options.sessions = ["lint", "tests"]

ROOT = pathlib.Path(__file__).parent
ENVIRONMENT = ROOT / ".nox" / "bgn"
PROGRAMS = ENVIRONMENT / "bin"
#: A version that GPU machines are known to have.
OTHER_TORCH = "2.11.0"
#: What an update is made of.
UPDATE_TESTS = (
    "tests/agents",
    "tests/training/learners",
    *(
        f"tests/training/test_{name}.py"
        for name in ("cuda", "devices", "graph_safety", "layouts", "update_runner")
    ),
)


@nox.session(venv_backend="none")
def reproduce(session: nox.Session) -> None:
    """Train what is missing and print the tables; arguments as `python -m benchmarks run`."""
    run(session, "python", "-m", "benchmarks", "run", *session.posargs)


@nox.session(venv_backend="none")
def tests(session: nox.Session) -> None:
    """Run the tests, one process per core; arguments as pytest's."""
    run(session, "pytest", "-n", "auto", "--dist", "worksteal", *session.posargs)


@nox.session(venv_backend="none")
def torture(session: nox.Session) -> None:
    """Kill and damage, then soak for an hour; ``-- --soak SECONDS`` (3600), ``--soak-seed``, or pytest's arguments."""
    crash = sorted(
        (ROOT / "tests" / "crash").glob("test_*.py"), key=lambda path: (path.stem == "test_soak", path)
    )
    run(session, "pytest", "--torture", "-s", "tests/hostile", *map(str, crash), *session.posargs)


@nox.session(venv_backend="none")
def lint(session: nox.Session) -> None:
    """Check style, types, and that no room imports from one above it."""
    run(session, "ruff", "check")
    run(session, "ruff", "format", "--check")
    run(session, "mypy")
    run(session, "lint-imports")


@nox.session(venv_backend="none")
def notebooks(session: nox.Session) -> None:
    """Execute the notebooks and write build/notebooks/index.html; ``-- --fixture``: on a small store, as a test."""
    if "--fixture" not in session.posargs:
        run(session, "python", "-m", "benchmarks.notebooks", *session.posargs)
        return
    store = {"BGN_RESULTS": str(ROOT / "tests" / "data" / "store"), "BGN_PRESET": "calibrated"}
    pages = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "notebooks").glob("*.ipynb"))
    run(session, "pytest", "--nbmake", "--nbmake-timeout=300", "--durations=0", *pages, **store)


@nox.session(venv_backend="none")
def regress(session: nox.Session) -> None:
    """Compare fresh runs with stored ones; 0 fine, 1 regressed, 2 could not tell. Arguments: docs/regression.md."""
    run(session, "python", "-m", "benchmarks.regression", *session.posargs)


@nox.session(venv_backend="none")
def slurm(session: nox.Session) -> None:
    """Run cells as Slurm jobs, on daemons of this machine alone; needs Debian's slurm-wlm and munge."""
    run(session, "pytest", "-rs", "tests/benchmarks/test_slurm.py", *session.posargs, BGN_TEST_SLURM="1")


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


@nox.session(venv_backend="none")
def gpu(session: nox.Session) -> None:
    """Check training on a GPU: equal to the CPU, graph equal to eager, cells at once; arguments such as --quick."""
    run(session, "python", "-m", "benchmarks.gpu_check", *session.posargs)


@nox.session(venv_backend="none")
def other_torch(session: nox.Session) -> None:
    """Run the tests of an update with another torch than the pinned one, as GPU machines may have it."""
    environment = ROOT / ".nox" / f"torch-{OTHER_TORCH}"
    python = str(environment / "bin" / "python")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    others = [name for name in project["project"]["dependencies"] if not name.startswith("torch")]
    try:
        session.run(sys.executable, "-m", "venv", str(environment), external=True)
        session.run(
            *(python, "-m", "pip", "install", "--quiet", f"torch=={OTHER_TORCH}"),
            *(*others, *project["dependency-groups"]["test"]),
            external=True,
        )
    except CommandFailed:
        session.skip(f"torch {OTHER_TORCH} cannot be installed here; it takes several gigabytes and internet")
    session.run(python, "-m", "pytest", *UPDATE_TESTS, *session.posargs, external=True)


@nox.session(venv_backend="none")
def twin(session: nox.Session) -> None:
    """Evaluate the published policies on a digital twin of the robot; arguments as `bgn robot rehearse`."""
    run(session, "python", "-m", "bgn", "robot", "rehearse", "--require-success", "1", *session.posargs)


@nox.session(venv_backend="none")
def faults(session: nox.Session) -> None:
    """Let everything go wrong at the twin, in real time: the tests that take minutes; arguments as pytest's."""
    run(session, "pytest", "-m", "twin", "tests/robot", *session.posargs)


@nox.session(venv_backend="none")
def hil(session: nox.Session) -> None:
    """Evaluate on a robot: ``-- --host ADDRESS --real``, a dry run; add ``--execute`` to move. See docs/robot.md."""
    if not any(argument.startswith("--host") for argument in session.posargs):
        session.log("No robot was named, so nothing is run. In the laboratory, after reading docs/robot.md:")
        session.log(
            "  nox -s hil -- --host 192.168.1.10 --gripper-host 192.168.1.11 --real             a dry run"
        )
        session.log(
            "  nox -s hil -- --host 192.168.1.10 --gripper-host 192.168.1.11 --real --execute   moves the arm"
        )
        session.log("Without a robot, `nox -s twin` runs the same evaluation on a digital twin.")
        return
    run(session, "python", "-m", "bgn", "robot", "evaluate", *session.posargs)


def run(session: nox.Session, program: str, *arguments: str, **variables: str) -> None:
    """Run a program of the shared environment, which is brought up to date first."""
    install(session)
    path = os.pathsep.join([str(PROGRAMS), os.environ["PATH"]])
    environment = {"PATH": path, "VIRTUAL_ENV": str(ENVIRONMENT), **variables}
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
