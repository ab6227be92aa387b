"""Command line of the domains: ``python -m bgn.domains list|write|compile|render``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from bgn.domains import _files, _overview, _robot_commands

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

POMDP_FILES = Path("data/pomdp_files")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bgn.domains", description="The domains of the benchmark."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in COMMANDS:
        add(commands)
    options = parser.parse_args(arguments)
    try:
        options.run(options)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _add_list(commands: Commands) -> None:
    command = commands.add_parser("list", help="print all domains and their sizes, beside the paper's")
    command.set_defaults(run=lambda _: Console().print(_overview.overview()))


def _add_write(commands: Commands) -> None:
    command = commands.add_parser("write", help="write the classic domains as .pomdp files with checksums")
    command.add_argument("--out", type=Path, default=POMDP_FILES, help="folder (default: %(default)s)")
    command.set_defaults(run=_write)


def _write(options: argparse.Namespace) -> None:
    for path in _files.write(options.out):
        print(path)


#: A command is a function that adds its parser, with ``run`` set to what it does.
COMMANDS: tuple[Callable[[Commands], None], ...] = (
    _add_list,
    _add_write,
    _robot_commands.add_compile,
    _robot_commands.add_render,
)

if __name__ == "__main__":
    sys.exit(main())
