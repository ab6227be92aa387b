"""``bgn robot``: evaluate policies on a UR5e or on its digital twin, run the twin, film and sweep."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from bgn.commands.parsing import Commands, robot_domains
from bgn.robot.errors import RobotError
from bgn.robot.network import TWIN_HOST
from bgn.robot.twin import command as twin_command

#: Exit status of an evaluation that ended but with fewer successes than were asked for.
TOO_FEW = 1
#: Seconds without fresh data that a rehearsal bears: twin and evaluation share one machine, which may be busy.
LOADED = 0.4


def add_robot(commands: Commands) -> None:
    """Add the robot's commands."""
    robot = commands.add_parser(
        "robot", help="hardware in the loop: a UR5e with its gripper, or their digital twin"
    )
    inner = robot.add_subparsers(required=True, metavar="COMMAND")
    _add_evaluate(inner)
    _add_rehearse(inner)
    _add_twin(inner)
    _add_film(inner)
    _add_sweep(inner)


def _add_evaluate(commands: Commands) -> None:
    command = commands.add_parser(
        "evaluate",
        help="evaluate saved policies on an arm; without --execute nothing moves",
        description="Checks everything and prints the plan. Only with --execute does the arm move, after the robot's "
        "serial number, the policies and the speed have been typed in.",
    )
    command.add_argument("--host", help="numeric address of the controller; there is no default")
    command.add_argument("--gripper-host", help="of the gripper, if another one")
    command.add_argument(
        "--real", action="store_true", help="the address is a real robot's, not a twin's on this machine"
    )
    command.add_argument("--execute", action="store_true", help="move, instead of a dry run")
    command.add_argument(
        "--task", action="append", choices=robot_domains(), help="may be repeated (default: all three)"
    )
    command.add_argument("--episodes", type=int, default=10, help="of each task (default: %(default)s)")
    command.add_argument(
        "--policy",
        action="append",
        default=[],
        metavar="TASK=FILE",
        help="default: the published Ah-Ch+BGN policies",
    )
    command.add_argument(
        "--speed", type=float, help="m/s of the episodes' moves (default: the laboratory file's)"
    )
    command.add_argument("--seed", type=int, default=0, help="of the episodes' starts (default: %(default)s)")
    command.add_argument("--lab", type=Path, help="a laboratory file instead of the package's own")
    command.add_argument("--out", type=Path, help="folder of the recordings (default: results/robot/TIME)")
    command.add_argument("--resume", type=Path, metavar="FOLDER", help="go on with an interrupted session")
    command.add_argument("--answers", type=Path, help="a file of the operator's answers, one a line")
    command.add_argument(
        "--twin-operator",
        action="store_true",
        help="let the twin place its objects and see its pushes itself",
    )
    command.add_argument("--no-lap", action="store_true", help="leave the slow first lap out (twin only)")
    command.add_argument(
        "--stale-after", type=float, help="s without fresh data (default: the laboratory file's)"
    )
    command.add_argument(
        "--require-success",
        type=float,
        default=0.0,
        metavar="RATE",
        help="exit with 1 if a task succeeds less often",
    )
    command.set_defaults(run=_guarded(_evaluate))


def _add_rehearse(commands: Commands) -> None:
    command = commands.add_parser(
        "rehearse",
        help="start a twin and run the whole evaluation on it, faster than real time",
        description="The same evaluation, by the same client library and protocols, on a twin of its own. The twin "
        "places its objects itself; everything else is as at a robot.",
    )
    command.add_argument(
        "--host", default=TWIN_HOST, help="loopback address of the twin (default: %(default)s)"
    )
    command.add_argument(
        "--scale", type=float, default=8.0, help="simulated seconds per second (default: %(default)s)"
    )
    command.add_argument("--task", action="append", choices=robot_domains(), help="(default: all three)")
    command.add_argument("--episodes", type=int, default=10, help="of each task (default: %(default)s)")
    command.add_argument("--seed", type=int, default=0, help="of starts and noise (default: %(default)s)")
    command.add_argument("--lab", type=Path, help="a laboratory file instead of the package's own")
    command.add_argument("--out", type=Path, help="folder of the recordings (default: results/robot/TIME)")
    command.add_argument(
        "--require-success",
        type=float,
        default=0.0,
        metavar="RATE",
        help="exit with 1 if a task succeeds less often",
    )
    command.set_defaults(run=_guarded(_rehearse))


