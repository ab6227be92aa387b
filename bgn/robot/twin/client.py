"""Talking to a twin beside its robot protocols: place objects, inject faults, look at what really happened."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from types import TracebackType
from typing import Any, Final, Self

from bgn.robot.errors import RobotError
from bgn.robot.network import CONTROL_PORT

TIMEOUT: Final = 10.0  # s
LONGEST: Final = 1 << 16  # bytes of an answer


class TwinClient:
    """The control socket of a running twin."""

    def __init__(self, host: str) -> None:
        self._socket = socket.create_connection((host, CONTROL_PORT), timeout=TIMEOUT)
        self._file = self._socket.makefile("rb")

    def ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        """Make a request and return the twin's state after it.

        Raises
        ------
        RobotError
            The twin refused, or is gone.
        """
        try:
            self._socket.sendall(json.dumps({"do": do, **arguments}).encode() + b"\n")
            line = self._file.readline(LONGEST)
        except OSError as error:
            raise RobotError(f"the twin's control socket is gone: {error}") from error
        answer: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {"error": "it hung up"}
        if "error" in answer:
            raise RobotError(f"the twin: {answer['error']}")
        return answer

    def place(self, hidden: int | None) -> None:
        """Put the objects where a hidden part says, or take them away."""
        self.ask("place", hidden=hidden)

    def pushed(self) -> int:
        """Return which bump was pushed, as the physics has it."""
        return int(self.ask("state")["pushed"])

    def wait_for_rest(self, seconds: float = 5.0) -> dict[str, Any]:
        """Wait until the tool stands still and return the state then."""
        due = time.monotonic() + seconds
        while time.monotonic() < due:
            state = self.ask("state")
            if state["speed"] < 1e-3:
                return state
            time.sleep(0.05)
        raise RobotError("the twin's arm does not come to rest")

    def close(self) -> None:
        """Hang up."""
        self._file.close()
        self._socket.close()


class TwinProcess:
    """A twin in a process of its own, stopped at the end of a ``with`` block."""

    def __init__(self, task: str, host: str, *options: str) -> None:
        command = [sys.executable, "-m", "bgn.robot.twin", "--task", task, "--host", host, *options]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.startswith("twin of"):
            self._process.wait()
            raise RobotError(f"the twin did not start (exit code {self._process.returncode})")
        self.client = TwinClient(host)
        self.host = host

    @property
    def pid(self) -> int:
        """The process's id."""
        return self._process.pid

    def __enter__(self) -> Self:
        """Return the running twin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop it."""
        self.client.close()
        self._process.terminate()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()
