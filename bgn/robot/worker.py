"""The process that owns ``ur_rtde``: it samples, watches, kicks the watchdog and obeys; it never decides to go on.

The client library hangs, or crashes its interpreter, when a robot goes away; so nothing else lives here, and the
parent can kill this process at any moment. It talks to the parent through one pipe:

parent -> worker    (number, command, arguments)
worker -> parent    ("ready", description) · ("samples", rows) · ("reply", number, value) · ("failed", number, text)
                    · ("event", kind, text)

A row is (wall clock, robot clock, 6 joints, pose, tool speed, tool wrench, runtime state, safety bits, robot bits,
operation): see :data:`COLUMNS`.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

COLUMNS: Final = (
    "wall", "time", *(f"q{i}" for i in range(6)), "x", "y", "z", "rx", "ry", "rz",
    *(f"speed_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
    *(f"force_{axis}" for axis in ("x", "y", "z")), *(f"torque_{axis}" for axis in ("x", "y", "z")),
    "runtime_state", "safety_bits", "robot_bits", "operation",
)  # fmt: skip
VARIABLES: Final = [
    "timestamp", "actual_q", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "runtime_state",
    "robot_status_bits", "safety_status_bits", "robot_mode", "safety_mode", "target_speed_fraction", "payload",
    "payload_cog",
]  # fmt: skip
POLL: Final = 0.0015  # s between two looks at the receive interface
BATCH: Final = 0.01  # s between two messages of samples
KICK: Final = 0.1  # s between two kicks of the watchdog
CONTROL_RATE: Final = 500.0  # Hz
LAST_STOP: Final = 0.3  # s an orphaned worker gives the arm to stop
LOST: Final = 3  # exit code when the robot went away
PROTECTIVE, EMERGENCY = 1 << 2, 1 << 5 | 1 << 6 | 1 << 7 | 1 << 8 | 1 << 9  # safety status bits

Row = tuple[float, ...]


@dataclass(frozen=True)
class Settings:
    """What the worker needs to know; all of it comes from the laboratory's file."""

    host: str
    rate: float
    stale_after: float
    watchdog_frequency: float
    stop_deceleration: float
    force_limit: float
    log: Path


