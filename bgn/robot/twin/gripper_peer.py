"""The simulated gripper: text datagrams in, text datagrams back, no sequence numbers."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Final, cast

from bgn.robot.twin.plant import Plant

LONGEST: Final = 128  # bytes of a command
PAIRED: Final = (
    "set_rdda_stiffness",
    "set_rdda_positions",
    "set_rdda_max_velocities",
    "set_rdda_max_efforts",
)
BARE: Final = (
    "init_rdda_stiffness", "home_rdda", "read_rdda_positions", "read_rdda_lower_bounds", "read_rdda_upper_bounds",
    "read_rdda_origins",
)  # fmt: skip
INITIAL_STIFFNESS: Final = (0.1, 0.1)  # N m / rad
BOUND: Final = 1.2  # rad


class GripperModel:
    """Both fingers of the gripper; the ones the task reads are the plant's hinges."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._hinges = plant.station.fingers
        self._pairs = {name: [0.0, 0.0] for name in PAIRED}

    def answer(self, text: str) -> str:
        """Return the reply to one command; "0" refuses it."""
        name, *arguments = text.strip().split(",")
        if name in PAIRED:
            pair = _pair(arguments)
            return "0" if pair is None or not self._set(name, pair) else "1"
        if name not in BARE or arguments:
            return "None"
        if name == "init_rdda_stiffness":
            return "1" if self._set("set_rdda_stiffness", list(INITIAL_STIFFNESS)) else "0"
        if name == "home_rdda":
            self._set("set_rdda_positions", [0.0, 0.0])
            return "1"
        if name == "read_rdda_positions":
            return "({}, {})".format(*self._positions())
        if name == "read_rdda_origins":
            return "[0.0, 0.0]"
        return str([BOUND, BOUND] if name == "read_rdda_upper_bounds" else [-BOUND, -BOUND])

    def _set(self, name: str, pair: list[float]) -> bool:
        mine = [pair[finger] for finger in self._hinges]
        if name == "set_rdda_positions":
            if max(abs(angle) for angle in pair) > BOUND:
                return False
            self._plant.set_goals(mine)
        elif min(pair) < 0:
            return False
        elif name == "set_rdda_stiffness":
            self._plant.set_stiffness(mine)
        elif name == "set_rdda_max_velocities":
            self._plant.set_slew(mine)
        self._pairs[name] = pair
        return True

    def _positions(self) -> list[float]:
        positions = list(self._pairs["set_rdda_positions"])
        for finger, angle in zip(self._hinges, self._plant.angles(), strict=True):
            positions[finger] = round(float(angle), 6)
        return positions


class GripperPeer(asyncio.DatagramProtocol):
    """The gripper's socket, with what can go wrong on the way back."""

    def __init__(self, model: GripperModel, reply_to: tuple[str, int]) -> None:
        self._model, self._reply_to = model, reply_to
        self.lose = self.garble = self.duplicate = 0
        """How many of the next replies are lost, garbled, sent twice."""
        self.late = 0.0
        """Seconds by which replies come late."""
        self.dead = self.frozen = False
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Remember the socket."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, source: tuple[str | None, int]) -> None:
        """Answer one command."""
        if self.dead or self.frozen or len(data) > LONGEST:
            return
        try:
            reply = self._model.answer(data.decode("ascii"))
        except UnicodeDecodeError:
            return
        if self.lose:
            self.lose -= 1
            return
        if self.garble:
            self.garble -= 1
            reply = reply[: len(reply) // 2] + "#"
        copies = 1 + bool(self.duplicate)
        self.duplicate -= bool(self.duplicate)
        for _ in range(copies):
            self._deliver(reply.encode())

    def _deliver(self, reply: bytes) -> None:
        assert self._transport is not None
        send: Callable[..., None] = self._transport.sendto
        if self.late:
            asyncio.get_running_loop().call_later(self.late, send, reply, self._reply_to)
        else:
            send(reply, self._reply_to)


def _pair(arguments: list[str]) -> list[float] | None:
    try:
        values = [float(argument) for argument in arguments]
    except ValueError:
        return None
    return values if len(values) == 2 and all(math.isfinite(value) for value in values) else None
