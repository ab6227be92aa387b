"""The operator's questions: confirmation, choices, mistakes, undo, time limits, Ctrl-C."""

from __future__ import annotations

import pytest

from bgn.robot.errors import AbortedError, RefusedError
from bgn.robot.operators import TRIES, Person, scripted
from bgn.robot.ur5e import Abort

CHOICES = {"retry": "", "stop": ""}


def person(*answers: str) -> Person:
    return scripted(answers, Abort(), timeout=0.05)


def test_a_confirmation_is_typed_in_full() -> None:
    person("123 abc 0.1").confirm("sure?", "123 abc 0.1")
    for wrong in ("", "yes", "123 abc 0.10"):
        with pytest.raises(RefusedError, match="not confirmed"):
            person(wrong).confirm("sure?", "123 abc 0.1")


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        (["retry", ""], "retry"),
        ([" STOP ", ""], "stop"),
        (["what", "retry", ""], "retry"),
        (["retry", "undo", "stop", ""], "stop"),
    ],
)
def test_choices(answers: list[str], expected: str) -> None:
    assert person(*answers).choose("and now?", CHOICES) == expected


def test_mistakes_come_to_an_end() -> None:
    with pytest.raises(RefusedError, match="none of retry, stop"):
        person(*["what"] * TRIES).choose("and now?", CHOICES)


def test_silence_comes_to_an_end() -> None:
    with pytest.raises(RefusedError, match="no answer within"):
        person().choose("and now?", CHOICES)


def test_pushes_are_coded_as_the_scene_codes_them() -> None:
    assert person("right bump right", "").pushed() == 2
    assert person("left bump left", "").pushed() == -1
    assert person("no", "").pushed() == 0


def test_ctrl_c_ends_a_wait() -> None:
    abort = Abort()
    abort.asked = True
    with pytest.raises(AbortedError):
        scripted(["retry"], abort).choose("and now?", CHOICES)
