"""``bgn compile``: the physics of the robot domains into their exact tables."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import track

from bgn.commands.parsing import Commands, check_robot_domain, robot_domains
from bgn.domains import outcome_table
from bgn.errors import InputError

if TYPE_CHECKING:
    from bgn.physics.compile import Column


def add_compile(commands: Commands) -> None:
    """Add the command that compiles physics into the tables."""
    command = commands.add_parser(
        "compile", help="compile the physics of the robot domains into their exact tables, where it changed"
    )
    command.add_argument("domains", nargs="*", metavar="DOMAIN", help=f"of {', '.join(robot_domains())}")
    command.add_argument("--histories", type=int, default=4, help="histories a pair (default: %(default)s)")
    command.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes to compile in")
    command.add_argument("--force", action="store_true", help="compile even what is up to date")
    command.add_argument(
        "--tables",
        type=Path,
        default=outcome_table.SHIPPED,
        help="folder of the tables (default: the package's)",
    )
    command.set_defaults(run=_compile)


def _compile(options: argparse.Namespace) -> int:
    from bgn.physics import compile as compiler
    from bgn.physics.tasks import task_of

    if options.jobs < 1:
        raise InputError(f"--jobs {options.jobs}: expected at least 1 process")
    chosen = options.domains or robot_domains()
    for name in chosen:
        check_robot_domain(name)
    console = Console()
    for name in chosen:
        stem = options.tables / name
        key = compiler.key(task_of(name).scene())
        if not options.force and _up_to_date(stem, key, options.histories):
            console.print(f"{name}: up to date")
            continue

        def progress(columns: Iterable[Column], total: int, name: str = name) -> Iterable[Column]:
            return track(columns, f"{name}: compiling", total, console=console)

        table = compiler.compile_scene(
            name, histories=options.histories, jobs=options.jobs, progress=progress
        )
        outcome_table.save(table, stem)
        header = table.header
        console.print(
            f"{name}: {header.pairs} pairs, one outcome each from {header.histories} histories, "
            f"margin {header.margin:.0%} -> {stem}.npz"
        )
    return 0


def _up_to_date(stem: Path, key: str, histories: int) -> bool:
    if not stem.with_suffix(".json").exists():
        return False
    header = outcome_table.load(stem).header
    return header.key == key and header.histories >= histories
