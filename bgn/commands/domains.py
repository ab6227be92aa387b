"""``bgn domains`` and ``bgn write``: the table of all domains, and the classic ones as .pomdp files."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from bgn.commands.parsing import Commands
from bgn.domains import pomdp_files

POMDP_FILES = Path("data/pomdp_files")


def add_domains(commands: Commands) -> None:
    """Add the command that lists all domains."""
    command = commands.add_parser("domains", help="print all domains and their sizes, beside the paper's")
    command.set_defaults(run=_print_overview)


def add_write(commands: Commands) -> None:
    """Add the command that writes the classic domains as files."""
    command = commands.add_parser("write", help="write the classic domains as .pomdp files with checksums")
    command.add_argument("--out", type=Path, default=POMDP_FILES, help="folder (default: %(default)s)")
    command.set_defaults(run=_write)


def _print_overview(_: argparse.Namespace) -> int:
    from bgn.commands.overview import overview

    Console().print(overview())
    return 0


def _write(options: argparse.Namespace) -> int:
    for path in pomdp_files.write(options.out):
        print(path)
    return 0
