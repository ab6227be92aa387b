"""The entries of a .pomdp file, cut out of its tokens."""

from __future__ import annotations

import re
from collections.abc import Iterator

from lark import Token

from bgn.pomdp import _patterns
from bgn.pomdp.errors import without_comments

_PARTS = re.compile(_patterns.PARTS)


class Entry:
    """``T: action : state``, its head, and the numbers or the keyword that follow, its body."""

    __slots__ = ("body", "body_at", "head", "head_at", "text")

    def __init__(self, text: str, head: str, head_at: int, body: str, body_at: int) -> None:
        self.text = text  # the whole file
        self.head = without_comments(head)
        self.head_at = head_at
        self.body = without_comments(body)
        self.body_at = body_at

    @property
    def letter(self) -> str:
        """T, O or R."""
        return self.head[0]

    @property
    def references(self) -> list[str]:
        """What stands after the head's colons."""
        return [part.strip() for part in self.head.split(":")[1:]]

    @property
    def head_token(self) -> Token:
        """The head as a token that knows its place."""
        return self._token(self.head, self.head_at)

    @property
    def body_token(self) -> Token:
        """The body as a token that knows its place."""
        return self._token(self.body, self.body_at)

    def _token(self, part: str, at: int) -> Token:
        line = self.text.count("\n", 0, at) + 1
        return Token("ENTRY", part, start_pos=at, line=line, column=at - self.text.rfind("\n", 0, at))


def of_run(text: str, run: Token) -> Iterator[Entry]:
    """Yield the entries of a run of them, a token of ``text``."""
    start = run.start_pos or 0
    for parts in _PARTS.finditer(text, start, start + len(run)):
        yield Entry(text, parts["head"], parts.start("head"), parts["body"], parts.start("body"))


def of_rule(text: str, head: Token, body: Token) -> Entry:
    """Return the entry that a rule of the grammar found as two tokens of ``text``."""
    return Entry(text, str(head), head.start_pos or 0, str(body), body.start_pos or 0)
