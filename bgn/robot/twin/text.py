"""The twin's two text servers: script upload and dashboard."""

from __future__ import annotations

import asyncio
from typing import Final

from bgn.robot.twin.controller import Controller

GREETING: Final = b"Connected: Universal Robots Dashboard Server\n"
SCRIPT_LIMIT: Final = 1 << 18  # bytes
LINE_LIMIT: Final = 256  # bytes


class TextServer:
    """What the text connections share: whether they answer at all."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.transports: set[asyncio.Transport] = set()
        self.frozen = False

    def script(self) -> ScriptConnection:
        """Return the protocol of a client of the script port."""
        return ScriptConnection(self)

    def dashboard(self) -> DashboardConnection:
        """Return the protocol of a client of the dashboard port."""
        return DashboardConnection(self)


class _Connection(asyncio.Protocol):
    def __init__(self, server: TextServer) -> None:
        self._server = server
        self._received = bytearray()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a new client in."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._server.transports.add(transport)
        if self._server.frozen:
            transport.pause_reading()

    def connection_lost(self, error: Exception | None) -> None:
        """Forget the client."""
        if self._transport is not None:
            self._server.transports.discard(self._transport)

    def _hang_up(self) -> None:
        if self._transport is not None:
            self._transport.abort()


class ScriptConnection(_Connection):
    """Collects a script until its ``end`` at column 0."""

    def data_received(self, data: bytes) -> None:
        """Take more of a script in."""
        self._received += data
        if len(self._received) > SCRIPT_LIMIT:
            self._hang_up()
            return
        head, end, rest = self._received.partition(b"\nend\n")
        if end:
            self._received = bytearray(rest)
            self._server.controller.upload(head.decode("utf-8", errors="replace"))


class DashboardConnection(_Connection):
    """Answers line by line."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet a new client."""
        super().connection_made(transport)
        if self._transport is not None and not self._server.frozen:
            self._transport.write(GREETING)

    def data_received(self, data: bytes) -> None:
        """Answer what is complete."""
        self._received += data
        while b"\n" in self._received:
            line, _, rest = self._received.partition(b"\n")
            self._received = bytearray(rest)
            answer = self._server.controller.answer(line[:LINE_LIMIT].decode("ascii", errors="replace"))
            if self._transport is not None:
                self._transport.write(answer.encode() + b"\n")
        if len(self._received) > LINE_LIMIT:
            self._hang_up()
