"""``bgn``: every command that is not the benchmark itself (that is ``python -m benchmarks``)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from bgn.commands.compile import add_compile
from bgn.commands.domains import add_domains, add_write
from bgn.commands.evaluate import add_evaluate
from bgn.commands.parsing import INTERRUPTED, Commands
from bgn.commands.render import add_render
from bgn.commands.robot import add_robot
from bgn.commands.solve import add_solve
from bgn.errors import BgnError

FAILED = 2

#: A command is a function that adds its parser, with ``run`` set to what it does; it returns the exit status.
COMMANDS: tuple[Callable[[Commands], None], ...] = (
    add_domains,
    add_write,
    add_compile,
    add_render,
    add_solve,
    add_evaluate,
    add_robot,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="bgn", description="Belief-Grounded Networks: domains and planning."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in COMMANDS:
        add(commands)
    options = parser.parse_args(arguments)
    try:
        return int(options.run(options))
    except (BgnError, OSError) as error:  # OSError: a file or folder the user named cannot be read or written
        print(f"error: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