def _add_twin(commands: Commands) -> None:
    command = commands.add_parser(
        "twin", help="run a simulated UR5e and gripper that speak the real ones' protocols"
    )
    twin_command.add_arguments(command)
    command.set_defaults(run=_guarded(twin_command.run))


def _add_film(commands: Commands) -> None:
    command = commands.add_parser(
        "film", help="film a recorded episode, with belief panels computed afterwards"
    )
    command.add_argument("episode", type=Path, help="the episode's folder, SESSION/episodes/NAME")
    command.add_argument("--out", type=Path, help="the GIF (default: NAME.gif); a film strip lies beside it")
    command.add_argument("--lab", type=Path, help="a laboratory file instead of the package's own")
    command.set_defaults(run=_guarded(_film))


def _add_sweep(commands: Commands) -> None:
    command = commands.add_parser(
        "sweep", help="how much finger noise, drift, lag and misplacement the policies bear"
    )
    command.add_argument("--task", action="append", choices=robot_domains(), help="(default: all three)")
    command.add_argument(
        "--gap", action="append", help="angle_noise, angle_drift, servo_lag or placement_error"
    )
    command.add_argument("--episodes", type=int, default=20, help="of each point (default: %(default)s)")
    command.add_argument("--lab", type=Path, help="a laboratory file instead of the package's own")
    command.add_argument(
        "--out", type=Path, default=Path("results/robot/sweep.parquet"), help="(default: %(default)s)"
    )
    command.set_defaults(run=_guarded(_sweep))


def _guarded(run: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    """Let each kind of trouble end with its own exit status."""

    def guarded(options: argparse.Namespace) -> int:
        try:
            return run(options)
        except RobotError as error:
            print(f"error: {error}", file=sys.stderr)
            return error.exit_code

    return guarded


def _evaluate(options: argparse.Namespace) -> int:
    from bgn.robot.network import check_host

    host = check_host(options.host, real=options.real)
    gripper_host = check_host(options.gripper_host or host, real=options.real)
    from bgn.robot.evaluation import Request, evaluate  # loads MuJoCo and torch

    request = Request(
        host=host,
        gripper_host=gripper_host,
        tasks=tuple(options.task or robot_domains()),
        episodes=options.episodes,
        policies=tuple(options.policy),
        speed=options.speed,
        seed=options.seed,
        lab=options.lab,
        out=options.out,
        resume=options.resume,
        answers=options.answers,
        twin_operator=options.twin_operator,
        lap=not options.no_lap,
        stale_after=options.stale_after,
    )
    lowest = evaluate(request, execute=options.execute)
    return TOO_FEW if options.execute and lowest < options.require_success else 0


def _rehearse(options: argparse.Namespace) -> int:
    from bgn.robot.evaluation import Request, rehearse  # loads MuJoCo and torch

    request = Request(
        host=options.host,
        gripper_host=options.host,
        tasks=tuple(options.task or robot_domains()),
        episodes=options.episodes,
        seed=options.seed,
        lab=options.lab,
        out=options.out,
        twin_operator=True,
        stale_after=LOADED,
        scale=options.scale,
    )
    return TOO_FEW if rehearse(request) < options.require_success else 0


def _film(options: argparse.Namespace) -> int:
    from bgn.robot.film import film_episode

    for path in film_episode(options.episode, options.out, options.lab):
        print(path)
    return 0


def _sweep(options: argparse.Namespace) -> int:
    from bgn.robot.sweep import sweep

    return sweep(options.task or robot_domains(), options.gap, options.episodes, options.lab, options.out)
