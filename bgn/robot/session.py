"""One evaluation at the robot: from preflight to the table of successes, with everything that can come between.

preflight -> confirmation -> per task: bench, station, first lap -> per episode: objects, start, steps, outcome.
An interruption marks the episode, stops the arm, makes the finger soft, and asks the operator; nothing resumes by
itself.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd

from bgn import domains
from bgn.domains.domain import Domain
from bgn.domains.layout import TouchLayout
from bgn.physics.tasks import draw_start
from bgn.robot import kinematics, preflight
from bgn.robot.dashboard import Dashboard
from bgn.robot.entrant import Entrant
from bgn.robot.environment import ArmEnvironment
from bgn.robot.errors import (
    AbortedError,
    ConnectionLostError,
    EmergencyStopError,
    MotionError,
    PreflightError,
    ProtectiveStopError,
    RefusedError,
    RobotError,
    UsageError,
)
from bgn.robot.finger import ArmFinger
from bgn.robot.gripper import RddaGripper
from bgn.robot.lab import Lab, Station
from bgn.robot.operators import Operator
from bgn.robot.recording import Recording, SessionFolder, Start
from bgn.robot.summary import Circumstances, summarise
from bgn.robot.ur5e import Abort, UR5e
from bgn.robot.worker import Row

NEAR_STATION: Final = 0.5  # rad a joint may be from a station's middle for the arm to drive there by itself
UPRIGHT: Final = 0.999  # cosine of the finger's tilt at most
RETRY: Final = {"retry": "begin this episode again", "stop": "end the session"}


def plan(tasks: Sequence[str], episodes: int, seed: int) -> list[Start]:
    """Draw the starts of all episodes from the domains' start distributions."""
    starts = []
    for task in tasks:
        domain, rng = domains.get(task), np.random.default_rng(seed)
        starts += [Start(task, number, *draw_start(domain, rng)) for number in range(episodes)]
    return starts


class _Logs:
    """Passes what arm and gripper report on to the recording of the moment."""

    def __init__(self) -> None:
        self.recording: Recording | None = None

    def samples(self, rows: Iterable[Row]) -> None:
        if self.recording is not None:
            self.recording.samples(rows)

    def event(self, kind: str, text: str) -> None:
        if self.recording is not None:
            self.recording.event(kind, text)

    def angles(self, pair: tuple[float, float]) -> None:
        if self.recording is not None:
            self.recording.angles(pair)


