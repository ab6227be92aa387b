"""The gripper's driver against a scripted peer on loopback: grammar, retries, draining, source."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import pytest

from bgn.robot.errors import GripperError
from bgn.robot.gripper import RddaGripper
from bgn.robot.lab import Gripper, load

SETTINGS = load().gripper.model_copy(update={"port": 46800, "reply_port": 46801, "timeout": 0.1})
HOST = "127.0.0.1"
Answers = Sequence[Sequence[bytes]]


class Peer:
    """Answers the n-th request with the n-th sequence of datagrams."""

    def __init__(self, answers: Answers) -> None:
        self.heard: list[str] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, SETTINGS.port))
        self._thread = threading.Thread(target=self._serve, args=(answers,))
        self._thread.start()

    def _serve(self, answers: Answers) -> None:
        for replies in answers:
            data, _ = self._socket.recvfrom(256)
            if data == b"end":
                return
            self.heard.append(data.decode())
            for reply in replies:
                self._socket.sendto(reply, (HOST, SETTINGS.reply_port))

    def close(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"end", (HOST, SETTINGS.port))
        self._thread.join()
        self._socket.close()


@pytest.fixture
def peer() -> Iterator[Callable[[Answers], tuple[RddaGripper, Peer]]]:
    made: list[RddaGripper | Peer] = []

    def make(answers: Answers) -> tuple[RddaGripper, Peer]:
        both = RddaGripper(HOST, SETTINGS), Peer(answers)
        made.extend(both)
        return both

    yield make
    for one in made:
        one.close()


Make = Callable[[Answers], tuple[RddaGripper, Peer]]


def test_every_command_by_the_letter(peer: Make) -> None:
    gripper, other = peer(
        [[b"1"], [b"1"], [b"1"], [b"(0.25, -1e-3)"], [b"[0.0, 0.5]"], [b"[-1, -1]"], [b"[1, 1]"]]
    )
    gripper.set_stiffness([0.2, 4])
    gripper.set_positions([0.1234567, -0.5])
    gripper.set_max_velocities([3, 3])
    assert gripper.read_positions() == (0.25, -0.001)
    assert gripper.read_origins() == (0.0, 0.5)
    assert gripper.read_bounds() == ((-1.0, -1.0), (1.0, 1.0))
    assert other.heard == [
        "set_rdda_stiffness,0.2,4",
        "set_rdda_positions,0.123457,-0.5",
        "set_rdda_max_velocities,3,3",
        "read_rdda_positions",
        "read_rdda_origins",
        "read_rdda_lower_bounds",
        "read_rdda_upper_bounds",
    ]


@pytest.mark.parametrize(
    "reply",
    [b"(0.1)", b"[0.1, 0.2]", b"(0.1, 0.2) x", b"(nan, 0)", b"1", b"None", b"(0.1, 0.2" + b"1" * 80, b"\xff"],
)
def test_what_is_not_the_grammar_is_asked_for_again(peer: Make, reply: bytes) -> None:
    gripper, other = peer([[reply], [b"(0.1, 0.2)"]])
    assert gripper.read_positions() == (0.1, 0.2)
    assert len(other.heard) == 2


def test_what_never_answers_is_an_error_after_all_retries(peer: Make) -> None:
    gripper, other = peer([[] for _ in range(10)])
    with pytest.raises(GripperError, match="does not answer read_rdda_positions: heard nothing"):
        gripper.read_positions()
    assert len(other.heard) == 1 + SETTINGS.retries


def test_homing_is_not_repeated(peer: Make) -> None:
    gripper, other = peer([[], [b"1"]])
    with pytest.raises(GripperError, match="home_rdda"):
        gripper.home()
    assert other.heard == ["home_rdda"]


def test_old_replies_are_thrown_away_before_a_request(peer: Make) -> None:
    gripper, _ = peer([[b"(9, 9)", b"(1, 1)"], [b"(2, 2)"]])
    assert gripper.read_positions() == (9.0, 9.0)
    time.sleep(0.05)  # until the second reply has arrived, too
    assert gripper.read_positions() == (2.0, 2.0)


def test_a_refusal_and_an_impossible_angle_are_errors(peer: Make) -> None:
    gripper, _ = peer([[b"0"], [b"(50.0, 0.0)"]])
    with pytest.raises(GripperError, match="refuses set_rdda_stiffness"):
        gripper.set_stiffness([1, 1])
    with pytest.raises(GripperError, match="50 rad"):
        gripper.read_positions()


def test_other_senders_are_not_heard() -> None:
    gripper = RddaGripper("127.0.0.1", SETTINGS.model_copy(update={"retries": 0}))
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.5", 0))
            timer = threading.Timer(0.02, stranger.sendto, (b"(7, 7)", (HOST, SETTINGS.reply_port)))
            timer.start()
            with pytest.raises(GripperError, match="does not answer"):
                gripper.read_positions()
            timer.join()
    finally:
        gripper.close()


def test_the_settings_are_the_laboratory_s() -> None:
    assert isinstance(SETTINGS, Gripper)
    assert (SETTINGS.soft, SETTINGS.stiff, SETTINGS.fixed) == (0.2, 4.0, 1.0)  # authors
