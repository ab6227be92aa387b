"""``bgn robot evaluate``: from the command line's wishes to a session, a dry run, and the table that comes out."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bgn.results.provenance import environment
from bgn.robot import lab as laboratory
from bgn.robot import preflight
from bgn.robot.dashboard import Dashboard
from bgn.robot.entrant import PUBLISHED, ROOT, Entrant, enter
from bgn.robot.errors import UsageError
from bgn.robot.lab import Lab
from bgn.robot.network import is_loopback
from bgn.robot.operators import Automaton, Operator, console, scripted
from bgn.robot.recording import SessionFolder, Start
from bgn.robot.session import Session, plan
from bgn.robot.summary import render
from bgn.robot.twin.client import TwinClient, TwinProcess
from bgn.robot.ur5e import Abort, check_extra


@dataclass(frozen=True)
class Request:
    """What was asked for on the command line; ``bgn robot evaluate --help`` explains each."""

    host: str
    gripper_host: str
    tasks: tuple[str, ...]
    episodes: int
    policies: tuple[str, ...] = ()
    speed: float | None = None
    seed: int = 0
    lab: Path | None = None
    out: Path | None = None
    resume: Path | None = None
    answers: Path | None = None
    twin_operator: bool = False
    lap: bool = True
    stale_after: float | None = None
    scale: float | None = None
    """Simulated seconds a second of the twin, if it was started for this session."""


def evaluate(request: Request, *, execute: bool) -> float:
    """Run a session, or say what it would do; return the lowest success rate of a task, 0 of a dry run.

    Raises
    ------
    RobotError
        Whatever ended it; its exit code says what.
    """
    about = {} if request.resume is None else SessionFolder(request.resume).about()
    lab = _laboratory(request, about)
    if request.episodes < 1:
        raise UsageError(f"--episodes {request.episodes}: at least 1 is needed")
    if not is_loopback(request.host) and (request.twin_operator or not request.lap):
        raise UsageError(
            "--twin-operator and --no-lap are for the twin; a real robot has a person and a first lap"
        )
    speed = request.speed or about.get("speed") or lab.arm.speed
    if not 0 < speed <= lab.arm.speed_cap:
        raise UsageError(f"--speed {speed}: not in 0..{lab.arm.speed_cap} m/s")
    folder, starts, policies = _session(request, about)
    entrants = {task: enter(task, policies[task]) for task in dict.fromkeys(start.task for start in starts)}
    print(preflight.describe_plan(lab, starts, speed))
    if not execute:
        _look_at(lab, request.host)
        print("dry run: nothing was moved; add --execute to move the arm")
        return 0.0
    check_extra()
    if request.resume is None:
        folder.create(_about(request, lab, entrants, starts, speed))
    return _run(request, lab, entrants, starts, folder, speed)


def rehearse(request: Request) -> float:
    """Start a twin, run a session on it and stop it; return the lowest success rate of a task.

    Raises
    ------
    RobotError
        Whatever ended it.
    """
    check_extra()
    options = ["--scale", str(request.scale or 1.0), "--seed", str(request.seed)]
    if request.lab is not None:
        options += ["--lab", str(request.lab)]
    with TwinProcess(request.tasks[0], request.host, *options):
        return evaluate(request, execute=True)


def _run(
    request: Request,
    lab: Lab,
    entrants: dict[str, Entrant],
    starts: list[Start],
    folder: SessionFolder,
    speed: float,
) -> float:
    abort = Abort()
    operator = _operator(request, abort)
    session = Session(
        lab, request.host, request.gripper_host, entrants, starts, folder, operator, abort, speed
    )
    try:
        table = session.run(lap=request.lap)
    finally:
        session.close()
        operator.close()
        summary = session.summary()
        print(render(summary))
        print(f"recordings: {folder.path}")
    return float(table.success.min())


def _laboratory(request: Request, about: dict[str, Any]) -> Lab:
    """Return the laboratory: that of the session to go on with, unless another one was asked for."""
    resumed = about and request.lab is None
    lab = Lab.model_validate(about["lab"]) if resumed else laboratory.load(request.lab)
    if request.stale_after is not None:
        if not 0.05 <= request.stale_after <= 1.0:
            raise UsageError(f"--stale-after {request.stale_after}: not in 0.05..1 s")
        lab = lab.model_copy(update={"arm": lab.arm.model_copy(update={"stale_after": request.stale_after})})
    return lab


def _session(request: Request, about: dict[str, Any]) -> tuple[SessionFolder, list[Start], dict[str, Path]]:
    """Return folder, episodes and policies: of a new session, or of one to go on with."""
    if request.resume is not None:
        folder = SessionFolder(request.resume)
        starts = [Start(**start) for start in about["plan"]]
        return folder, starts, {task: ROOT / entry["path"] for task, entry in about["policies"].items()}
    folder = SessionFolder(request.out or ROOT / "results" / "robot" / time.strftime("%Y-%m-%dT%H-%M-%S"))
    policies = {task: ROOT / PUBLISHED.format(task=task) for task in request.tasks}
    for given in request.policies:
        task, found, path = given.partition("=")
        if not found or task not in policies:
            raise UsageError(f"--policy {given}: expected TASK=FILE with TASK of {', '.join(request.tasks)}")
        policies[task] = Path(path)
    return folder, plan(request.tasks, request.episodes, request.seed), policies


def _about(
    request: Request, lab: Lab, entrants: dict[str, Entrant], starts: list[Start], speed: float
) -> dict[str, Any]:
    return {
        "host": request.host,
        "evidence": "twin" if is_loopback(request.host) else "robot",
        "speed": speed,
        "twin_scale": request.scale,
        "seed": request.seed,
        "policies": {
            task: {"path": entrant.place, "sha256": entrant.digest} for task, entrant in entrants.items()
        },
        "plan": [vars(start) for start in starts],
        "lab": lab.model_dump(),
        "computed_with": dict(environment()),
    }


def _operator(request: Request, abort: Abort) -> Operator:
    if request.twin_operator:
        return Automaton(TwinClient(request.host))
    if request.answers is not None:
        try:
            answers = request.answers.read_text(encoding="utf-8").splitlines()
        except OSError as error:
            raise UsageError(f"--answers {request.answers}: {error.strerror}") from error
        return scripted(answers, abort)
    return console(abort)


def _look_at(lab: Lab, host: str) -> None:
    """Ask the robot's dashboard whether it would be ready; changes nothing."""
    dashboard = Dashboard(host)
    try:
        _, checks = preflight.check_dashboard(lab, dashboard)
    finally:
        dashboard.close()
    print(preflight.insist(checks))
