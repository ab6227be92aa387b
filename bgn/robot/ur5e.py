"""The arm as seen from the evaluation: a supervised worker process around ``ur_rtde``.

Every move is asynchronous for the controller and supervised here until the tool is seen to be at rest at its
target: what the client library returns is never trusted. Whatever goes wrong ends with the arm stopped, the worker
alive or killed, and an exception that says what happened.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import signal
import time
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

import numpy as np

from bgn.robot import kinematics, paths
from bgn.robot.dashboard import Dashboard, stop_program
from bgn.robot.errors import (
    AbortedError,
    ConnectionLostError,
    EmergencyStopError,
    MissingExtraError,
    MotionError,
    PreflightError,
    ProgramStoppedError,
    ProtectiveStopError,
    RobotError,
)
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab, Station
from bgn.robot.worker import COLUMNS, EMERGENCY, PROTECTIVE, Row, Settings
from bgn.robot.worker import main as worker_main

CONNECT_TIMEOUT: Final = 15.0  # s until the worker must have connected
PERIOD: Final = 0.005  # s between two looks at the worker
PLAYING: Final = 2
REST_TIMEOUT: Final = 2.0  # s until a stopped arm must be at rest
UNLOCK_AFTER: Final = 5.5  # s from a protective stop to unlocking it; the controller refuses for 5 s
LONGEST_LATE: Final = 0.5  # s of robot time the tool may need to settle at a target
SAME_PLACE: Final = 0.005  # rad by which joints may differ before and after a stop was unlocked

_TIME, _JOINTS, _POSE = COLUMNS.index("time"), COLUMNS.index("q0"), COLUMNS.index("x")
_SPEED, _RUNTIME = COLUMNS.index("speed_x"), COLUMNS.index("runtime_state")
_SAFETY, _OPERATION = COLUMNS.index("safety_bits"), COLUMNS.index("operation")


class Log(Protocol):
    """Where samples and events go; the recording is one."""

    def samples(self, rows: Iterable[Row]) -> None:
        """Take rows of the worker's columns."""
        ...

    def event(self, kind: str, text: str) -> None:
        """Take something that happened or was commanded."""
        ...


class NoLog:
    """Keeps nothing."""

    def samples(self, rows: Iterable[Row]) -> None:
        """Ignore them."""

    def event(self, kind: str, text: str) -> None:
        """Ignore it."""


class Abort:
    """Whether the operator wants everything to stop; Ctrl-C sets it while it is installed."""

    def __init__(self) -> None:
        self.asked = False
        self._before: Any = None

    def install(self) -> None:
        """Let Ctrl-C set it instead of raising KeyboardInterrupt."""
        self._before = signal.signal(signal.SIGINT, self._ask)

    def remove(self) -> None:
        """Give Ctrl-C back."""
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def check(self) -> None:
        """Raise AbortedError if it was asked for."""
        if self.asked:
            raise AbortedError("aborted by the operator (Ctrl-C)")

    def _ask(self, number: int, frame: Any) -> None:
        self.asked = True


