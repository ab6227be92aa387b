"""The twin's process: one event loop that lets simulated time pass and serves every port on one loopback address."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from bgn.robot.errors import RobotError, UsageError
from bgn.robot.lab import Lab
from bgn.robot.network import CONTROL_PORT, DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT, check_twin_host
from bgn.robot.twin import faults, rtde, text
from bgn.robot.twin.controller import Controller
from bgn.robot.twin.faults import Fault
from bgn.robot.twin.gripper_peer import GripperModel, GripperPeer
from bgn.robot.twin.plant import STEP, Plant

TICK: Final = 0.002  # s of wall time
LONGEST_TICK: Final = 0.02  # s of wall time simulated at most at once: a starved twin runs slower
CONTROL_LINE: Final = 4096  # bytes
LINGER_RESET: Final = struct.pack("ii", 1, 0)


@dataclass
class _Armed:
    """A fault that waits for its motion."""

    fault: Fault
    motion: int
    since: float | None = None


class Twin:
    """A simulated controller, gripper and laboratory bench at one loopback address.

    Raises
    ------
    UsageError
        The address is not a loopback one.
    """

    def __init__(self, lab: Lab, task: str, host: str, *, scale: float = 1.0, seed: int = 0) -> None:
        self.lab, self.host, self.scale, self._seed = lab, check_twin_host(host), scale, seed
        self._observer: Callable[[Plant], None] | None = None
        self._build(task)
        self._servers: list[asyncio.Server] = []
        self._armed: list[_Armed] = []
        self._frozen_until = 0.0
        self._mark: Any = None
        self.travel = 0.0
        """Largest distance of the tool from where it was when the last fault began, metres."""
        self._stopped = asyncio.Event()
        self._controls: set[asyncio.StreamWriter] = set()

    def _build(self, task: str) -> None:
        self.plant = Plant(self.lab, task, self._seed)
        self.controller = Controller(self.plant)
        self.rtde = rtde.Server(self.controller)
        self.text = text.TextServer(self.controller)
        self.gripper = GripperPeer(GripperModel(self.plant), (self.host, self.lab.gripper.reply_port))

    async def run(self, ready: Callable[[], None] | None = None) -> None:
        """Serve until told to stop.

        Raises
        ------
        UsageError
            A port of the address is taken.
        """
        loop = asyncio.get_running_loop()
        try:
            await self._listen()
            transport, _ = await loop.create_datagram_endpoint(
                lambda: self.gripper, local_addr=(self.host, self.lab.gripper.port)
            )
            control = await asyncio.start_server(self._control, self.host, CONTROL_PORT, limit=CONTROL_LINE)
        except OSError as error:
            raise UsageError(
                f"{self.host}: cannot listen ({error.strerror}); is another twin there?"
            ) from error
        if ready is not None:
            ready()
        try:
            await self._pass_time()
        finally:
            transport.close()
            for server in [*self._servers, control]:
                server.close()
            for writer in list(self._controls):
                writer.close()
            await asyncio.sleep(TICK)  # lets the control socket's readers see their end

    def show(self) -> None:
        """Show the arm in a window.

        Raises
        ------
        UsageError
            There is no screen.
        """
        from bgn.robot.twin.window import Window

        self._observer = Window().show

    def stop(self) -> None:
        """End :meth:`run`."""
        self._stopped.set()

    async def _listen(self) -> None:
        loop = asyncio.get_running_loop()
        ports = {
            RTDE_PORT: lambda: self.rtde.connection(),
            SCRIPT_PORT: lambda: self.text.script(),
            DASHBOARD_PORT: lambda: self.text.dashboard(),
        }
        for port, protocol in ports.items():
            self._servers.append(await loop.create_server(protocol, self.host, port))

    async def _pass_time(self) -> None:
        owed, last, due = 0.0, time.monotonic(), time.monotonic()
        while not self._stopped.is_set():
            due = max(due + TICK, time.monotonic() - TICK)
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            now = time.monotonic()
            passed, last = now - last, now
            wall = min(passed, LONGEST_TICK)
            owed += wall * self.scale
            steps = int(owed / STEP)
            owed -= steps * STEP
            if self._frozen_until and now > self._frozen_until:
                self._thaw()
            self._strike()
            self.controller.advance(steps, passed, listening=wall)
            self._measure()
            self.rtde.send()
            if self._observer is not None:
                self._observer(self.plant)

    # -- faults ---------------------------------------------------------------------------------------------

    def arm(self, fault: Fault) -> None:
        """Let a fault happen now, or at its motion."""
        if fault.motion == 0:
            self._begin(fault)
        else:
            self._armed.append(_Armed(fault, self.plant.motions + fault.motion))

    def _strike(self) -> None:
        for armed in list(self._armed):
            if self.plant.motions < armed.motion:
                continue
            if armed.since is None:
                armed.since = self.plant.time
            if self.plant.time - armed.since >= armed.fault.delay:
                self._armed.remove(armed)
                self._begin(armed.fault)

    def _begin(self, fault: Fault) -> None:
        self._mark, self.travel = self.controller.tool_pose()[:3], 0.0
        self.controller.log.append(f"fault: {fault.name}")
        peer, plant, controller = self.gripper, self.plant, self.controller
        effects: dict[str, Callable[[], None]] = {
            "close": lambda: self._drop(reset=False),
            "reset": lambda: self._drop(reset=True),
            "mute": lambda: setattr(self.rtde, "muted", True),
            "freeze": lambda: self._freeze(fault.value),
            "refuse": self._refuse,
            "protective-stop": lambda: controller.protective_stop("injected"),
            "emergency-stop": controller.emergency_stop,
            "stop-program": lambda: controller.stop_program("at the pendant"),
            "wall": lambda: plant.block(fault.value),
            "short": lambda: plant.cut(fault.value),
            "local": lambda: setattr(controller, "remote", False),
            "fieldbus": lambda: setattr(controller, "fieldbus", True),
            "gripper-lost": lambda: setattr(peer, "lose", int(fault.value)),
            "gripper-garbled": lambda: setattr(peer, "garble", int(fault.value)),
            "gripper-duplicate": lambda: setattr(peer, "duplicate", int(fault.value)),
            "gripper-late": lambda: setattr(peer, "late", fault.value),
            "gripper-dead": lambda: setattr(peer, "dead", True),
            "drift": lambda: setattr(plant, "drift", fault.value),
            "noise": lambda: setattr(plant, "noise", fault.value),
        }
        effects[fault.name]()

    def _drop(self, *, reset: bool) -> None:
        for connection in list(self.rtde.connections):
            assert connection.transport is not None
            if reset:
                _reset(connection.transport)
            else:
                connection.transport.close()

    def _refuse(self) -> None:
        for server in self._servers:
            server.close()
        self._servers.clear()
        self._drop(reset=True)
        for transport in list(self.text.transports):
            _reset(transport)

    def _freeze(self, seconds: float) -> None:
        self._frozen_until = time.monotonic() + seconds
        self.rtde.frozen = self.text.frozen = self.gripper.frozen = True
        for transport in self._transports():
            transport.pause_reading()

    def _thaw(self) -> None:
        self._frozen_until = 0.0
        self.rtde.frozen = self.text.frozen = self.gripper.frozen = False
        for transport in self._transports():
            transport.resume_reading()

    def _transports(self) -> list[asyncio.Transport]:
        mine = [
            connection.transport for connection in self.rtde.connections if connection.transport is not None
        ]
        return [*mine, *self.text.transports]

    async def heal(self) -> None:
        """End every fault, as if a person had put everything right; a protective stop stays until it is unlocked."""
        self._armed.clear()
        if self._frozen_until:
            self._thaw()
        self.rtde.muted = self.controller.fieldbus = False
        self.controller.remote = True
        if self.controller.safety_mode == 7:
            self.controller.release()
        self.plant.unblock()
        self.plant.drift, self.plant.noise = self.lab.twin.angle_drift, self.lab.twin.angle_noise
        peer = self.gripper
        peer.lose = peer.garble = peer.duplicate = 0
        peer.late, peer.dead = 0.0, False
        if not self._servers:
            await self._listen()

    def _measure(self) -> None:
        if self._mark is not None and self.plant.moving:
            away = self.controller.tool_pose()[:3] - self._mark
            self.travel = max(self.travel, float(np.linalg.norm(away)))

    # -- the control socket ---------------------------------------------------------------------------------

    async def _control(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._controls.add(writer)
        with contextlib.suppress(ConnectionError, asyncio.LimitOverrunError, ValueError):
            while line := await reader.readline():
                try:
                    answer = await self._do(json.loads(line))
                except (RobotError, KeyError, TypeError, ValueError) as error:
                    answer = {"error": str(error) or type(error).__name__}
                writer.write(json.dumps(answer).encode() + b"\n")
                await writer.drain()
        writer.close()
        self._controls.discard(writer)

    async def _do(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out one request of the control socket; every answer is the state after it."""
        do = request["do"]
        if do == "place":
            hidden = request["hidden"]
            if hidden is not None and not 0 <= int(hidden) < self.plant.objects.count():
                raise UsageError(f"hidden part {hidden} is not in 0..{self.plant.objects.count() - 1}")
            self.plant.place(None if hidden is None else int(hidden))
        elif do == "task":
            await self._change_task(str(request["task"]))
        elif do == "fault":
            self.arm(faults.parse(str(request["fault"])))
        elif do == "heal":
            await self.heal()
        elif do == "scale":
            self.scale = min(max(float(request["scale"]), 0.01), 100.0)
        elif do == "stop":
            self.stop()
        elif do != "state":
            raise UsageError(f"no request {do!r}; there are place, task, fault, heal, scale, stop, state")
        return self._state()

    async def _change_task(self, task: str) -> None:
        """Put the arm before another task's bench; connections of the last one are closed."""
        self.lab.station(task)
        self._drop(reset=False)
        for transport in list(self.text.transports):
            transport.close()
        datagrams = self.gripper._transport
        self._armed.clear()
        self._build(task)
        if datagrams is not None:
            datagrams.set_protocol(self.gripper)
            self.gripper.connection_made(datagrams)
        for server in self._servers:
            server.close()
        self._servers.clear()
        await self._listen()

    def _state(self) -> dict[str, Any]:
        plant, controller = self.plant, self.controller
        return {
            "task": plant.task,
            "time": plant.time,
            "joints": plant.joints.tolist(),
            "tool": controller.tool_pose().tolist(),
            "speed": float(np.linalg.norm(plant.tool_speed()[:3])),
            "travel": self.travel,
            "motions": plant.motions,
            "angles": plant.angles(exact=True).tolist(),
            "hidden": plant.hidden,
            "pushed": plant.objects.pushed(),
            "runtime": controller.runtime,
            "safety": controller.safety_mode,
            "log": controller.log[-20:],
        }


def _reset(transport: asyncio.Transport) -> None:
    sock: socket.socket = transport.get_extra_info("socket")
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_RESET)
    transport.abort()
