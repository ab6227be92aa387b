"""The real-time data exchange of a simulated controller: RTDE version 2, big-endian, bounded.

A message is uint16 size (its three header bytes included), uint8 type, payload. Every request gets exactly one
reply, and nothing else is sent before the client asked for data to start.
"""

from __future__ import annotations

import asyncio
import re
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from bgn.robot.twin.controller import REGISTERS, Controller

HEADER: Final = struct.Struct(">HB")
VERSION, CONTROLLER_VERSION, OUTPUTS, INPUTS = b"VvOI"
START, PAUSE, DATA = b"SPU"
LONGEST: Final = 4096  # bytes of a message
NAMES_LIMIT: Final = 2048  # bytes of a list of names
FORMATS: Final = {
    "DOUBLE": "d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "UINT8": "B", "BOOL": "?",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i",
}  # fmt: skip
BACKLOG: Final = 1 << 16  # unsent bytes after which data packages are dropped

Getter = Callable[[Controller], Any]
_NOTHING: Final = (0.0,) * 6

OUTPUT_VARIABLES: Final[dict[str, tuple[str, Getter]]] = {
    "timestamp": ("DOUBLE", lambda c: c.plant.time),
    "target_q": ("VECTOR6D", lambda c: c.plant.target),
    "target_qd": ("VECTOR6D", lambda c: c.plant.target_speeds),
    "actual_q": ("VECTOR6D", lambda c: c.plant.joints),
    "actual_qd": ("VECTOR6D", lambda c: c.plant.joint_speeds),
    "actual_TCP_pose": ("VECTOR6D", lambda c: c.tool_pose()),
    "actual_TCP_speed": ("VECTOR6D", lambda c: c.plant.tool_speed()),
    "actual_TCP_force": ("VECTOR6D", lambda c: c.tool_wrench()),
    "target_TCP_pose": ("VECTOR6D", lambda c: c.target_pose()),
    "robot_mode": ("INT32", lambda c: c.robot_mode),
    "joint_mode": ("VECTOR6INT32", lambda c: (253,) * 6),
    "safety_mode": ("INT32", lambda c: c.safety_mode),
    "speed_scaling": ("DOUBLE", lambda c: 1.0),
    "target_speed_fraction": ("DOUBLE", lambda c: c.speed_fraction),
    "runtime_state": ("UINT32", lambda c: c.runtime),
    "robot_status_bits": ("UINT32", lambda c: c.robot_bits),
    "safety_status_bits": ("UINT32", lambda c: c.safety_bits),
    "payload": ("DOUBLE", lambda c: c.payload),
    "payload_cog": ("VECTOR3D", lambda c: c.payload_centre),
    **{
        f"output_int_register_{i}": ("INT32", lambda c, i=i: c.output_ints[i])  # type: ignore[misc]
        for i in range(REGISTERS)
    },
    **{
        f"output_double_register_{i}": ("DOUBLE", lambda c, i=i: c.output_doubles[i])  # type: ignore[misc]
        for i in range(REGISTERS)
    },
    # What the twin does not simulate is answered with zeros.
    **{name: ("VECTOR6D", lambda c: _NOTHING) for name in (
        "target_qdd", "target_current", "target_moment", "actual_current", "joint_control_output",
        "target_TCP_speed", "joint_temperatures", "actual_joint_voltage", "ft_raw_wrench", "payload_inertia",
        "actual_current_as_torque",
    )},
    **{name: ("DOUBLE", lambda c: 0.0) for name in (
        "actual_execution_time", "actual_momentum", "actual_main_voltage", "actual_robot_voltage",
        "actual_robot_current", "standard_analog_input0", "standard_analog_input1", "standard_analog_output0",
        "standard_analog_output1",
    )},
    **{name: ("UINT64", lambda c: 0) for name in ("actual_digital_input_bits", "actual_digital_output_bits")},
    "actual_tool_accelerometer": ("VECTOR3D", lambda c: _NOTHING[:3]),
}  # fmt: skip