class UR5e:
    """One arm.

    Parameters
    ----------
    lab, host
        Its numbers and address; the caller has checked that the address may be spoken to.
    folder
        Where the client library's output is kept.
    abort
        Looked at during every wait.
    meanwhile
        Called at every look at the worker, for instance to poll the gripper; must return at once.
    """

    def __init__(
        self,
        lab: Lab,
        host: str,
        folder: Path,
        abort: Abort | None = None,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        self.lab, self.host, self._folder = lab, host, folder
        self.abort = abort or Abort()
        self.log: Log = NoLog()
        self.station: Station | None = None
        """Whose workspace and joint windows every straight line must keep to."""
        self.description: dict[str, Any] = {}
        self.meanwhile = meanwhile
        self._process: Any = None
        self._pipe: Connection | None = None
        self._latest: Row = ()
        self._fresh = 0.0
        self._replies: dict[int, tuple[bool, Any]] = {}
        self._number = 0
        self._too_much_force = ""
        self._stopped_at = 0.0

    # -- connection -----------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Start a worker and let it take control: uploads the control script, moves nothing.

        Raises
        ------
        MissingExtraError
            ``ur_rtde`` is not installed.
        PreflightError
            The controller refuses; the message is the client library's.
        ConnectionLostError
            The robot does not answer in time.
        """
        check_extra()
        self.kill()
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        arm = self.lab.arm
        settings = Settings(
            host=self.host,
            rate=arm.sample_rate,
            stale_after=arm.stale_after,
            watchdog_frequency=arm.watchdog_frequency,
            stop_deceleration=arm.stop_deceleration,
            force_limit=arm.force_limit,
            log=self._folder / "ur_rtde.log",
        )
        self._process = context.Process(target=worker_main, args=(theirs, settings), daemon=True)
        self._process.start()
        theirs.close()
        self.description, self._latest = {}, ()
        self._wait(lambda: bool(self.description and self._latest), CONNECT_TIMEOUT, "connect")
        self._call("set_tool", list(arm.tcp), arm.payload, list(arm.payload_centre))
        self._check_tool()
        if not self._call("start_watchdog"):
            raise PreflightError("the controller did not start the watchdog of the connection")
        self.description = self._call("describe")

    def _check_tool(self) -> None:
        tool = self._call("read_tool")
        if np.abs(np.array(tool) - np.array(self.lab.arm.tcp)).max() > 1e-6:
            raise PreflightError(
                f"the controller's tool centre is {np.round(tool, 4)}, not {self.lab.arm.tcp}"
            )

    def kill(self) -> None:
        """End the worker at once, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None

    def close(self) -> None:
        """Stop the arm if it still moves, stop the program and end the worker, if there ever was one."""
        if self.description:
            self.log.event("dashboard", stop_program(self.host))
        self.kill()

    @property
    def worker(self) -> int | None:
        """The worker's process id."""
        return None if self._process is None else int(self._process.pid)

    # -- what the arm is doing ------------------------------------------------------------------------------

    def pose(self) -> Floats:
        """Return the hinge's latest measured pose (6,)."""
        self._look(0.0)
        return np.array(self._latest[_POSE : _POSE + 6])

    def joints(self) -> Floats:
        """Return the latest measured joint angles (6,)."""
        self._look(0.0)
        return np.array(self._latest[_JOINTS : _JOINTS + 6])

    def playing(self) -> bool:
        """Whether the worker lives and the control program runs."""
        return self._process is not None and bool(self._latest) and self._latest[_RUNTIME] == PLAYING

    def settle(self, seconds: float) -> None:
        """Stay at rest for so long, in the robot's own time."""
        self._look(0.0)
        due = self._latest[_TIME] + seconds
        while self._latest[_TIME] < due:
            self._look(PERIOD)
            self._check_safety()
            if self.abort.asked:
                self._stop_and_raise(AbortedError("aborted by the operator (Ctrl-C)"))

    # -- moves ----------------------------------------------------------------------------------------------

    def move_line(self, pose: Floats, speed: float) -> None:
        """Move the hinge straight to a pose (6,) and verify that it is at rest there.

        Raises
        ------
        MotionError
            The speed is above the cap, the line or its end is out of reach or unsafe, the force limit was met, the
            target was missed or not reached in time.
        RobotError
            Anything else that happened meanwhile; the arm is stopped.
        """
        arm = self.lab.arm
        if not 0 < speed <= arm.speed_cap:
            raise MotionError(f"a speed of {speed} m/s is not in 0..{arm.speed_cap}")
        goal = self.lab.flange(pose)
        path = paths.line(
            kinematics.forward(self.joints()), goal, self.joints(), speed, arm.acceleration, 0.05
        )
        if path is None or not kinematics.within_limits(path):
            raise MotionError(f"the straight line to {np.round(pose[:3], 3)} leaves what the arm can reach")
        self._check_windows(pose, path)
        if not self._call("pose_is_safe", [float(value) for value in pose]):
            raise MotionError(f"the controller's safety limits do not allow the pose {np.round(pose, 3)}")
        distance = float(np.linalg.norm(pose[:3] - self.pose()[:3]))
        self.log.event("move_line", f"{np.round(pose, 5).tolist()} at {speed} m/s")
        self._supervise(
            "move_line", [float(value) for value in pose], speed, arm.acceleration, distance / speed
        )
        self._verify(pose)

    def _check_windows(self, pose: Floats, path: Floats) -> None:
        if self.station is None:
            return
        if not self.station.contains(pose[:3]):
            raise MotionError(
                f"the target {np.round(pose[:3], 3)} is outside the workspace {self.station.workspace}"
            )
        away = np.abs(path - np.array(self.station.near)).max(axis=0)
        if away.max() > self.station.window:
            raise MotionError(
                f"joint {int(away.argmax())} would turn {away.max():.2f} rad from its middle, the window is "
                f"{self.station.window} rad"
            )

    def move_joints(self, joints: Floats) -> None:
        """Move straight in joint space to joint angles (6,); raises as :meth:`move_line` does."""
        arm = self.lab.arm
        if not kinematics.within_limits(joints):
            raise MotionError(f"joint angles {np.round(joints, 2)} are beyond 360 degrees")
        turn = float(np.abs(joints - self.joints()).max())
        pose = kinematics.to_pose(kinematics.forward(joints) @ self.lab.tool)
        if not self._call("pose_is_safe", [float(value) for value in pose]):
            raise MotionError(f"the controller's safety limits do not allow the joints {np.round(joints, 3)}")
        self.log.event("move_joints", f"{np.round(joints, 5).tolist()} at {arm.joint_speed} rad/s")
        angles = [float(value) for value in joints]
        self._supervise(
            "move_joints", angles, arm.joint_speed, arm.joint_acceleration, turn / arm.joint_speed
        )
        self._verify(pose)

    def zero_force(self) -> None:
        """Call the present force at the tool zero; only in free air."""
        self._call("zero_force")

    def stop(self) -> None:
        """Bring the arm to rest by the worker, or by the dashboard if that does not work.

        Raises
        ------
        RobotError
            It could not be seen to come to rest.
        """
        self.log.event("stop", "asked for")
        try:
            self._call("stop")
            self._wait(self._at_rest, REST_TIMEOUT, "come to rest")
        except RobotError:
            self._lose("the arm was not seen to stop")

    def unlock(self) -> None:
        """After the operator has cleared the cause of a protective stop: wait, unlock, take control, check the pose.

        Raises
        ------
        ProtectiveStopError
            The controller does not unlock.
        MotionError
            The arm is not where it was.
        """
        before = np.array(self._latest[_JOINTS : _JOINTS + 6])
        time.sleep(max(0.0, self._stopped_at + UNLOCK_AFTER - time.monotonic()))
        self.kill()
        dashboard = Dashboard(self.host)
        try:
            dashboard.ask("close safety popup")
            answer = dashboard.ask("unlock protective stop")
        finally:
            dashboard.close()
        self.log.event("unlock", answer)
        if answer != "Protective stop releasing":
            raise ProtectiveStopError(f"the controller does not unlock: {answer[:80]}")
        time.sleep(0.5)
        self.connect()
        moved = float(np.abs(self.joints() - before).max())
        if moved > SAME_PLACE:
            raise MotionError(f"a joint moved by {moved:.3f} rad while the protective stop was unlocked")

    def _supervise(
        self, command: str, target: list[float], speed: float, acceleration: float, takes: float
    ) -> None:
        self.abort.check()
        self._check_safety()
        self._too_much_force = ""
        operation = self._latest[_OPERATION] // 2
        if not self._call(command, target, speed, acceleration):
            self._look(0.0)
            self._check_safety()
            self._stop_and_raise(MotionError("the controller did not take the move; its log says why"))
        due = self._latest[_TIME] + 2 * takes + speed / acceleration + 3.0
        while not (self._operation_ended(operation) and self._at_rest()):
            self._look(PERIOD)
            self._check_safety()
            if self.abort.asked:
                self._stop_and_raise(AbortedError("aborted by the operator (Ctrl-C)"))
            if self._too_much_force:
                self._stop_and_raise(MotionError(self._too_much_force))
            if self._latest[_TIME] > due:
                self._stop_and_raise(MotionError("the move takes far longer than it should"))

    def _operation_ended(self, before: float) -> bool:
        number, running = divmod(self._latest[_OPERATION], 2)
        return number != before and not running

    def _verify(self, pose: Floats) -> None:
        due = self._latest[_TIME] + LONGEST_LATE
        while (error := float(np.linalg.norm(self.pose()[:3] - pose[:3]))) > self.lab.arm.target_tolerance:
            self._look(PERIOD)
            self._check_safety()
            if self._too_much_force:
                raise MotionError(self._too_much_force)
            if self._latest[_TIME] > due:
                raise MotionError(f"the tool came to rest {1e3 * error:.1f} mm from its target")

    def _at_rest(self) -> bool:
        speed = np.linalg.norm(self._latest[_SPEED : _SPEED + 3])
        return bool(speed < self.lab.arm.rest_speed)

    def _stop_and_raise(self, error: RobotError) -> NoReturn:
        self.stop()
        raise error

    # -- supervision ----------------------------------------------------------------------------------------

    def _call(self, command: str, *arguments: Any) -> Any:
        self._number += 1
        number = self._number
        try:
            if self._pipe is None:
                raise OSError("not connected")
            self._pipe.send((number, command, arguments))
        except OSError as error:
            self._lose(f"the worker process is gone ({error})")
        self._wait(lambda: number in self._replies, self.lab.arm.command_timeout, command)
        succeeded, value = self._replies.pop(number)
        if not succeeded:
            raise MotionError(f"the client library refuses {value}")
        return value

    def _wait(self, ready: Callable[[], bool], seconds: float, what: str) -> None:
        due = time.monotonic() + seconds
        while not ready():
            self._look(PERIOD)
            if time.monotonic() > due:
                self._lose(f"no answer to {what!r} within {seconds:g} s")

    def _look(self, seconds: float) -> None:
        """Take in what the worker has sent, waiting at most so long for it."""
        assert self._pipe is not None, "not connected"
        self.meanwhile()
        try:
            while self._pipe.poll(seconds):
                self._take(self._pipe.recv())
                seconds = 0.0
        except (EOFError, OSError):
            self._lose("the worker process died")
        # The worker watches the robot; here the worker itself is watched.
        if self._latest and time.monotonic() - self._fresh > self.lab.arm.stale_after + 0.1:
            self._lose(f"nothing from the worker process for {time.monotonic() - self._fresh:.2f} s")

    def _take(self, message: tuple[Any, ...]) -> None:
        kind = message[0]
        if kind == "samples":
            self._latest, self._fresh = message[1][-1], time.monotonic()
            self.log.samples(message[1])
        elif kind in ("reply", "failed"):
            self._replies[message[1]] = (kind == "reply", message[2])
        elif kind == "ready":
            self.description = message[1]
        elif message[1] == "force":
            self._too_much_force = message[2]
            self.log.event("force", message[2])
        elif message[1] == "refused":
            self.kill()
            raise PreflightError(f"{self.host}: {message[2]}")
        else:
            self._lose(message[2])

    def _lose(self, why: str) -> NoReturn:
        """Stop the program by the dashboard, kill the worker, and raise."""
        answer = stop_program(self.host)
        self.kill()
        self.log.event("lost", f"{why}; dashboard: {answer}")
        raise ConnectionLostError(f"{self.host}: {why}; the dashboard's answer to stop: {answer}")

    def _check_safety(self) -> None:
        safety, runtime = int(self._latest[_SAFETY]), self._latest[_RUNTIME]
        if safety & EMERGENCY:
            self._stopped_at = time.monotonic()
            self.kill()
            raise EmergencyStopError(f"{self.host}: emergency stop or safety fault (safety bits {safety:#x})")
        if safety & PROTECTIVE:
            self._stopped_at = time.monotonic()
            self.log.event("protective stop", f"safety bits {safety:#x}")
            raise ProtectiveStopError(f"{self.host}: the controller made a protective stop")
        if runtime != PLAYING:
            self.log.event("program stopped", f"runtime state {runtime:.0f}")
            raise ProgramStoppedError(f"{self.host}: the control program ended (runtime state {runtime:.0f})")


def check_extra() -> None:
    """Raise MissingExtraError unless ``ur_rtde`` is installed."""
    if importlib.util.find_spec("rtde_control") is None:
        raise MissingExtraError(
            "ur_rtde is not installed; it comes with the extra: pip install -e '.[robot]'"
        )
