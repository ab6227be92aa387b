"""The command that runs a twin."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from bgn.robot import lab as laboratory
from bgn.robot.errors import RobotError
from bgn.robot.network import TWIN_HOST, check_twin_host
from bgn.robot.twin import faults


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command line."""
    parser.add_argument("--task", default="two-bumps-1d", help="the bench the arm stands at first")
    parser.add_argument("--host", default=TWIN_HOST, help="a loopback address (default: %(default)s)")
    parser.add_argument("--lab", type=Path, help="a laboratory file instead of the package's own")
    parser.add_argument("--scale", type=float, default=1.0, help="simulated seconds per second")
    parser.add_argument("--seed", type=int, default=0, help="of noise and placement errors")
    parser.add_argument("--polyscope", help="another version than the laboratory file's")
    parser.add_argument(
        "--fault", action="append", default=[], metavar="NAME[=VALUE][@MOTION[+SECONDS]]",
        help="; ".join(f"{name}: {text}" for name, (text, _) in faults.FAULTS.items()),
    )  # fmt: skip
    parser.add_argument("--window", action="store_true", help="show the arm (needs a screen)")


def run(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C, SIGTERM or the control socket says stop."""
    check_twin_host(arguments.host)
    from bgn.robot.twin.server import Twin  # loads MuJoCo

    lab = laboratory.load(arguments.lab)
    if arguments.polyscope:
        lab = lab.model_copy(update={"twin": lab.twin.model_copy(update={"polyscope": arguments.polyscope})})
    injected = [faults.parse(fault) for fault in arguments.fault]

    async def serve() -> None:
        twin = Twin(lab, arguments.task, arguments.host, scale=arguments.scale, seed=arguments.seed)
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, twin.stop)
        for fault in injected:
            twin.arm(fault)
        if arguments.window:
            twin.show()
        await twin.run(
            lambda: print(f"twin of a UR5e at {arguments.host}, task {arguments.task}", flush=True)
        )

    asyncio.run(serve())
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line and run a twin; return its exit code."""
    parser = argparse.ArgumentParser(prog="bgn robot twin", description=__doc__)
    add_arguments(parser)
    parsed = parser.parse_args(arguments)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            return run(parsed)
    except RobotError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0
