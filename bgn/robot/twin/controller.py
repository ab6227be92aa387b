"""The simulated controller: registers, program, motion commands, safety, dashboard answers.

It knows nothing of sockets. ``bgn.robot.twin.rtde`` and the other servers move bytes in and out of it, and
:meth:`Controller.advance` lets time pass. Where a real controller's behaviour is not published, the docstring says
"assumed".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from bgn.robot import kinematics, paths
from bgn.robot.kinematics import Floats
from bgn.robot.twin.plant import STEP, Plant

REGISTERS: Final = 48
STOPPING, STOPPED, PLAYING, PAUSING, PAUSED = range(5)  # runtime states
MODE_OFF, MODE_IDLE, MODE_RUNNING = 3, 5, 7
SAFETY_NORMAL, SAFETY_PROTECTIVE, SAFETY_EMERGENCY = 1, 3, 7
READY, DONE = 1, 2  # what the control script writes into output_int_register_0
STARTUP: Final = 0.05  # s from an uploaded script to a running program (assumed)
UNLOCK_AFTER: Final = 5.0  # s a protective stop cannot be unlocked
HALT_DECELERATION: Final = 4.0  # rad/s^2 of a program that is stopped (assumed)
STEADY: Final = 1e-4  # rad/s
LOOKAHEAD: Final = 500  # steps of a speed command planned at a time
LOCAL: Final = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode "
    "and reconnect to port 29999"
)
TOO_EARLY: Final = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)
REAL_TIME: Final = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})


class ScriptError(RuntimeError):
    """The control script meets a runtime error: the program stops."""


@dataclass
class Program:
    """The running control script."""

    offset: int
    starts: float
    """Simulated time at which it begins to run."""
    executing: bool = False
    blocking: bool = False
    asynchronous: bool = False
    watchdog: float = 0.0
    """Seconds of wall time without fresh input that stop it; 0 if none was set."""


class Controller:
    """A UR5e controller in front of a plant."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.version = tuple(int(part) for part in plant.lab.twin.polyscope.split("."))
        self.serial = plant.lab.twin.serial
        self.remote = True
        self.resumes_paused = False
        """Whether unlocking a protective stop leaves the program paused instead of stopped (both are assumed)."""
        self.fieldbus = False
        """Whether a fieldbus owns the input registers."""
        self.input_ints = [0] * REGISTERS
        self.input_doubles = [0.0] * REGISTERS
        self.output_ints = [0] * REGISTERS
        self.output_doubles = [0.0] * REGISTERS
        self.owners: dict[str, object] = {}
        self.program: Program | None = None
        self.runtime = STOPPED
        self.robot_mode = MODE_RUNNING
        self.safety_mode = SAFETY_NORMAL
        self.speed_fraction = 1.0
        self.tcp = kinematics.to_transform(plant.lab.arm.tcp)
        self.payload = 0.0
        self.payload_centre = [0.0, 0.0, 0.0]
        self.force_offset = np.zeros(3)
        self.log: list[str] = []
        self._silence = 0.0
        self._locked_for = 0.0
        self._operation = self._writes = 0
        self._speed: tuple[str, Floats] | None = None
        self._told = kinematics.to_pose(self.tcp)

    # -- time -----------------------------------------------------------------------------------------------

    def advance(self, steps: int, wall: float, listening: float | None = None) -> None:
        """Let ``steps`` control cycles and ``wall`` seconds of real time pass.

        During ``listening`` seconds of them (by default all) a client's messages would have been heard.
        """
        self._silence += wall if listening is None else listening
        self._locked_for += wall
        self._watch()
        self._run_script()
        self.plant.advance(steps)
        self._finish_motion()
        self._check_limits()

    def heard(self) -> None:
        """Note that a client refreshed the command register."""
        self._silence = 0.0

    def _watch(self) -> None:
        if self.program and self.program.watchdog and self._silence > self.program.watchdog:
            self.stop_program("watchdog: input_int_register_0 was not refreshed in time")

    # -- the program ----------------------------------------------------------------------------------------

    def upload(self, script: str) -> None:
        """Run an uploaded control script; ignored in local mode (assumed) and while a stop is active."""
        if not self.remote or self.safety_mode != SAFETY_NORMAL or self.robot_mode != MODE_RUNNING:
            self.log.append("script ignored")
            return
        found = re.search(r"# int register offset\n\s*(\d+)", script)
        if found is None or int(found[1]) not in (0, 24):
            self.log.append("script without a register offset")
            return
        if self.program is not None:
            self.stop_program("replaced by another script")
        self.program = Program(offset=int(found[1]), starts=self.plant.time + STARTUP)

    def stop_program(self, why: str) -> None:
        """End the program; the arm decelerates to rest."""
        self.log.append(f"program stopped: {why}")
        self.program, self._speed, self.runtime = None, None, STOPPED
        self.plant.brake_joints(HALT_DECELERATION)

    @property
    def running(self) -> bool:
        """Whether the program runs."""
        return self.runtime == PLAYING

    def _run_script(self) -> None:
        program = self.program
        if program is None or self.runtime == PAUSED:
            return
        if self.runtime != PLAYING:
            if self.plant.time < program.starts:
                return
            self.runtime = PLAYING
            self._silence = 0.0
            self._report_operation(running=False)
            self._signal(READY)
        if program.blocking:
            return
        command = self.input_ints[program.offset]
        try:
            self._obey(program, command)
        except ScriptError as error:
            self.stop_program(f"runtime error: {error}")

    def _obey(self, program: Program, command: int) -> None:
        if command in REAL_TIME:
            self._execute(command)
            self._signal(READY)
        elif command == 0:
            program.executing = False
            self._signal(READY)
        elif not program.executing:
            program.executing = True
            if command == 255:
                self.stop_program("by the client")
                return
            program.blocking = self._execute(command)
            if not program.blocking:
                self._signal(DONE)

    def _finish_motion(self) -> None:
        program = self.program
        if program is None or self.plant.moving:
            return
        if program.blocking:
            program.blocking = False
            self._signal(DONE)
        if program.asynchronous:
            program.asynchronous = False
            self._report_operation(running=False)

    def _signal(self, value: int) -> None:
        if self.program is not None:
            self.output_ints[self.program.offset] = value

    def _report_operation(self, *, running: bool) -> None:
        """Write the asynchronous status: bit 15 running, 16-23 writes, 24-30 operation."""
        self._writes = (self._writes + 1) % 128
        if running:
            self._operation = (self._operation + 1) % 128
        if self.program is not None:
            value = running << 15 | self._writes << 16 | self._operation << 24
            self.output_ints[self.program.offset + 2] = value

    # -- commands -------------------------------------------------------------------------------------------

    def _execute(self, command: int) -> bool:
        """Carry out a command; return whether the script's main loop is busy until the arm is at rest."""
        if command in (1, 2, 3, 4):
            return self._move(command)
        if command in (33, 34):
            return self._stop(linear=command == 33)
        if command in (9, 10):
            self._speed_command("joints" if command == 9 else "tool")
            return False
        if command in (15, 16):
            self._speed = None
            self.plant.brake(max(self._double(0), 0.01))
            return True
        handler = self._handlers().get(command)
        if handler is None:
            raise ScriptError(f"the twin does not simulate command {command}")
        handler()
        return False

    def _handlers(self) -> dict[int, Callable[[], None]]:
        return {
            8: self._zero_force,
            17: self._set_payload,
            29: self._set_tcp,
            31: lambda: self.protective_stop("asked for by the program"),
            35: self._set_watchdog,
            36: lambda: self._answer_flag(self._safe(self._inverse(self._doubles(0, 6), self.plant.target))),
            37: lambda: self._answer_flag(self._safe(self._doubles(0, 6))),
            40: lambda: self._answer(kinematics.to_pose(self.tcp)),
            43: lambda: self._answer(self.tool_pose()),
            44: self._forward,
            46: lambda: self._answer(self._solution(self._doubles(0, 6), self.plant.target)),
            30: lambda: self._answer(self._solution(self._doubles(0, 6), self._doubles(6, 6))),
            47: lambda: self._answer_flag(self.steady),
            58: lambda: self._answer(kinematics.to_pose(self.plant.flange)),
            60: lambda: self._answer_flag(self._inverse(self._doubles(0, 6), self.plant.target) is not None),
            61: lambda: self._answer_flag(
                self._inverse(self._doubles(0, 6), self._doubles(6, 6)) is not None
            ),
        }

    def _move(self, command: int) -> bool:
        target, speed, acceleration = self._doubles(0, 6), self._double(6), self._double(7)
        if speed <= 0 or acceleration <= 0:
            raise ScriptError("speed and acceleration must be positive")
        joints = self._solution(target, self.plant.target) if command in (2, 3) else target
        speed *= self.speed_fraction
        if command in (1, 2):
            path: Floats | None = paths.joint_line(self.plant.target, joints, speed, acceleration, STEP)
        else:
            goal = self._flange(target) if command == 3 else kinematics.forward(joints)
            start = kinematics.forward(self.plant.target)
            path = paths.line(start, goal, self.plant.target, speed, acceleration, STEP)
        if path is None:
            raise ScriptError("the straight line leaves what the arm can reach")
        self._speed = None
        self.plant.follow(path)
        return self._begin(asynchronous=self._int(1) == 1)

    def _begin(self, *, asynchronous: bool) -> bool:
        assert self.program is not None
        if asynchronous:
            self.program.asynchronous = True
            self._report_operation(running=True)
        return not asynchronous

    def _stop(self, *, linear: bool) -> bool:
        deceleration = max(self._double(0), 0.01)
        assert self.program is not None
        if self.program.asynchronous:
            self.program.asynchronous = False
            self._report_operation(running=False)
        self._speed = None
        if linear:
            self.plant.brake(deceleration)
        else:
            self.plant.brake_joints(deceleration)
        return self._begin(asynchronous=self._int(1) == 1)

    def _speed_command(self, kind: str) -> None:
        wanted = self._doubles(0, 6)
        if self._speed is not None and self._speed[0] == kind and np.array_equal(self._speed[1], wanted):
            return
        self._speed = (kind, wanted)
        plan = self._joint_chunk if kind == "joints" else self._tool_chunk
        path = plan(self.plant.target)
        if path is None:
            raise ScriptError("the arm cannot move that way")
        self.plant.follow(path, plan)

    def _joint_chunk(self, start: Floats) -> Floats | None:
        if self._speed is None:
            return None
        ticks = np.arange(1, LOOKAHEAD + 1)[:, None] * STEP
        chunk: Floats = start + ticks * self._speed[1]
        return chunk

    def _tool_chunk(self, start: Floats) -> Floats | None:
        """Plan a second of constant tool velocity; None where the arm's reach ends."""
        if self._speed is None:
            return None
        flange = kinematics.forward(start)
        goal = flange.copy()
        goal[:3, 3] += self._speed[1][:3] * LOOKAHEAD * STEP
        fractions = np.arange(1, LOOKAHEAD + 1) / LOOKAHEAD
        return kinematics.follow(kinematics.interpolate(flange, goal, fractions), start)

    def _zero_force(self) -> None:
        self.force_offset = self.plant.tool_force().copy()

    def _set_payload(self) -> None:
        self.payload, self.payload_centre = self._double(0), list(self._doubles(1, 3))

    def _set_tcp(self) -> None:
        self.tcp = kinematics.to_transform(self._doubles(0, 6))

    def _set_watchdog(self) -> None:
        assert self.program is not None
        frequency = self._double(0)
        self.program.watchdog = 1 / frequency if frequency > 0 else 0.0

    def _forward(self) -> None:
        offset = kinematics.to_transform(self._doubles(6, 6))
        self._answer(kinematics.to_pose(kinematics.forward(self._doubles(0, 6)) @ offset))

    def _flange(self, pose: Floats) -> Floats:
        flange: Floats = kinematics.to_transform(pose) @ np.linalg.inv(self.tcp)
        return flange

    def _inverse(self, pose: Floats, near: Floats) -> Floats | None:
        return kinematics.nearest(self._flange(pose), near)

    def _solution(self, pose: Floats, near: Floats) -> Floats:
        joints = self._inverse(pose, near)
        if joints is None:
            raise ScriptError("get_inverse_kin: no solution")
        return joints

    def _safe(self, joints: Floats | None) -> bool:
        return joints is not None and kinematics.within_limits(joints)

    def _answer(self, values: Floats) -> None:
        assert self.program is not None
        start = self.program.offset
        self.output_doubles[start : start + 6] = [float(value) for value in values]

    def _answer_flag(self, value: bool) -> None:
        assert self.program is not None
        self.output_ints[self.program.offset + 1] = int(value)

    def _int(self, index: int) -> int:
        assert self.program is not None
        return self.input_ints[self.program.offset + index]

    def _double(self, index: int) -> float:
        assert self.program is not None
        return self.input_doubles[self.program.offset + index]

    def _doubles(self, index: int, count: int) -> Floats:
        assert self.program is not None
        start = self.program.offset + index
        return np.array(self.input_doubles[start : start + count])

    # -- safety ---------------------------------------------------------------------------------------------

    def _check_limits(self) -> None:
        if self.safety_mode != SAFETY_NORMAL:
            return
        if not kinematics.within_limits(self.plant.joints):
            self.protective_stop("joint limit")
        elif np.abs(self.plant.joint_speeds).max() > kinematics.JOINT_SPEED_LIMIT:
            self.protective_stop("joint speed limit")
        elif np.linalg.norm(self.plant.tool_force()) > self.plant.lab.twin.force_limit:
            self.protective_stop("force limit")

    def protective_stop(self, why: str) -> None:
        """Hold the arm; the program is paused (assumed)."""
        self.log.append(f"protective stop: {why}")
        self.safety_mode, self._locked_for, self._speed = SAFETY_PROTECTIVE, 0.0, None
        self.runtime = PAUSED if self.program is not None else STOPPED
        self.plant.halt()

    def emergency_stop(self) -> None:
        """Cut the power: brakes hold the arm, the program ends."""
        self.log.append("emergency stop")
        self.safety_mode, self.robot_mode = SAFETY_EMERGENCY, MODE_OFF
        self.program, self._speed, self.runtime = None, None, STOPPED
        self.plant.halt()

    def release(self) -> None:
        """Do what a person does after an emergency stop: unlock the button, power on, release the brakes."""
        self.safety_mode, self.robot_mode = SAFETY_NORMAL, MODE_RUNNING

    @property
    def steady(self) -> bool:
        """Whether the arm stands still."""
        return bool(np.abs(self.plant.joint_speeds).max() < STEADY)

    @property
    def safety_bits(self) -> int:
        """The safety_status_bits."""
        return {SAFETY_NORMAL: 1, SAFETY_PROTECTIVE: 1 << 2 | 1 << 10, SAFETY_EMERGENCY: 1 << 6 | 1 << 7}[
            self.safety_mode
        ]

    @property
    def robot_bits(self) -> int:
        """The robot_status_bits."""
        return int(self.robot_mode == MODE_RUNNING) | int(self.running) << 1

    # -- what is measured -----------------------------------------------------------------------------------

    def tool_pose(self) -> Floats:
        """Return the tool's measured pose (6,)."""
        return kinematics.to_pose(self.plant.flange @ self.tcp)

    def target_pose(self) -> Floats:
        """Return the tool's commanded pose (6,)."""
        return kinematics.to_pose(kinematics.forward(self.plant.target) @ self.tcp)

    def tool_wrench(self) -> Floats:
        """Return the external wrench (6,) at the tool; the twin senses no torque."""
        return np.concatenate([self.plant.tool_force() - self.force_offset, np.zeros(3)])

    # -- the dashboard --------------------------------------------------------------------------------------

    def answer(self, line: str) -> str:
        """Answer one line of the dashboard's protocol."""
        command = " ".join(line.split())
        plain = {
            "PolyscopeVersion": f"URSoftware {'.'.join(map(str, self.version))} (Jan 01 2024)",
            "get serial number": self.serial,
            "get robot model": self.plant.lab.arm.model,
            "is in remote control": str(self.remote).lower(),
            "robotmode": f"Robotmode: {'RUNNING' if self.robot_mode == MODE_RUNNING else 'POWER_OFF'}",
            "safetystatus": f"Safetystatus: {self._safety_name()}",
            "safetymode": f"Safetymode: {self._safety_name()}",
            "running": f"Program running: {str(self.running).lower()}",
            "programState": f"{'PLAYING' if self.running else 'STOPPED'} rtde_control",
            "quit": "Disconnected",
        }
        if command in plain:
            return plain[command]
        if not self.remote:
            return LOCAL
        if command == "stop":
            self.stop_program("by the dashboard")
            return "Stopped"
        if command == "unlock protective stop":
            return self._unlock()
        if command in ("close safety popup", "close popup"):
            return "closing safety popup" if "safety" in command else "closing popup"
        return f"could not understand: '{command[:60]}'"

    def _unlock(self) -> str:
        if self.safety_mode != SAFETY_PROTECTIVE:
            return "No protective stop to unlock"
        if self._locked_for < UNLOCK_AFTER:
            return TOO_EARLY
        self.safety_mode = SAFETY_NORMAL
        if not self.resumes_paused:
            self.program, self.runtime = None, STOPPED
        return "Protective stop releasing"

    def _safety_name(self) -> str:
        return {
            SAFETY_NORMAL: "NORMAL",
            SAFETY_PROTECTIVE: "PROTECTIVE_STOP",
            SAFETY_EMERGENCY: "ROBOT_EMERGENCY_STOP",
        }[self.safety_mode]
