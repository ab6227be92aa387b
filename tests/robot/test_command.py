"""The command line: what is refused before any socket opens, the dry run, exit codes."""

from __future__ import annotations

import importlib.util
import socket
from pathlib import Path
from typing import Any

import pytest

from bgn.__main__ import main
from bgn.robot import lab, network
from bgn.robot.entrant import PUBLISHED, ROOT, enter
from bgn.robot.errors import MissingExtraError, RobotError, UsageError
from bgn.robot.session import plan


@pytest.fixture
def no_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: Any, **keywords: Any) -> None:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)


@pytest.mark.usefixtures("no_socket")
@pytest.mark.parametrize(
    ("options", "word"),
    [
        ([], "no robot"),
        (["--execute"], "no robot"),
        (["--real"], "no robot"),
        (["--host", "192.168.1.10"], "add --real"),
        (["--host", "192.168.1.10", "--execute"], "add --real"),
        (["--host", "127.0.0.2", "--gripper-host", "192.168.1.10"], "add --real"),
        (["--host", "robot.example"], "numeric address"),
        (["--host", "localhost", "--real"], "numeric address"),
        (["--host", "192.168.1.10", "--real", "--twin-operator"], "for the twin"),
        (["--host", "192.168.1.10", "--real", "--no-lap"], "for the twin"),
        (["--host", "127.0.0.2", "--speed", "0.3"], "0..0.25"),
        (["--host", "127.0.0.2", "--episodes", "0"], "at least 1"),
        (["--host", "127.0.0.2", "--stale-after", "5"], "0.05..1"),
        (["--host", "127.0.0.2", "--policy", "top-plate"], "TASK=FILE"),
        (["--host", "127.0.0.2", "--lab", "/nowhere.toml"], "cannot read"),
        (["--host", "127.0.0.2", "--resume", "/nowhere"], "no session"),
    ],
)
def test_nothing_opens_before_everything_was_said(
    options: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["robot", "evaluate", *options]) == UsageError.exit_code
    assert word in capsys.readouterr().err


@pytest.mark.usefixtures("no_socket")
def test_the_twin_serves_loopback_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "twin", "--host", "0.0.0.0"]) == UsageError.exit_code
    assert "loopback" in capsys.readouterr().err


def test_nobody_at_the_address(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["robot", "evaluate", "--host", "127.0.0.98", "--task", "top-plate"])
    output = capsys.readouterr()
    assert code == 13
    assert "top-plate" in output.out  # the plan was printed
    assert "no dashboard" in output.err


def test_without_the_client_library_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "rtde_control" else find(name)
    )
    options = ["--host", "127.0.0.98", "--task", "top-plate", "--execute", "--out", str(tmp_path / "session")]
    assert main(["robot", "evaluate", *options]) == MissingExtraError.exit_code
    assert ".[robot]" in capsys.readouterr().err
    assert not (tmp_path / "session").exists()


def test_exit_codes_tell_kinds_of_trouble_apart() -> None:
    kinds: list[type[RobotError]] = [RobotError]
    for kind in kinds:
        kinds.extend(kind.__subclasses__())
    direct = [kind for kind in kinds if RobotError in kind.__bases__ or kind is RobotError]
    codes = [kind.exit_code for kind in direct]
    assert len(set(codes)) == len(codes)
    assert not {0, 1} & set(codes)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("10.0.0.1", False), ("localhost", False)],
)
def test_loopback(host: str, expected: bool) -> None:
    assert network.is_loopback(host) is expected


def test_a_policy_of_another_task_is_refused() -> None:
    with pytest.raises(UsageError, match="of top-plate, not of two-bumps-1d"):
        enter("two-bumps-1d", ROOT / PUBLISHED.format(task="top-plate"))


def test_the_plan_is_a_function_of_its_seed() -> None:
    tasks = ["two-bumps-1d", "two-bumps-2d"]
    assert plan(tasks, 5, 3) == plan(tasks, 5, 3)
    assert plan(tasks, 5, 3) != plan(tasks, 5, 4)
    assert plan(tasks, 5, 3)[:2] == plan(tasks, 2, 3)[:2]


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("speed = 0.1 ", "speed = 0.3 ", "above the cap"),
        ("speed_cap = 0.25", "speed_cap = 1.0", "speed_cap"),
        ("axes = [[0.0, -1.0, 0.0]] ", "axes = [[0.0, -2.0, 0.0]] ", "orthogonal"),
        ("angle_edges = [-0.11, 0.12]", "angle_edges = [0.12, -0.11]", "increase"),
        ("force_limit = 20.0", "force_limt = 20.0", "force_lim"),
        ("[arm]", "[arm", "not TOML"),
        ("sample_rate = 250.0", "sample_rate = 60.0", "sample_rate"),
    ],
)
def test_a_wrong_laboratory_file_is_named(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = lab.DEFAULT.read_text()
    assert old in text
    wrong = tmp_path / "lab.toml"
    wrong.write_text(text.replace(old, new, 1))
    with pytest.raises(UsageError, match=word):
        lab.load(wrong)