def main(pipe: Connection, settings: Settings) -> None:
    """Run until the parent hangs up, the robot goes away, or the process is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    descriptor = os.open(settings.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):  # the client library prints there
        os.dup2(descriptor, stream)
    try:
        import rtde_control
        import rtde_receive

        receive = rtde_receive.RTDEReceiveInterface(settings.host, settings.rate, VARIABLES)
        control = rtde_control.RTDEControlInterface(settings.host, CONTROL_RATE)
    except Exception as error:  # whatever the client library raises: the parent explains it
        pipe.send(("event", "refused", " ".join(str(error).split())))
        os._exit(LOST)
    _Worker(pipe, settings, control, receive).run()


class _Worker:
    def __init__(self, pipe: Connection, settings: Settings, control: Any, receive: Any) -> None:
        self._pipe, self._settings = pipe, settings
        self._control, self._receive = control, receive
        self._commands: queue.Queue[tuple[int, str, tuple[Any, ...]]] = queue.Queue()
        self._sending = threading.Lock()
        self._rows: list[Row] = []
        self._guarding = False
        self._watchdog = False

    def run(self) -> None:
        """Sample and watch in this thread, talk to the controller in another one."""
        self._send("ready", self._describe())
        threading.Thread(target=self._obey, daemon=True).start()
        last_time, changed, sent = -1.0, time.monotonic(), time.monotonic()
        while True:
            now = time.monotonic()
            if not (self._receive.isConnected() and self._control.isConnected()):
                self._give_up("the robot closed the connection")
            stamp = self._receive.getTimestamp()
            if stamp != last_time:
                last_time, changed = stamp, now
                self._take(now, stamp)
            elif now - changed > self._settings.stale_after:
                self._give_up(f"no fresh data for {now - changed:.2f} s")
            if now - sent >= BATCH and self._rows:
                self._send("samples", self._rows)
                self._rows, sent = [], now
            self._read_pipe()
            time.sleep(POLL)

    def _describe(self) -> dict[str, float | list[float]]:
        receive = self._receive
        return {
            "robot_mode": receive.getRobotMode(),
            "safety_mode": receive.getSafetyMode(),
            "speed_fraction": receive.getTargetSpeedFraction(),
            "payload": receive.getPayload(),
            "payload_centre": list(receive.getPayloadCog()),
            "joints": list(receive.getActualQ()),
        }

    def _take(self, now: float, stamp: float) -> None:
        receive = self._receive
        force, safety = receive.getActualTCPForce(), receive.getSafetyStatusBits()
        status = self._control.getAsyncOperationProgressEx()
        operation = status.operationId() * 2 + status.isAsyncOperationRunning()
        row = (
            now, stamp, *receive.getActualQ(), *receive.getActualTCPPose(), *receive.getActualTCPSpeed(), *force,
            receive.getRuntimeState(), safety, receive.getRobotStatus(), operation,
        )  # fmt: skip
        self._rows.append(row)
        pushing = sum(component**2 for component in force[:3]) ** 0.5
        if self._guarding and pushing > self._settings.force_limit:
            self._guarding = False
            self._commands.put((-1, "stop", ()))
            self._send(
                "event", "force", f"{pushing:.1f} N at the tool, the limit is {self._settings.force_limit} N"
            )

    def _read_pipe(self) -> None:
        try:
            while self._pipe.poll():
                number, command, arguments = self._pipe.recv()
                self._guarding = command in ("move_line", "move_joints") or (
                    self._guarding and command != "stop"
                )
                self._commands.put((number, command, arguments))
        except (EOFError, OSError):
            self._leave_at_rest()

    def _leave_at_rest(self) -> None:
        """Stop the arm now that the parent is gone; if that does not work, the controller's watchdog does it.

        Only the other thread speaks to the controller: a kick at the same time would take the command back.
        """
        self._watchdog = False
        self._commands.put((-1, "stop", ()))
        print(f"{time.time():.3f} the evaluation is gone: stopping the arm", flush=True)
        time.sleep(LAST_STOP)
        os._exit(0)

    def _obey(self) -> None:
        while True:
            try:
                number, command, arguments = self._commands.get(timeout=KICK)
            except queue.Empty:
                if self._watchdog:
                    self._control.kickWatchdog()
                continue
            try:
                value = self._handlers()[command](*arguments)
            except Exception as error:  # whatever the client library raises, the parent has to hear of it
                self._send("failed", number, f"{command}: {' '.join(str(error).split())}")
            else:
                self._send("reply", number, value)

    def _handlers(self) -> dict[str, Callable[..., Any]]:
        control = self._control
        return {
            "move_line": lambda pose, speed, acceleration: control.moveL(pose, speed, acceleration, True),
            "move_joints": lambda q, speed, acceleration: control.moveJ(q, speed, acceleration, True),
            "stop": lambda: control.stopL(self._settings.stop_deceleration, True),
            "zero_force": control.zeroFtSensor,
            "set_tool": lambda tcp, payload, centre: (
                control.setTcp(tcp) and control.setPayload(payload, centre)
            ),
            "read_tool": control.getTCPOffset,
            "pose_is_safe": control.isPoseWithinSafetyLimits,
            "start_watchdog": self._start_watchdog,
            "describe": self._describe,
        }

    def _start_watchdog(self) -> bool:
        self._watchdog = bool(self._control.setWatchdog(self._settings.watchdog_frequency))
        return self._watchdog

    def _give_up(self, why: str) -> None:
        """Say that the robot is lost and die at once, before the client library tries to reconnect by itself."""
        if self._rows:
            self._send("samples", self._rows)
        self._send("event", "lost", why)
        os._exit(LOST)

    def _send(self, *message: Any) -> None:
        # A parent that is gone is noticed where its commands are read.
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(message)
