"""The twin without sockets: what its exchange answers byte by byte, its controller, its physics, its finger."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn import domains
from bgn.physics.tasks import task_of
from bgn.physics.world import play
from bgn.policies.scripted import scripted_policy
from bgn.robot import kinematics, lab
from bgn.robot.errors import UsageError
from bgn.robot.moves import MOVES
from bgn.robot.twin import faults
from bgn.robot.twin.controller import PAUSED, PLAYING, STOPPED, Controller
from bgn.robot.twin.direct import direct_finger
from bgn.robot.twin.gripper_peer import GripperModel
from bgn.robot.twin.plant import Plant
from bgn.robot.twin.rtde import ProtocolError, Session

LAB = lab.load()
SCRIPT = "def rtde_control():\n    global reg_offset_int = # int register offset\n0\n"
TASKS = ["top-plate", "two-bumps-1d", "two-bumps-2d"]


@pytest.fixture
def controller() -> Controller:
    return Controller(Plant(LAB, "two-bumps-1d"))


def message(kind: str, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def test_the_exchange_by_the_byte(controller: Controller) -> None:
    session = Session(controller)
    assert session.feed(message("V", b"\x00\x02")) == b"\x00\x04V\x01"
    assert session.feed(message("v")) == b"\x00\x13v" + struct.pack(">4I", 5, 15, 0, 126)
    outputs = struct.pack(">d", 125.0) + b"timestamp,runtime_state,actual_q,"
    assert session.feed(message("O", outputs)) == message("O", b"\x01DOUBLE,UINT32,VECTOR6D")
    assert session.feed(message("I", b"input_int_register_0,input_double_register_0,")) == message(
        "I", b"\x01INT32,DOUBLE"
    )
    assert session.package() is None
    assert session.feed(message("S")) == message("S", b"\x01")
    package = session.package()
    assert package is not None
    assert package[:4] == struct.pack(">HBB", 4 + 8 + 4 + 48, ord("U"), 1)
    assert session.package() is None  # the next one is due 8 ms later
    assert session.feed(message("U", b"\x01" + struct.pack(">id", 7, 0.5))) == b""
    assert (controller.input_ints[0], controller.input_doubles[0]) == (7, 0.5)
    session.feed(message("U", b"\x01" + struct.pack(">i", 9)))  # trailing fields may be missing
    assert (controller.input_ints[0], controller.input_doubles[0]) == (9, 0.5)


def test_messages_may_come_in_pieces(controller: Controller) -> None:
    session = Session(controller)
    whole = message("V", b"\x00\x02") * 2
    replies = b"".join(session.feed(whole[i : i + 1]) for i in range(len(whole)))
    assert replies == b"\x00\x04V\x01" * 2


def test_unknown_names_and_taken_registers_are_said(controller: Controller) -> None:
    first, second = Session(controller), Session(controller)
    assert b"NOT_FOUND" in first.feed(message("O", struct.pack(">d", 125.0) + b"timestamp,nonsense,"))
    assert first.feed(message("I", b"input_int_register_3,")) == message("I", b"\x01INT32")
    assert second.feed(message("I", b"input_int_register_3,")) == message("I", b"\x00IN_USE")
    first.close()
    assert second.feed(message("I", b"input_int_register_3,")) == message("I", b"\x01INT32")


@pytest.mark.parametrize(
    "data",
    [
        b"\x00\x02V",
        b"\xff\xffV",
        message("Z"),
        message("U", b"\x01\x00"),
        message("O", b"\x00"),
        message("O", struct.pack(">d", float("nan")) + b"timestamp,"),
        message("I", b"x," * 1500),
    ],
)
def test_what_is_not_the_protocol_is_refused(controller: Controller, data: bytes) -> None:
    with pytest.raises(ProtocolError):
        Session(controller).feed(data)


_SHARED: list[Controller] = []


@given(st.binary(max_size=300))
@settings(max_examples=60)
def test_noise_never_breaks_the_exchange(data: bytes) -> None:
    if not _SHARED:
        _SHARED.append(Controller(Plant(LAB, "two-bumps-1d")))
    session = Session(_SHARED[0])
    try:
        session.feed(data)
    except (ProtocolError, struct.error, UnicodeDecodeError):
        pass  # the server hangs up on these
    finally:
        session.close()


def run(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds / 0.01)):
        controller.heard()
        controller.advance(5, 0.01)


def start(controller: Controller) -> None:
    controller.upload(SCRIPT)
    run(controller, 0.1)
    assert controller.running
    assert controller.output_ints[0] == 1


def command(controller: Controller, number: int, *doubles: float, asynchronous: bool = False) -> None:
    """Send a command and take it back, as the client does."""
    controller.input_doubles[: len(doubles)] = doubles
    controller.input_ints[0], controller.input_ints[1] = number, int(asynchronous)
    run(controller, 0.02)


def test_a_blocking_move_is_done_when_the_arm_is_there(controller: Controller) -> None:
    start(controller)
    pose = controller.tool_pose()
    pose[1] += 0.08
    command(controller, 3, *pose, 0.1, 0.5)
    assert controller.output_ints[0] == 1  # still busy
    run(controller, 1.2)
    assert controller.output_ints[0] == 2
    np.testing.assert_allclose(controller.tool_pose()[:3], pose[:3], atol=1e-4)


def test_an_asynchronous_move_is_reported_and_can_be_stopped(controller: Controller) -> None:
    start(controller)
    pose = controller.tool_pose()
    begun = pose[1]
    pose[1] += 0.3
    before = controller.output_ints[2] >> 24
    command(controller, 3, *pose, 0.1, 0.5, asynchronous=True)
    assert controller.output_ints[0] == 2
    assert controller.output_ints[2] >> 15 & 1
    assert controller.output_ints[2] >> 24 == before + 1
    run(controller, 0.5)
    command(controller, 0)
    command(controller, 33, 2.0)
    run(controller, 0.3)
    assert not controller.output_ints[2] >> 15 & 1
    assert controller.steady
    assert 0.03 < controller.tool_pose()[1] - begun < 0.08


def test_an_unreachable_pose_ends_the_program(controller: Controller) -> None:
    start(controller)
    command(controller, 3, -1.5, 0, 0.2, np.pi, 0, 0, 0.1, 0.5)
    assert controller.runtime == STOPPED
    assert "no solution" in controller.log[-1]


def test_a_joint_limit_makes_a_protective_stop(controller: Controller) -> None:
    start(controller)
    joints = controller.plant.joints.copy()
    joints[5] += 6.5
    command(controller, 1, *joints, 3.0, 10.0, asynchronous=True)
    run(controller, 3.0)
    assert controller.runtime == PAUSED
    assert controller.safety_bits & 4
    assert (
        np.abs(controller.plant.joints).max() < kinematics.JOINT_LIMIT + 0.1
    )  # at 3 rad/s, seen every 10 ms


@pytest.mark.parametrize(("paused", "runtime"), [(False, STOPPED), (True, PAUSED)])
def test_a_protective_stop_is_unlocked_after_five_seconds(
    controller: Controller, paused: bool, runtime: int
) -> None:
    start(controller)
    controller.resumes_paused = paused
    controller.protective_stop("test")
    assert controller.answer("unlock protective stop").startswith("Cannot unlock")
    run(controller, 5.1)
    assert controller.answer("unlock protective stop") == "Protective stop releasing"
    assert (controller.runtime, controller.safety_bits) == (runtime, 1)


def test_the_watchdog_stops_a_program_that_hears_nothing(controller: Controller) -> None:
    start(controller)
    command(controller, 35, 2.0)
    command(controller, 0)
    run(controller, 1.0)
    assert controller.runtime == PLAYING
    for _ in range(60):
        controller.advance(5, 0.01)
    assert controller.runtime == STOPPED
    assert "watchdog" in controller.log[-1]


def test_local_mode_refuses(controller: Controller) -> None:
    controller.remote = False
    controller.upload(SCRIPT)
    run(controller, 0.2)
    assert not controller.running
    assert "Remote Control" in controller.answer("stop")
    assert controller.answer("is in remote control") == "false"


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        ("read_rdda_origins", "[0.0, 0.0]"),
        ("set_rdda_stiffness,0.2,1", "1"),
        ("set_rdda_stiffness,-1,1", "0"),
        ("set_rdda_positions,9,0", "0"),
        ("set_rdda_positions,nan,0", "0"),
        ("set_rdda_positions,1", "0"),
        ("move_arm,1,2", "None"),
        ("", "None"),
    ],
)
def test_the_gripper_answers_by_the_letter(asked: str, answer: str) -> None:
    assert GripperModel(Plant(LAB, "two-bumps-1d")).answer(asked) == answer


@pytest.mark.parametrize("task", TASKS)
def test_the_twin_s_finger_does_what_the_scene_does(task: str) -> None:
    """Same readings, cell by cell, in episodes of the paper's scripted policy, which succeeds in all."""
    domain = domains.get(task)
    finger, _ = direct_finger(LAB, task)
    rng = np.random.default_rng(3)
    success, _ = play(domain, task_of(task)(domain, finger), scripted_policy(domain), rng)
    assert success


