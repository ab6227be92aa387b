"""A client of the dashboard that can never hang: plain lines, short timeouts, bounded answers."""

from __future__ import annotations

import re
import socket
from typing import Final

from bgn.robot.errors import ConnectionLostError, PreflightError
from bgn.robot.network import DASHBOARD_PORT

LONGEST: Final = 1024  # bytes of an answer
TIMEOUT: Final = 2.0  # s of an ordinary question
URGENT: Final = 1.0  # s, all in all, to stop a program


class Dashboard:
    """One connection to a controller's dashboard.

    Raises
    ------
    ConnectionLostError
        Nobody answers there.
    """

    def __init__(self, host: str, timeout: float = TIMEOUT) -> None:
        self.host = host
        try:
            self._socket = socket.create_connection((host, DASHBOARD_PORT), timeout=timeout)
        except OSError as error:
            raise ConnectionLostError(f"{host}: no dashboard at port {DASHBOARD_PORT} ({error})") from error
        self._received = b""
        try:
            greeting = self._line()
            if not greeting.startswith("Connected"):
                raise PreflightError(f"{host}: at port {DASHBOARD_PORT} is no dashboard: {greeting[:60]!r}")
        except (ConnectionLostError, PreflightError):
            self._socket.close()
            raise

    def ask(self, command: str, timeout: float = TIMEOUT) -> str:
        """Send a line and return the answer's line.

        Raises
        ------
        ConnectionLostError
            No answer in time, or one that never ends.
        """
        try:
            self._socket.settimeout(timeout)
            self._socket.sendall(command.encode("ascii") + b"\n")
        except OSError as error:
            raise ConnectionLostError(f"{self.host}: the dashboard is gone ({error})") from error
        return self._line()

    def version(self) -> tuple[int, ...]:
        """Return PolyScope's version, four numbers.

        Raises
        ------
        PreflightError
            The answer names none.
        """
        answer = self.ask("PolyscopeVersion")
        found = re.search(r"(\d+)\.(\d+)\.(\d+)\.(\d+)", answer)
        if found is None:
            raise PreflightError(f"{self.host}: no version in the dashboard's answer {answer[:60]!r}")
        return tuple(int(part) for part in found.groups())

    def close(self) -> None:
        """Hang up."""
        self._socket.close()

    def _line(self) -> str:
        while b"\n" not in self._received:
            if len(self._received) > LONGEST:
                raise ConnectionLostError(f"{self.host}: an endless answer from the dashboard")
            try:
                data = self._socket.recv(LONGEST)
            except OSError as error:
                raise ConnectionLostError(f"{self.host}: no answer from the dashboard ({error})") from error
            if not data:
                raise ConnectionLostError(f"{self.host}: the dashboard closed the connection")
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return line.decode("ascii", errors="replace").strip()


def stop_program(host: str) -> str:
    """Ask a fresh dashboard connection to stop the program; return its answer, or what went wrong. Takes a second."""
    try:
        dashboard = Dashboard(host, timeout=URGENT / 2)
        try:
            return dashboard.ask("stop", timeout=URGENT / 2)
        finally:
            dashboard.close()
    except (ConnectionLostError, PreflightError) as error:
        return str(error)