INPUT_VARIABLES: Final[dict[str, str]] = {
    **{f"input_int_register_{i}": "INT32" for i in range(REGISTERS)},
    **{f"input_double_register_{i}": "DOUBLE" for i in range(REGISTERS)},
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "external_force_torque": "VECTOR6D",
}
_REGISTER: Final = re.compile(r"input_(int|double)_register_(\d+)")


class ProtocolError(ValueError):
    """A message that is not RTDE, or not what may be sent now."""


@dataclass(frozen=True)
class InputRecipe:
    """How one kind of input package is unpacked."""

    packing: struct.Struct
    names: tuple[str, ...]


@dataclass(frozen=True)
class OutputRecipe:
    """How output packages are packed, and how often."""

    packing: struct.Struct
    getters: tuple[tuple[str, Getter], ...]
    period: float
    """Simulated seconds."""


class Session:
    """One client's exchange, without its socket: takes bytes in, gives bytes out."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._received = bytearray()
        self._inputs: list[InputRecipe] = []
        self._output: OutputRecipe | None = None
        self._due = 0.0
        self.started = False

    def feed(self, data: bytes) -> bytes:
        """Take bytes in and return the replies.

        Raises
        ------
        ProtocolError
            A message is malformed, too long, unknown or refers to no recipe.
        """
        self._received += data
        replies = bytearray()
        while len(self._received) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._received)
            if not HEADER.size <= size <= LONGEST:
                raise ProtocolError(f"a message of {size} bytes")
            if len(self._received) < size:
                break
            payload = bytes(self._received[HEADER.size : size])
            del self._received[:size]
            replies += self._reply(kind, payload)
        return bytes(replies)

    def package(self) -> bytes | None:
        """Return a data package if one is due now."""
        now = self._controller.plant.time
        if not self.started or self._output is None or now < self._due:
            return None
        self._due = max(self._due + self._output.period, now)
        return self._pack(self._output)

    def close(self) -> None:
        """Give back what this client owned; its last values stay."""
        owners = self._controller.owners
        for name in [name for name, owner in owners.items() if owner is self]:
            del owners[name]

    def _pack(self, recipe: OutputRecipe) -> bytes:
        values: list[Any] = [1]
        for kind, get in recipe.getters:
            value = get(self._controller)
            values.extend(value) if kind.startswith("VECTOR") else values.append(value)
        return _message(DATA, recipe.packing.pack(*values))

    def _reply(self, kind: int, payload: bytes) -> bytes:
        if kind == VERSION:
            return _message(kind, bytes([payload == b"\x00\x02"]))
        if kind == CONTROLLER_VERSION:
            return _message(kind, struct.pack(">4I", *self._controller.version))
        if kind == OUTPUTS:
            return _message(kind, self._set_up_outputs(payload))
        if kind == INPUTS:
            return _message(kind, self._set_up_inputs(payload))
        if kind == START:
            self.started = self._output is not None
            self._due = self._controller.plant.time
            return _message(kind, bytes([self.started]))
        if kind == PAUSE:
            self.started = False
            return _message(kind, b"\x01")
        if kind == DATA:
            self._take(payload)
            return b""
        raise ProtocolError(f"a message of type {kind}")

    def _set_up_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise ProtocolError("an output recipe without a frequency")
        (frequency,) = struct.unpack_from(">d", payload)
        if not 1 <= frequency <= 500:
            raise ProtocolError(f"an output frequency of {frequency} Hz")
        names = _names(payload[8:])
        kinds = [OUTPUT_VARIABLES[name][0] if name in OUTPUT_VARIABLES else "NOT_FOUND" for name in names]
        if "NOT_FOUND" not in kinds:
            packing = struct.Struct(">B" + "".join(FORMATS[kind] for kind in kinds))
            getters = tuple(OUTPUT_VARIABLES[name] for name in names)
            self._output = OutputRecipe(packing, getters, 1 / frequency)
        return b"\x01" + ",".join(kinds).encode()

    def _set_up_inputs(self, payload: bytes) -> bytes:
        names = _names(payload)
        kinds = [self._input_kind(name) for name in names]
        if any(kind in ("NOT_FOUND", "IN_USE") for kind in kinds) or len(self._inputs) == 255:
            return b"\x00" + ",".join(kinds).encode()
        for name in names:
            self._controller.owners[name] = self
        packing = struct.Struct(">" + "".join(FORMATS[kind] for kind in kinds))
        self._inputs.append(InputRecipe(packing, names))
        return bytes([len(self._inputs)]) + ",".join(kinds).encode()

    def _input_kind(self, name: str) -> str:
        if name not in INPUT_VARIABLES:
            return "NOT_FOUND"
        owner = self._controller.owners.get(name)
        return "IN_USE" if owner not in (None, self) or self._controller.fieldbus else INPUT_VARIABLES[name]

    def _take(self, payload: bytes) -> None:
        if not payload or not 1 <= payload[0] <= len(self._inputs):
            raise ProtocolError("data for no recipe")
        recipe = self._inputs[payload[0] - 1]
        # The client leaves out trailing fields a command does not need.
        if len(payload) - 1 > recipe.packing.size:
            raise ProtocolError(f"{len(payload) - 1} bytes for a recipe of {recipe.packing.size}")
        offset = 1
        for name in recipe.names:
            field = struct.Struct(">" + FORMATS[INPUT_VARIABLES[name]])
            if offset + field.size > len(payload):
                break
            values = field.unpack_from(payload, offset)
            offset += field.size
            self._store(name, values)

    def _store(self, name: str, values: tuple[Any, ...]) -> None:
        controller = self._controller
        found = _REGISTER.fullmatch(name)
        if found is None:
            if name == "speed_slider_fraction":
                controller.speed_fraction = min(max(float(values[0]), 0.0), 1.0)
            return
        index = int(found[2])
        if found[1] == "double":
            controller.input_doubles[index] = float(values[0])
            return
        controller.input_ints[index] = int(values[0])
        if index in (0, 24):
            controller.heard()


class Connection(asyncio.Protocol):
    """One client's socket."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self.session = Session(server.controller)
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a new client in."""
        assert isinstance(transport, asyncio.Transport)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transport = transport
        self._server.connections.add(self)
        if self._server.frozen:
            transport.pause_reading()

    def data_received(self, data: bytes) -> None:
        """Answer, or hang up on what is not RTDE."""
        assert self.transport is not None
        try:
            replies = self.session.feed(data)
        except (ProtocolError, struct.error, UnicodeDecodeError) as error:
            self._server.controller.log.append(f"RTDE client dropped: {error}")
            self.transport.abort()
            return
        if replies:
            self.transport.write(replies)

    def connection_lost(self, error: Exception | None) -> None:
        """Forget the client."""
        self.session.close()
        self._server.connections.discard(self)

    def send(self) -> None:
        """Send a data package if one is due; a client that does not read misses packages."""
        package = self.session.package()
        if (
            package is not None
            and self.transport is not None
            and self.transport.get_write_buffer_size() < BACKLOG
        ):
            self.transport.write(package)


class Server:
    """All RTDE clients of a controller."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.connections: set[Connection] = set()
        self.muted = self.frozen = False

    def connection(self) -> Connection:
        """Return the protocol of a new client."""
        return Connection(self)

    def send(self) -> None:
        """Send what is due."""
        if self.muted or self.frozen:
            return
        for connection in list(self.connections):
            connection.send()


def _names(payload: bytes) -> tuple[str, ...]:
    if len(payload) > NAMES_LIMIT:
        raise ProtocolError(f"{len(payload)} bytes of names, at most {NAMES_LIMIT}")
    return tuple(name for name in payload.decode("ascii").split(",") if name)


def _message(kind: int, payload: bytes) -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload
