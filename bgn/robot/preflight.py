"""What is checked before anything moves: the plan on paper, then the robot itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from bgn.robot import kinematics
from bgn.robot.dashboard import Dashboard
from bgn.robot.errors import PreflightError
from bgn.robot.gripper import RddaGripper
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab, Station
from bgn.robot.recording import Start

SLOWEST_SLIDER: Final = 0.05
LINE_POINTS: Final = 9  # between two neighbouring cells


@dataclass(frozen=True)
class Check:
    """One thing that was looked at."""

    name: str
    found: str
    passed: bool
    wanted: str = ""


@dataclass(frozen=True)
class Reach:
    """What the arm has to do for one task, from kinematics alone."""

    cells: int
    low: Floats
    """(6,) smallest joint angles."""
    high: Floats
    condition: float
    """Worst condition number of the scaled Jacobian."""


def check_station(lab: Lab, task: str) -> Reach:
    """Follow the finger through all cells of a task, at the cells and withdrawn from them.

    Raises
    ------
    PreflightError
        A cell is out of reach, on another branch, outside the workspace or the joint windows, or near a singularity.
    """
    station = lab.station(task)
    tour = lap(station)
    joints: list[Floats] = []
    for cell in tour:
        for pose in (station.pose(cell), station.pose(cell, retreat=True)):
            if not station.contains(pose[:3]):
                raise PreflightError(
                    f"{task}: cell {cell} at {np.round(pose[:3], 3)} is outside the workspace"
                )
            near = joints[-1] if joints else np.array(station.near)
            solution = kinematics.nearest(lab.flange(pose), near)
            if solution is None:
                raise PreflightError(f"{task}: cell {cell} at {np.round(pose[:3], 3)} is out of reach")
            joints.append(solution)
    for a, b in pairwise(tour):
        _check_line(lab, task, station, a, b)
    table = np.array(joints)
    away = np.abs(table - np.array(station.near)).max()
    if away > station.window:
        raise PreflightError(
            f"{task}: a joint turns {away:.2f} rad from its middle, the window is {station.window} rad"
        )
    worst = max(kinematics.condition(row) for row in table)
    if worst > lab.arm.condition_limit:
        raise PreflightError(f"{task}: condition number {worst:.0f}: too close to a singularity")
    return Reach(len(tour), table.min(axis=0), table.max(axis=0), worst)


def _check_line(lab: Lab, task: str, station: Station, a: tuple[int, ...], b: tuple[int, ...]) -> None:
    """Check that the straight line between two cells stays on one branch."""
    ends = lab.flange(station.pose(a)), lab.flange(station.pose(b))
    line = kinematics.interpolate(*ends, np.linspace(0, 1, LINE_POINTS))
    if kinematics.follow(line, station.near) is None:
        raise PreflightError(f"{task}: the line from cell {a} to cell {b} leaves what the arm can reach")


def lap(station: Station) -> list[tuple[int, ...]]:
    """Return all cells in an order in which each is a neighbour of the one before."""
    if len(station.shape) == 1:
        return [(i,) for i in range(station.shape[0])]
    columns, rows = station.shape
    return [(c if r % 2 == 0 else columns - 1 - c, r) for r in range(rows) for c in range(columns)]


def describe_plan(lab: Lab, starts: Sequence[Start], speed: float) -> str:
    """Return a table of what an evaluation would do; the checks of :func:`check_station` have passed."""
    lines = [
        f"{'task':14} {'episodes':>8} {'cells':>5} {'joints (degrees)':46} {'condition':>9} {'speed':>8}"
    ]
    for task in dict.fromkeys(start.task for start in starts):
        reach = check_station(lab, task)
        spans = " ".join(
            f"{a:.0f}..{b:.0f}" for a, b in zip(np.degrees(reach.low), np.degrees(reach.high), strict=True)
        )
        number = sum(start.task == task for start in starts)
        lines.append(
            f"{task:14} {number:8} {reach.cells:5} {spans:46} {reach.condition:9.1f} {speed:5.2f} m/s"
        )
    return "\n".join(lines)


def check_dashboard(lab: Lab, dashboard: Dashboard) -> tuple[str, list[Check]]:
    """Return the robot's serial number and what its dashboard says about it; asks, changes nothing."""
    oldest, version = lab.arm.oldest_polyscope, dashboard.version()
    checks = [
        Check(
            "PolyScope", ".".join(map(str, version)), version[:2] >= oldest, ".".join(map(str, oldest)) + "+"
        )
    ]
    if not checks[0].passed:  # what follows needs a newer one
        return "", checks
    questions = (
        ("robot model", "get robot model", lab.arm.model),
        ("remote control", "is in remote control", "true"),
        ("robot mode", "robotmode", "Robotmode: RUNNING"),
        ("safety status", "safetystatus", "Safetystatus: NORMAL"),
    )
    for name, question, wanted in questions:
        answer = dashboard.ask(question)
        checks.append(Check(name, answer, answer == wanted, wanted))
    serial = dashboard.ask("get serial number")
    checks.append(Check("serial number", serial, serial.isdigit(), "digits"))
    return serial, checks


def check_gripper(lab: Lab, gripper: RddaGripper) -> list[Check]:
    """Return what the gripper says about itself; nothing of it moves."""
    lower, upper = gripper.read_bounds()
    angles = gripper.read_positions()
    inside = all(low <= angle <= high for low, angle, high in zip(lower, angles, upper, strict=True))
    return [Check("gripper angles", f"{angles[0]:.3f}, {angles[1]:.3f} rad", inside, f"{lower} .. {upper}")]


def check_connection(lab: Lab, description: dict[str, float]) -> list[Check]:
    """Return what the connected controller says: payload and speed slider."""
    payload, slider = float(description["payload"]), float(description["speed_fraction"])
    return [
        Check("payload", f"{payload:.2f} kg", abs(payload - lab.arm.payload) < 0.01, f"{lab.arm.payload} kg"),
        Check(
            "speed slider",
            f"{100 * slider:.0f} %",
            slider >= SLOWEST_SLIDER,
            f"{100 * SLOWEST_SLIDER:.0f} %+",
        ),
    ]


def insist(checks: Sequence[Check]) -> str:
    """Return the checks as a table.

    Raises
    ------
    PreflightError
        One did not pass; the message names all that did not.
    """
    failed = [
        f"{check.name} is {check.found!r} instead of {check.wanted!r}" for check in checks if not check.passed
    ]
    if failed:
        raise PreflightError("not ready: " + "; ".join(failed))
    return "\n".join(f"{check.name:16} {check.found}" for check in checks)
