"""``python -m benchmarks.speed table | compare [REV] | report``; ``nox -s speed`` calls the first two."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from benchmarks.speed import compare, suite
from benchmarks.speed.workloads import COMPARED
from bgn.errors import BgnError

SPEED_JSON = Path(".benchmarks") / "speed.json"
_SLOWER, _USAGE = 1, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status: 1 for a slowdown, 2 for what cannot be done."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    table = commands.add_parser("table", help="print the training speeds that `nox -s speed` stored")
    table.add_argument("file", type=Path, nargs="?", default=SPEED_JSON)
    table.set_defaults(run=_table)
    against = commands.add_parser("compare", help="measure the working tree against a git revision")
    against.add_argument("revision", nargs="?", help="default: where this branch left main, or HEAD~1")
    against.add_argument("--rounds", type=int, default=compare.ROUNDS, help="default: %(default)s")
    against.set_defaults(run=_compare)
    report = commands.add_parser("report", help="measure anew what docs/performance.md states")
    report.add_argument("--suite", type=Path, default=SPEED_JSON, help="default: %(default)s")
    report.set_defaults(run=_report)
    options = parser.parse_args(arguments)
    try:
        status: int = options.run(options)
    except BgnError as error:
        print(f"error: {error}", file=sys.stderr)
        return _USAGE
    return status


def _console() -> Console:
    return Console() if sys.stdout.isatty() else Console(width=130)


def _table(options: argparse.Namespace) -> int:
    _console().print(suite.training_table(suite.load(options.file)))
    return 0


def _compare(options: argparse.Namespace) -> int:
    if options.rounds < 1:
        raise compare.CompareError(f"--rounds must be at least 1, not {options.rounds}")
    revision = options.revision or compare.default_revision()
    console, done = _console(), []
    for comparison in compare.compare(revision, list(COMPARED), options.rounds):
        console.print(comparison.summary(), highlight=False)
        done.append(comparison)
    console.print(compare.table(revision, done))
    return _SLOWER if any(comparison.slower for comparison in done) else 0


def _report(options: argparse.Namespace) -> int:
    from benchmarks.speed import report  # draws figures, which the other commands need not wait for

    for path in report.write(suite.load(options.suite)):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