@pytest.mark.parametrize("task", TASKS)
def test_moves_are_those_of_the_simulated_scenes(task: str) -> None:
    domain = domains.get(task)
    scene = task_of(task).make_scene(domain)
    shape = LAB.station(task).shape
    hidden = scene.hidden_parts()[0]
    cell = next(
        cell for cell in reversed(scene.starts(hidden)) if task == "top-plate" or cell >= sum(shape) // 3
    )
    for action, move in MOVES[task].items():
        before = scene.reset(hidden, cell).reading // scene.bins
        after = scene.act(action).reading // scene.bins
        stride = 1 if move.axis == 0 else shape[0]
        coordinate = cell % shape[0] if move.axis == 0 else cell // shape[0]
        inside = 0 <= coordinate + move.direction < shape[move.axis]
        assert after - before == (move.direction * stride if inside else 0)
    assert len(MOVES[task]) == scene.actions


def test_the_fingers_share_the_scene_s_geometry() -> None:
    """The hinge of every cell lies over the scene's cell: model, station and mounting agree."""
    for task in TASKS:
        plant = Plant(LAB, task)
        station = LAB.station(task)
        middle = tuple((size - 1) // 2 for size in station.shape)
        arm = plant.data.xmat[plant.model.body("arm").id].reshape(3, 3)
        hinge = plant.data.body("gripper").xpos
        from_base = arm.T @ (hinge - plant.data.body("arm").xpos)
        np.testing.assert_allclose(from_base, station.pose(middle, retreat=True)[:3], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("reset", ("reset", 0.0, 0, 0.0)),
        ("wall=0.05@3", ("wall", 0.05, 3, 0.0)),
        ("freeze@2+0.5", ("freeze", 3.0, 2, 0.5)),
    ],
)
def test_faults_are_read(text: str, expected: tuple[object, ...]) -> None:
    fault = faults.parse(text)
    assert (fault.name, fault.value, fault.motion, fault.delay) == expected


@pytest.mark.parametrize("text", ["", "explode", "reset=3", "wall=x", "wall=--1", "reset@", "reset@1+"])
def test_what_is_no_fault_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        faults.parse(text)
