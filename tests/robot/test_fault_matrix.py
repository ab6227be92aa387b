"""What happens when something goes wrong: the whole matrix, by the command itself on a twin in real time.

In every case the arm comes to rest within the stated travel, the process survives with its own exit code and
message, the episode is marked, and nothing that was recorded is lost. ``nox -s faults`` runs these.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bgn.robot.errors import (
    AbortedError,
    ConnectionLostError,
    EmergencyStopError,
    GripperError,
    MotionError,
    PreflightError,
    ProgramStoppedError,
    ProtectiveStopError,
    RefusedError,
    RobotError,
)
from bgn.robot.twin.client import TwinClient, TwinProcess
from tests.robot.conftest import Evaluation, Outcome, needs_client

pytestmark = pytest.mark.twin

#: Half a second into a step of the episode at 0.1 m/s.
MID_STEP = "@6+0.4"
SPEED = 0.1  # m/s
STALE = 0.4  # s


@pytest.fixture(autouse=True)
def _client() -> None:
    needs_client()


def check(outcome: Outcome, error: type[RobotError], word: str) -> None:
    """Check exit code, message, mark and recording of an interrupted episode."""
    assert outcome.code == error.exit_code, outcome.said
    assert word in outcome.said
    assert outcome.last.outcome == error.outcome
    assert word in outcome.last.reason
    raw, events = outcome.raw(), outcome.events()
    assert len(raw) > 100
    assert raw[["q0", "x", "force_x", "angle_0"]].notna().tail(50).all(axis=None)
    assert error.outcome in events.text.iloc[-1]


def at_rest(twin: TwinProcess, travel: float) -> None:
    """Check that the arm stands still no further than ``travel`` metres from where the fault met it."""
    state = twin.client.wait_for_rest()
    assert state["travel"] <= travel, f"{1e3 * state['travel']:.1f} mm"


def wait_for_motion(host: str, number: int) -> None:
    """Wait, in a thread of its own, until the twin's arm has begun so many motions."""
    client = TwinClient(host)
    while client.ask("state")["motions"] < number:
        time.sleep(0.02)
    client.close()


@pytest.mark.parametrize(
    ("fault", "seconds", "word"),
    [
        ("close", 0.1, "closed the connection"),
        ("reset", 0.1, "closed the connection"),
        ("refuse", 0.5, "closed the connection"),  # nobody hears "stop": the watchdog does it
        ("mute", STALE + 0.1, "no fresh data"),
        ("freeze=3", 0.5, "no fresh data"),
    ],
)
def test_the_connection_fails_during_a_move(
    evaluation: Evaluation, fault: str, seconds: float, word: str
) -> None:
    outcome = evaluation.run(faults=(fault + MID_STEP,))
    check(outcome, ConnectionLostError, word)
    at_rest(evaluation.twin, SPEED * (seconds + 0.15))


def test_the_worker_is_killed_during_a_move(evaluation: Evaluation) -> None:
    def kill() -> None:
        wait_for_motion(evaluation.twin.host, 6)
        time.sleep(0.4)
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        for child in children:
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                os.kill(int(child), signal.SIGKILL)

    evaluation.twin.client.ask("heal")
    killer = threading.Thread(target=kill)
    outcome = _run_beside(evaluation, killer)
    check(outcome, ConnectionLostError, "worker process died")
    evaluation.twin.client.wait_for_rest()
    moved = outcome.raw().iloc[-1]
    tool = evaluation.twin.client.ask("state")["tool"]
    assert abs(tool[1] - moved.y) < SPEED * 0.25


def test_the_evaluation_itself_is_killed_during_a_move(twin: TwinProcess, tmp_path: Path) -> None:
    """Nobody is left to stop the arm but the worker, which sees that its parent is gone."""
    client = twin.client
    client.ask("heal")
    client.ask("scale", scale=1)
    client.ask("task", task="two-bumps-1d")
    options = [
        "--execute",
        "--no-lap",
        "--task",
        "two-bumps-1d",
        "--episodes",
        "1",
        "--seed",
        "1",
        "--twin-operator",
    ]
    command = [
        sys.executable,
        "-m",
        "bgn",
        "robot",
        "evaluate",
        "--host",
        twin.host,
        "--out",
        str(tmp_path),
        *options,
    ]
    process = subprocess.Popen([*command, "--stale-after", str(STALE)], stdout=subprocess.DEVNULL)
    try:
        while client.ask("state")["motions"] < 6:
            assert process.poll() is None
            time.sleep(0.02)
        time.sleep(0.4)
        before = client.ask("state")["tool"]
    finally:
        process.kill()
        process.wait()
    after = client.wait_for_rest()["tool"]
    assert abs(after[1] - before[1]) < SPEED * 0.65  # the watchdog's half second, if the worker is not faster
    due = time.monotonic() + 5
    while not any("watchdog" in line for line in client.ask("state")["log"]):
        assert time.monotonic() < due, "nothing ended the program"
        time.sleep(0.1)
    assert json.loads(next(tmp_path.glob("episodes/*/episode.json")).read_text())["outcome"] == "incomplete"


def _run_beside(evaluation: Evaluation, thread: threading.Thread, *options: str) -> Outcome:
    client = evaluation.twin.client
    client.ask("task", task="two-bumps-1d")
    thread.start()
    try:
        return evaluation.run(*options)
    finally:
        thread.join()


