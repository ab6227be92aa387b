"""What can go wrong with a robot: one exception per kind, each with the exit code that says so."""

from __future__ import annotations

from typing import ClassVar

from bgn.errors import BgnError


class RobotError(BgnError):
    """Base of everything that ends or interrupts an evaluation; the message says what happened and what to do."""

    exit_code: ClassVar[int] = 20
    #: Marks the episode it interrupts in the recordings.
    outcome: ClassVar[str] = "fault"


class UsageError(RobotError):
    """The command line or the configuration asks for something that is not allowed."""

    exit_code = 2


class MissingExtraError(RobotError):
    """``ur_rtde`` is not installed."""

    exit_code = 3


class PreflightError(RobotError):
    """The robot, its settings or the plan are not what an evaluation needs; nothing has moved."""

    exit_code = 10


class RefusedError(RobotError):
    """The operator did not confirm, or gave an answer that is none of those offered, too often or too late."""

    exit_code = 11
    outcome = "aborted"


class AbortedError(RobotError):
    """The operator pressed Ctrl-C or said stop."""

    exit_code = 12
    outcome = "aborted"


class ConnectionLostError(RobotError):
    """The robot, its data or the worker process that talks to it went away."""

    exit_code = 13
    outcome = "lost"


class ProtectiveStopError(RobotError):
    """The controller made a protective stop."""

    exit_code = 14
    outcome = "protective-stop"


class EmergencyStopError(RobotError):
    """Somebody pressed an emergency stop, or the controller reports a violation or fault."""

    exit_code = 15
    outcome = "emergency-stop"


class MotionError(RobotError):
    """A move was refused, missed its target, took too long or met too much force."""

    exit_code = 16
    outcome = "motion-fault"


class GripperError(RobotError):
    """The gripper does not answer, or answers what its protocol does not allow."""

    exit_code = 17
    outcome = "gripper-fault"


class BaselineError(GripperError):
    """The finger does not come to rest where it should."""


class ProgramStoppedError(RobotError):
    """The program on the controller ended although nobody here asked for it."""

    exit_code = 18
    outcome = "program-stopped"
