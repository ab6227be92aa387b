"""Driver of the RDDA gripper: comma-separated text in UDP datagrams, replies broadcast, no sequence numbers.

A late or doubled reply cannot be told from the right one by its content alone, so whatever has arrived is thrown
away before each request, only the grammar that fits the request is accepted, only from the gripper's own address,
and only commands that may be repeated are.
"""

from __future__ import annotations

import contextlib
import re
import socket
import time
from collections.abc import Callable, Sequence
from typing import Final

from bgn.robot.errors import GripperError
from bgn.robot.lab import Gripper as Settings
from bgn.robot.network import is_loopback

LONGEST_REQUEST: Final = 128  # bytes
LONGEST_REPLY: Final = 64  # bytes
_NUMBER: Final = r"-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?"
_PAIR: Final = re.compile(rf"\(\s*({_NUMBER})\s*,\s*({_NUMBER})\s*\)")
_LIST: Final = re.compile(rf"\[\s*({_NUMBER})\s*,\s*({_NUMBER})\s*\]")
_FLAG: Final = re.compile(r"[01]")
POLL_AGAIN: Final = 0.1  # s after which a background reading is asked for again
WIDEST: Final = 10.0  # rad; no finger turns further

Pair = tuple[float, float]


class RddaGripper:
    """The gripper at one address.

    ``heard`` is called with every pair of angles that was read, ``told`` with every command, for the recording.

    Raises
    ------
    GripperError
        The reply port is taken.
    """

    def __init__(
        self,
        host: str,
        settings: Settings,
        heard: Callable[[Pair], None] = lambda angles: None,
        told: Callable[[str, str], None] = lambda kind, text: None,
    ) -> None:
        self._settings, self._peer, self.heard, self._told = settings, (host, settings.port), heard, told
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            # A broadcast comes to every address; on this machine it comes to the twin's own.
            self._socket.bind((host if is_loopback(host) else "", settings.reply_port))
        except OSError as error:
            self._socket.close()
            raise GripperError(
                f"cannot listen for the gripper at port {settings.reply_port}: {error}"
            ) from error
        self._asked = 0.0

    def set_stiffness(self, stiffness: Sequence[float]) -> None:
        """Set both fingers' stiffness, N m/rad."""
        self._command("set_rdda_stiffness", stiffness)

    def set_positions(self, angles: Sequence[float]) -> None:
        """Set both fingers' set-points, rad."""
        self._command("set_rdda_positions", angles)

    def set_max_velocities(self, speeds: Sequence[float]) -> None:
        """Limit how fast both set-points move, rad/s."""
        self._command("set_rdda_max_velocities", speeds)

    def home(self) -> None:
        """Home both fingers. They move; it is not repeated when no reply comes."""
        self._told("gripper", "home_rdda")
        self._ask("home_rdda", _FLAG, retries=0)

    def read_positions(self) -> Pair:
        """Return both fingers' angles, rad."""
        angles = _pair(self._ask("read_rdda_positions", _PAIR))
        self.heard(angles)
        return angles

    def read_origins(self) -> Pair:
        """Return where both fingers were homed, rad."""
        return _pair(self._ask("read_rdda_origins", _LIST))

    def read_bounds(self) -> tuple[Pair, Pair]:
        """Return the lower and the upper bounds of both fingers, rad."""
        lower = self._ask("read_rdda_lower_bounds", _LIST)
        return _pair(lower), _pair(self._ask("read_rdda_upper_bounds", _LIST))

    def poll(self) -> None:
        """Take a reading in without waiting: for the recording, while the arm moves. Never raises.

        What is wrong with the gripper is said by the next command that needs an answer.
        """
        now = time.monotonic()
        while (reply := self._receive(0.0)) is not None:
            found = _PAIR.fullmatch(reply)
            if found is not None and self._asked:
                self._asked = 0.0
                with contextlib.suppress(GripperError):
                    self.heard(_pair(found))
        if now - self._asked > POLL_AGAIN:
            self._asked = now
            with contextlib.suppress(GripperError):
                self._send("read_rdda_positions")

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _command(self, name: str, pair: Sequence[float]) -> None:
        first, second = pair
        request = f"{name},{first:.6g},{second:.6g}"
        self._told("gripper", request)
        if self._ask(request, _FLAG)[0] != "1":
            raise GripperError(f"the gripper refuses {name} {first:g}, {second:g}")

    def _ask(self, request: str, grammar: re.Pattern[str], retries: int | None = None) -> re.Match[str]:
        """Send a request until a reply of its grammar comes."""
        self._asked = 0.0
        heard = "nothing"
        for _ in range(1 + (self._settings.retries if retries is None else retries)):
            self._drain()
            self._send(request)
            due = time.monotonic() + self._settings.timeout
            while (left := due - time.monotonic()) > 0:
                reply = self._receive(left)
                if reply is None:
                    break
                found = grammar.fullmatch(reply)
                if found is not None:
                    return found
                heard = repr(reply[:40])
        raise GripperError(
            f"the gripper at {self._peer[0]} does not answer {request.split(',')[0]}: heard {heard}"
        )

    def _drain(self) -> None:
        while self._receive(0.0) is not None:
            pass

    def _send(self, request: str) -> None:
        data = request.encode("ascii")
        assert len(data) <= LONGEST_REQUEST
        try:
            self._socket.sendto(data, self._peer)
        except OSError as error:
            raise GripperError(f"cannot send to the gripper at {self._peer[0]}: {error}") from error

    def _receive(self, seconds: float) -> str | None:
        """Return the next datagram of the gripper within so many seconds; others are dropped."""
        due = time.monotonic() + seconds
        while True:
            self._socket.settimeout(max(0.0, due - time.monotonic()) if seconds else 0.0)
            try:
                data, source = self._socket.recvfrom(LONGEST_REPLY + 1)
            except (TimeoutError, BlockingIOError):
                return None
            except OSError as error:  # such as an unreachable port, reported for an earlier datagram
                if seconds and time.monotonic() < due:
                    continue
                if not seconds:
                    return None
                raise GripperError(f"the gripper at {self._peer[0]} is gone: {error}") from error
            if source[0] == self._peer[0] and len(data) <= LONGEST_REPLY:
                return data.decode("ascii", errors="replace").strip()
            if time.monotonic() >= due:
                return None


def _pair(found: re.Match[str]) -> Pair:
    first, second = float(found[1]), float(found[2])
    if max(abs(first), abs(second)) > WIDEST:
        raise GripperError(f"the gripper reports an angle of {max(abs(first), abs(second)):g} rad")
    return first, second