@pytest.mark.parametrize(
    ("fault", "error", "word", "travel"),
    [
        ("protective-stop", ProtectiveStopError, "protective stop", 0.005),
        ("emergency-stop", EmergencyStopError, "emergency stop", 0.005),
        ("stop-program", ProgramStoppedError, "program ended", 0.02),
        ("wall=0.015", MotionError, "N at the tool", 0.04),
        ("short=0.3", MotionError, "from its target", 0.08),
    ],
)
def test_the_arm_is_stopped_or_blocked(
    evaluation: Evaluation, fault: str, error: type[RobotError], word: str, travel: float
) -> None:
    outcome = evaluation.run(faults=(fault + MID_STEP,))
    check(outcome, error, word)
    at_rest(evaluation.twin, travel)


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("local", "remote control is 'false'"),
        ("fieldbus", "already in use"),
        ("protective-stop", "PROTECTIVE_STOP"),
    ],
)
def test_the_controller_is_not_ready(evaluation: Evaluation, fault: str, word: str) -> None:
    outcome = evaluation.run(faults=(fault,))
    assert outcome.code == PreflightError.exit_code
    assert word in outcome.said
    assert not len(outcome.episodes)
    assert evaluation.twin.client.ask("state")["motions"] == 0


def test_old_firmware_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with TwinProcess("two-bumps-1d", "127.0.0.99", "--polyscope", "5.3.1.0") as old:
        # Changing the bench would build a new controller, so the command is run without it.
        from bgn.__main__ import main

        code = main(
            ["robot", "evaluate", "--host", old.host, "--task", "two-bumps-1d", "--out", str(tmp_path)]
        )
    assert code == PreflightError.exit_code
    assert "PolyScope is '5.3.1.0' instead of '5.4+'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "fault", ["gripper-lost=3", "gripper-garbled=3", "gripper-duplicate=30", "gripper-late=0.02"]
)
def test_a_bad_line_to_the_gripper_is_borne(evaluation: Evaluation, fault: str) -> None:
    outcome = evaluation.run(faults=(fault + "@5+0.2",), scale=4)
    assert outcome.code == 0, outcome.said
    assert outcome.last.outcome == "success"


@pytest.mark.parametrize(
    ("fault", "word"), [("gripper-dead", "does not answer"), ("gripper-garbled=99", "does not answer")]
)
def test_a_dead_gripper_ends_the_episode(evaluation: Evaluation, fault: str, word: str) -> None:
    outcome = evaluation.run(faults=(fault + MID_STEP,))
    check(outcome, GripperError, word)
    at_rest(evaluation.twin, 0.08)  # the move itself comes to its end


@pytest.mark.parametrize(("fault", "word"), [("noise=0.05", "scatters"), ("drift=0.4", "from its origin")])
def test_a_finger_that_does_not_rest_is_refused(evaluation: Evaluation, fault: str, word: str) -> None:
    outcome = evaluation.run(faults=(fault,))
    assert outcome.code == GripperError.exit_code
    assert word in outcome.last.reason


@pytest.mark.parametrize("moment", ["connecting", "moving", "settling"])
def test_ctrl_c_stops_and_softens(evaluation: Evaluation, moment: str) -> None:
    def interrupt() -> None:
        if moment != "connecting":
            wait_for_motion(evaluation.twin.host, 6)
            time.sleep(0.4 if moment == "moving" else 1.1)
        else:
            time.sleep(1.0)
        os.kill(os.getpid(), signal.SIGINT)

    outcome = _run_beside(evaluation, threading.Thread(target=interrupt))
    assert outcome.code == AbortedError.exit_code, outcome.said
    assert "Ctrl-C" in outcome.said
    if moment != "connecting":
        check(outcome, AbortedError, "Ctrl-C")
        assert "soft" in outcome.events().kind.tolist()
    evaluation.twin.client.wait_for_rest()


def test_a_wrong_confirmation_moves_nothing(evaluation: Evaluation, tmp_path: Path) -> None:
    answers = tmp_path / "answers"
    answers.write_text("yes\n")
    outcome = evaluation.run("--answers", str(answers), operator=False)
    assert outcome.code == RefusedError.exit_code
    assert "not confirmed" in outcome.said
    assert evaluation.twin.client.ask("state")["motions"] == 0


def test_an_operator_who_does_not_answer_ends_the_session(evaluation: Evaluation, tmp_path: Path) -> None:
    answers = tmp_path / "answers"
    answers.write_text("")
    outcome = evaluation.run("--answers", str(answers), operator=False)
    assert outcome.code == RefusedError.exit_code
    assert "no answer within" in outcome.said


def test_a_session_resumes_after_a_loss_and_ends_in_success(evaluation: Evaluation) -> None:
    lost = evaluation.run(faults=("reset" + MID_STEP,))
    assert lost.code == ConnectionLostError.exit_code
    resumed = evaluation.run("--resume", str(evaluation.folder), scale=4)
    assert resumed.code == 0, resumed.said
    assert resumed.episodes.outcome.tolist() == ["lost", "success"]
    assert len(resumed.raw(0)) > 100  # the interrupted attempt is still there


def test_a_protective_stop_is_unlocked_by_the_operator_only(
    evaluation: Evaluation, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bgn.robot import operators

    plain = operators.Automaton.choose
    asked: list[float] = []

    def choose(self: operators.Automaton, question: str, choices: dict[str, str]) -> str:
        if "cleared" in choices:
            asked.append(time.monotonic())
            return "cleared"
        return plain(self, question, choices)

    monkeypatch.setattr(operators.Automaton, "choose", choose)
    outcome = evaluation.run(faults=("protective-stop" + MID_STEP,), scale=4)
    assert outcome.code == 0, outcome.said
    assert outcome.episodes.outcome.tolist() == ["protective-stop", "success"]
    assert len(asked) == 1
    assert time.monotonic() - asked[0] > 5  # the controller may be unlocked after five seconds only
