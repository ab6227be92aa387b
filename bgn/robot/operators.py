"""The person at the robot: what is said to them, what they answer, and the stand-ins of tests and of the twin."""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Final, Protocol

from bgn.robot.errors import RefusedError
from bgn.robot.twin.client import TwinClient
from bgn.robot.ur5e import Abort

TRIES: Final = 3
TIMEOUT: Final = 600.0  # s for an answer
POLL: Final = 0.2  # s between two looks at Ctrl-C while waiting for an answer
UNDO: Final = "undo"
PUSHES: Final = {
    "no": 0,
    "left bump left": -1,
    "left bump right": 1,
    "right bump left": -2,
    "right bump right": 2,
}
#: Takes a time limit in seconds; returns a line without its end, or None if none came.
Reader = Callable[[float], str | None]


class Operator(Protocol):
    """Who stands at the robot."""

    def tell(self, text: str) -> None:
        """Say something that needs no answer."""
        ...

    def confirm(self, question: str, wanted: str) -> None:
        """Have ``wanted`` typed in full; anything else refuses."""
        ...

    def choose(self, question: str, choices: Mapping[str, str]) -> str:
        """Return one of the choices (answer: what it means)."""
        ...

    def place(self, task: str, hidden: int | None, text: str) -> None:
        """Have the objects placed, or taken away (None)."""
        ...

    def pushed(self) -> int:
        """Return which bump a stiff move pushed; see ``PUSHES``."""
        ...

    def change_task(self, task: str, text: str) -> None:
        """Have another task's bench set up and the arm brought before it."""
        ...

    def close(self) -> None:
        """Say goodbye."""
        ...


class Person:
    """Somebody who types answers; ``undo`` after an answer asks again.

    Every question has a time limit. Wrong answers are asked again, at most :data:`TRIES` times in all.
    """

    def __init__(
        self, read: Reader, write: Callable[[str], None], abort: Abort, timeout: float = TIMEOUT
    ) -> None:
        self._read, self._write, self._abort, self._timeout = read, write, abort, timeout

    def tell(self, text: str) -> None:
        """Print it."""
        self._write(text)

    def confirm(self, question: str, wanted: str) -> None:
        """Have ``wanted`` typed; one mistake refuses.

        Raises
        ------
        RefusedError
            Something else was typed, or nothing in time.
        """
        answer = self._ask(f"{question}\ntype exactly: {wanted}")
        if answer != wanted:
            raise RefusedError(f"not confirmed: {answer!r} is not {wanted!r}; nothing was moved")

    def choose(self, question: str, choices: Mapping[str, str]) -> str:
        """Offer choices; an answer stands after Enter, and ``undo`` takes it back.

        Raises
        ------
        RefusedError
            Too many answers that are none of the choices, or none in time.
        """
        offered = ", ".join(
            f"{answer!r} ({meaning})" if meaning else repr(answer) for answer, meaning in choices.items()
        )
        mistakes = 0
        while mistakes < TRIES:
            answer = self._ask(f"{question} [{offered}]").strip().lower()
            if answer not in choices:
                mistakes += 1
                self._write(f"{answer!r} is none of these")
                continue
            if (
                self._ask(f"you said {answer!r}: Enter to go on, {UNDO!r} to answer again").strip().lower()
                != UNDO
            ):
                return answer
        raise RefusedError(f"{TRIES} answers that were none of {', '.join(choices)}")

    def place(self, task: str, hidden: int | None, text: str) -> None:
        """Have objects placed and step back."""
        self.choose(text, {"ready": "placed, and everybody is out of reach"})

    def pushed(self) -> int:
        """Ask which bump moved."""
        return PUSHES[self.choose("which bump did the finger push?", dict.fromkeys(PUSHES, ""))]

    def change_task(self, task: str, text: str) -> None:
        """Have another bench set up."""
        self.choose(text, {"ready": "set up, arm in place, remote control"})

    def close(self) -> None:
        """Nothing to do."""

    def _ask(self, text: str) -> str:
        self._write(text)
        due = time.monotonic() + self._timeout
        while True:
            self._abort.check()
            left = due - time.monotonic()
            if left <= 0:
                raise RefusedError(f"no answer within {self._timeout:g} s")
            answer = self._read(min(left, POLL))
            if answer is not None:
                return answer


def console(abort: Abort) -> Person:
    """Return the person at this terminal."""

    def read(seconds: float) -> str | None:
        ready, _, _ = select.select([sys.stdin], [], [], seconds)
        if not ready:
            return None
        line = sys.stdin.readline()
        if not line:
            raise RefusedError("the standard input ended; answers come from a terminal, or from --answers")
        return line.rstrip("\n")

    return Person(read, lambda text: print(text, flush=True), abort)


def scripted(answers: Iterable[str], abort: Abort, timeout: float = 1.0) -> Person:
    """Return a person who gives prepared answers, one a question, and then none."""
    left = iter(answers)

    def read(seconds: float) -> str | None:
        answer = next(left, None)
        if answer is None:
            time.sleep(seconds)
        return answer

    return Person(read, lambda text: print(text, flush=True), abort, timeout)


class Automaton:
    """Serves at the twin: places objects in it, sees pushes in its physics, and confirms what it is asked to.

    Of choices it takes the last one, which is the careful one.
    """

    def __init__(self, client: TwinClient) -> None:
        self._client = client

    def tell(self, text: str) -> None:
        """Print it."""
        print(text, flush=True)

    def confirm(self, question: str, wanted: str) -> None:
        """Confirm."""

    def choose(self, question: str, choices: Mapping[str, str]) -> str:
        """Take the last choice."""
        answer = list(choices)[-1]
        print(f"{question} {answer}", flush=True)
        return answer

    def place(self, task: str, hidden: int | None, text: str) -> None:
        """Place them in the twin."""
        self._client.place(hidden)

    def pushed(self) -> int:
        """Look at the twin's bumps."""
        return self._client.pushed()

    def change_task(self, task: str, text: str) -> None:
        """Change the twin's bench."""
        if self._client.ask("state")["task"] != task:
            self._client.ask("task", task=task)

    def close(self) -> None:
        """Hang up at the twin."""
        self._client.close()
