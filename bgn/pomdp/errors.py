"""What is wrong with a .pomdp file, and where."""

from __future__ import annotations

import re

from lark import Token

from bgn.errors import BgnError

_COMMENT = re.compile(r"#[^\n]*")
_SHOWN = 40


class PomdpFormatError(BgnError, ValueError):
    """Not a valid .pomdp model: ``message``, found at ``line`` and ``column`` (from 1) of ``source``."""

    def __init__(self, message: str, line: int, column: int, source: str = "<string>") -> None:
        super().__init__(message, line, column, source)
        self.message = message
        self.line = line
        self.column = column
        self.source = source

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}: {self.message}"


def fault(message: str, token: Token, part: int = 0, words: str = r"\S+") -> PomdpFormatError:
    """Return the error at the ``part``-th match of ``words`` within a token (which may span lines)."""
    matches = re.finditer(words, without_comments(token))
    offset = next((match.start() for i, match in enumerate(matches) if i == part), 0)
    before = token[:offset]
    line = (token.line or 1) + before.count("\n")
    column = offset - before.rfind("\n") if "\n" in before else (token.column or 1) + offset
    return PomdpFormatError(message, line, column)


def without_comments(text: str) -> str:
    """Return the text with blanks in place of its comments."""
    return _COMMENT.sub(lambda comment: " " * len(comment[0]), text) if "#" in text else str(text)


def shown(word: str) -> str:
    """Return a word of the file for a message, cut where it is longer than anyone would read."""
    return word if len(word) <= _SHOWN else word[:_SHOWN] + "…"