class Session:
    """One evaluation.

    Parameters
    ----------
    lab, host, gripper_host
        The laboratory and its addresses, which the caller has checked.
    entrants
        The policies by task.
    starts
        The episodes.
    folder
        Where everything is recorded.
    operator, abort
        The person at the robot, and whether they pressed Ctrl-C.
    speed
        Of the episodes' moves, m/s.
    """

    def __init__(
        self,
        lab: Lab,
        host: str,
        gripper_host: str,
        entrants: dict[str, Entrant],
        starts: Sequence[Start],
        folder: SessionFolder,
        operator: Operator,
        abort: Abort,
        speed: float,
    ) -> None:
        self.lab, self.host, self.entrants, self.starts = lab, host, entrants, starts
        self.folder, self.operator, self.abort, self.speed = folder, operator, abort, speed
        self.serial = ""
        self.version: tuple[int, ...] = ()
        self._logs = _Logs()
        self._gripper = RddaGripper(gripper_host, lab.gripper, self._logs.angles, self._logs.event)
        self._arm = UR5e(lab, host, folder.path, abort, self._gripper.poll)
        self._arm.log = self._logs
        self._finger: ArmFinger | None = None
        self._y = self._hidden = -1
        """The hidden part of the present episode, as the domain counts it and as the finger's task does."""

    # -- the whole ------------------------------------------------------------------------------------------

    def run(self, *, lap: bool = True) -> pd.DataFrame:
        """Run everything that is not finished yet and return the summary.

        Raises
        ------
        RobotError
            What ended the session; everything recorded so far is kept and a summary of it is written.
        """
        self.abort.install()
        try:
            self.preflight()
            self._confirm()
            finished = self.folder.finished()
            for task in dict.fromkeys(start.task for start in self.starts):
                left = [
                    start
                    for start in self.starts
                    if start.task == task and (task, start.number) not in finished
                ]
                if left:
                    self._run_task(task, left, lap=lap)
        finally:
            self._leave()
            table = self.summary()
            if len(table):
                self.folder.save_summary(table)
            self.abort.remove()
        return table

    def preflight(self) -> str:
        """Ask robot and gripper whether they are ready; nothing moves and nothing is uploaded. Return the serial.

        Raises
        ------
        PreflightError
            Something is not as it should be.
        """
        dashboard = Dashboard(self.host)
        try:
            self.version = dashboard.version()
            self.serial, checks = preflight.check_dashboard(self.lab, dashboard)
        finally:
            dashboard.close()
        self.operator.tell(preflight.insist(checks))
        self.operator.tell(preflight.insist(preflight.check_gripper(self.lab, self._gripper)))
        return self.serial

    def close(self) -> None:
        """Give the gripper's port back."""
        self._gripper.close()

    def _confirm(self) -> None:
        digests = "+".join(entrant.digest[:8] for entrant in self.entrants.values())
        self.operator.confirm(
            f"{len(self.starts)} episodes at {self.speed} m/s on robot {self.serial}, policies {digests}. The safety "
            "system is the one set at the pendant; this program is not one. Keep a hand at the emergency stop.",
            f"{self.serial} {digests} {self.speed}",
        )

    def _leave(self) -> None:
        """Leave nothing moving and nothing stiff, whatever has happened."""
        self._arm.close()
        if self._finger is not None:
            with contextlib.suppress(RobotError):
                self._finger.rest()

    # -- one task -------------------------------------------------------------------------------------------

    def _run_task(self, task: str, starts: Sequence[Start], *, lap: bool) -> None:
        station = self.lab.station(task)
        self._arm.close()  # nobody steps up to an arm whose program runs
        self.operator.change_task(
            task,
            f"{task}: set up its bench, bring the arm before it (joints near {np.round(station.near, 1)})",
        )
        self._arm.station = None
        self._connect()
        self._finger = ArmFinger(
            self.lab, task, self._arm, self._gripper, lambda hidden: self._place(task, hidden), self._pushed
        )
        if lap:
            self._lap(task)
        for start in starts:
            self._run_episode(start)

    def _connect(self) -> None:
        self._arm.connect()
        self.operator.tell(preflight.insist(preflight.check_connection(self.lab, self._arm.description)))

    def _lap(self, task: str) -> None:
        """Go slowly through all cells of an empty bench; the finger must feel nothing."""
        assert self._finger is not None
        finger, station = self._finger, self.lab.station(task)
        recording = self.folder.begin(f"{task}-lap", {"kind": "lap", "task": task})
        with self._recorded(recording):
            self.operator.place(task, None, f"{task}: take all objects away for a slow first lap")
            self._approach(task)
            finger.speed = self.lab.arm.first_lap_speed
            tour = preflight.lap(station)
            first = tour[0]
            finger.begin_at(first)
            for before, cell in pairwise(tour):
                axis = int(np.flatnonzero(np.subtract(cell, before))[0])
                angle = finger.step_to(cell, axis)
                recording.step(cell=str(cell), angle=angle)
                if int(np.searchsorted(station.angle_edges, angle)) != len(station.angle_edges) // 2:
                    raise MotionError(
                        f"first lap: the finger is bent by {angle:.3f} rad at cell {cell} of an empty bench"
                    )
            finger.withdraw()
            recording.finish("done")
        finger.speed = self.speed

    def _approach(self, task: str) -> None:
        """Drive to the middle of a station, withdrawn: straight out of its cells, or from nearby."""
        station = self.lab.station(task)
        middle = station.pose(tuple((size - 1) // 2 for size in station.shape), retreat=True)
        if self._at_station(station):
            self._arm.station = station
            self._withdraw(task)
            self._arm.move_line(middle, self.lab.arm.first_lap_speed)
            return
        goal = kinematics.nearest(self.lab.flange(middle), station.near)
        assert goal is not None  # the plan was checked
        away = np.abs(self._arm.joints() - goal).max()
        if away > NEAR_STATION:
            raise MotionError(
                f"{task}: a joint is {away:.2f} rad from the station, at most {NEAR_STATION} are driven; bring the arm "
                f"near {np.round(goal, 2)} by hand"
            )
        self._arm.move_joints(goal)
        self._arm.station = station

    def _at_station(self, station: Station) -> bool:
        """Whether the finger is in the workspace and points as it should."""
        pose, joints = self._arm.pose(), self._arm.joints()
        wanted = station.pose((0,) * len(station.axes))
        upright = kinematics.to_transform(pose)[:3, 2] @ kinematics.to_transform(wanted)[:3, 2]
        turned = np.abs(joints - np.array(station.near)).max()
        return station.contains(pose[:3]) and bool(upright > UPRIGHT and turned <= station.window)

    # -- one episode ----------------------------------------------------------------------------------------

    def _run_episode(self, start: Start) -> None:
        """Play an episode to its end, beginning it again as often as the operator says."""
        while True:
            about = {
                "kind": "episode",
                "task": start.task,
                "number": start.number,
                "x": start.x,
                "y": start.y,
            }
            recording = self.folder.begin(start.name, about)
            try:
                with self._recorded(recording):
                    self._play(start, recording)
                return
            except (AbortedError, RefusedError, EmergencyStopError, PreflightError, UsageError):
                raise
            except RobotError as error:
                self._recover(error, start)

    def _play(self, start: Start, recording: Recording) -> None:
        assert self._finger is not None
        entrant = self.entrants[start.task]
        if self._arm.station is None:
            self._approach(start.task)
        self._finger.speed = self.speed
        environment = ArmEnvironment(entrant.domain, self._finger)
        entrant.policy.reset()
        self._y = start.y
        observation, information = environment.reset(options={"start": (start.x, start.y)})
        action: int | None = None
        ended = truncated = success = False
        step = 0
        self._keep(recording, step, None, observation, information)
        while not (ended or truncated):
            action = entrant.policy.act(int(observation), action)
            before = time.monotonic()
            observation, reward, ended, truncated, information = environment.step(np.int64(action))
            step, success = step + 1, reward == 1
            self._keep(recording, step, action, observation, information, seconds=time.monotonic() - before)
        outcome = "success" if success else "failure" if ended else "out-of-time"
        recording.finish(outcome, steps=step, baseline=list(self._finger.baseline), speed=self.speed)
        self.operator.tell(f"{start.name}: {outcome} after {step} steps")

    def _keep(
        self,
        recording: Recording,
        step: int,
        action: int | None,
        seen: Any,
        information: dict[str, Any],
        **more: float,
    ) -> None:
        hinge = self._arm.pose()
        recording.step(
            step=step,
            action=-1 if action is None else action,
            observation=int(seen),
            observed=int(information["observed"]),
            hidden=self._hidden,
            angle=float(information["angle"]),
            wall=time.monotonic(),
            seconds=more.get("seconds", 0.0),
            **dict(zip("xyz", map(float, hinge[:3]), strict=True)),
        )

    @contextlib.contextmanager
    def _recorded(self, recording: Recording) -> Iterator[None]:
        """Record what arm and gripper report; mark the recording with whatever interrupts it."""
        self._logs.recording = recording
        try:
            yield
        except RobotError as error:
            self._calm()
            recording.finish(error.outcome, str(error))
            raise
        finally:
            self._logs.recording = None

    def _calm(self) -> None:
        """After an interruption: the finger is made soft, as far as it can be told."""
        if self._finger is not None:
            try:
                self._finger.rest()
                self._logs.event("soft", "both fingers")
            except RobotError as error:
                self._logs.event("gripper", f"not made soft: {error}")

    def _recover(self, error: RobotError, start: Start) -> None:
        """Ask the operator, bring everything back, and withdraw the finger; or end the session."""
        self.operator.tell(f"{start.name} interrupted: {error}")
        if isinstance(error, ProtectiveStopError):
            choices = {
                "cleared": "the cause is gone; unlock and begin this episode again",
                "stop": RETRY["stop"],
            }
            if self.operator.choose("protective stop: find its cause and remove it.", choices) == "stop":
                raise error
            self._arm.unlock()
        else:
            question = f"{error.outcome}: look at the robot."
            if self.operator.choose(question, RETRY) == "stop":
                raise error
            if isinstance(error, ConnectionLostError) or self._arm.worker is None or not self._arm.playing():
                self.preflight()
                self._connect()
        self._withdraw(start.task)

    def _withdraw(self, task: str) -> None:
        """Take the finger straight out of the objects from wherever it was stopped."""
        station = self.lab.station(task)
        pose = self._arm.pose()
        out = np.concatenate([pose[:3] + np.array(station.retreat), station.orientation])
        corners = np.sort(np.array(station.workspace), axis=0)
        out[:3] = np.clip(out[:3], corners[0], corners[1])
        self._arm.move_line(out, self.lab.arm.first_lap_speed)
        if self._finger is not None:
            self._finger.forget_cell()

    # -- the operator's part --------------------------------------------------------------------------------

    def _place(self, task: str, hidden: int) -> None:
        self._hidden = hidden
        self.operator.place(task, hidden, f"{task}: {describe_objects(self.entrants[task].domain, self._y)}")

    def _pushed(self) -> int:
        return self.operator.pushed()

    # -- what came out --------------------------------------------------------------------------------------

    def summary(self) -> pd.DataFrame:
        """Return one row a task of the episodes that came to their end."""
        polyscope = ".".join(map(str, self.version))
        circumstances = Circumstances(self.lab, self.host, self.serial, polyscope, self.speed)
        return summarise(self.folder, self.entrants, circumstances)


def describe_objects(domain: Domain, y: int) -> str:
    """Say to a person what a hidden part asks to be placed."""
    layout = domain.layout
    assert isinstance(layout, TouchLayout)
    places = [divmod(int(cell), layout.shape[1]) for cell in layout.places[y]]
    return (
        ", ".join(
            f"{name} into row {row}, column {column}"
            for name, (row, column) in zip(layout.objects, places, strict=True)
        )
        + " (counted from 0, as the bench is marked)"
    )
