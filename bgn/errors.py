"""The base of every error that a user can meet; the command line prints its message without a traceback."""

from __future__ import annotations


class BgnError(Exception):
    """Something a user asked for is not possible; the message says what, where, and what would be right."""

    def __str__(self) -> str:
        # KeyError, which some of these errors also are, would print the repr of its message.
        return str(self.args[0]) if len(self.args) == 1 else super().__str__()


class InputError(BgnError, ValueError):
    """A value that was asked for makes no sense; the message says which would."""
