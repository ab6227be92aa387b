"""Reads the .pomdp file format (https://www.pomdp.org/code/pomdp-file-spec.html), with ``reset`` rows.

A file cut short inside its R entries is still a valid file: rewards that no entry mentions are zero.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import resources
from os import PathLike, fspath
from pathlib import Path
from typing import Protocol, cast

from lark import Lark, Token, UnexpectedCharacters, UnexpectedToken

from bgn.pomdp import _patterns
from bgn.pomdp._assembly import assemble
from bgn.pomdp._declarations import Declarations
from bgn.pomdp._entries import Entry, of_rule, of_run
from bgn.pomdp._limits import MAX_BYTES, Limits
from bgn.pomdp.errors import PomdpFormatError, without_comments
from bgn.pomdp.model import POMDP

_DECLARATION = "a declaration ('discount:', 'values:', 'states:', 'actions:', 'observations:' or 'start:')"
_ENTRY = "an entry ('T: action …', 'O: action …' or 'R: action : state …')"
_MEANINGS = {
    **dict.fromkeys(("DISCOUNT", "VALUES", "SPACE", "START"), _DECLARATION),
    **dict.fromkeys(("T1", "T2", "T3", "O1", "O2", "O3", "R2", "R3", "R4", "ENTRIES"), _ENTRY),
    "COLON": "':'",
    **dict.fromkeys(("NAME", "NAMES"), "a name (a letter, then letters, digits, '_' or '-')"),
    "STATES": "a state",
    "COUNT": "a count",
    "NUMBERS": "a number",
    "$END": "the end of the file",
}


class _File(Protocol):
    """One half of a parsed file."""

    children: list[_Statement]


class _Statement(Protocol):
    """A parsed declaration, entry or run of entries: its rule in grammar.lark and its tokens."""

    data: str
    children: list[Token]


def load(path: str | PathLike[str]) -> POMDP:
    """Read a model from a .pomdp file.

    Raises
    ------
    PomdpFormatError
        The file is not a valid model; the message says where, and what was expected.
    OSError
        The file cannot be read.
    """
    size = Path(path).stat().st_size
    if size > MAX_BYTES:
        raise PomdpFormatError(f"expected at most {MAX_BYTES} bytes, found {size}", 1, 1, fspath(path))
    text = Path(path).read_bytes().decode("utf-8-sig", errors="replace")
    return loads(text, source=fspath(path))


def loads(text: str, *, source: str = "<string>") -> POMDP:
    """Read a model from the text of a .pomdp file; ``source`` names it in error messages."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    try:
        return _build(text, *_parse(text))
    except PomdpFormatError as error:
        raise PomdpFormatError(error.message, error.line, error.column, source) from None


@cache
def _parser() -> Lark:
    grammar = resources.files("bgn.pomdp").joinpath("grammar.lark").read_text(encoding="utf-8")
    for name in ("entries", "names", "numbers", "states"):
        grammar = grammar.replace(f"<{name}>", getattr(_patterns, name.upper()))
    return Lark(grammar, start="file", parser="lalr")


def _parse(text: str) -> tuple[list[_Statement], list[_Statement]]:
    """Return the declarations and the entries of a text."""
    try:
        preamble, entries = _parser().parse(text).children
    except UnexpectedCharacters as error:
        found = re.match(r"\S{1,20}", text[error.pos_in_stream :])
        shown = found[0] if found else ""
        raise _syntax_error(shown, error.allowed or (), error.line, error.column) from None
    except UnexpectedToken as error:
        if error.token.type == "$END":
            raise _syntax_error("", error.expected, *_end(text)) from None
        place = error.token.line or 1, error.token.column or 1
        raise _syntax_error(_first(error.token), error.expected, *place) from None
    return cast("_File", preamble).children, cast("_File", entries).children


def _first(token: Token) -> str:
    """Return the beginning of a token that is a run: the first entry's head, or the first word."""
    if token.type == "ENTRIES":
        return next(of_run(str(token), Token(token.type, str(token), start_pos=0))).head
    words = without_comments(token)
    return words.split()[0] if token.type in ("NAMES", "STATES") else words


def _syntax_error(found: str, expected: Iterable[str], line: int, column: int) -> PomdpFormatError:
    meanings = sorted({_MEANINGS.get(name, f"'{name.lower()}'") for name in expected})
    shown = repr(" ".join(found.split())[:40]) if found else "the end of the file"
    return PomdpFormatError(f"expected {' or '.join(meanings)}, found {shown}", line, column)


def _build(text: str, preamble: list[_Statement], statements: list[_Statement]) -> POMDP:
    """Hand every declaration to the method named after its rule, in order, and put the entries together."""
    declarations = Declarations()
    for declaration in preamble:
        getattr(declarations, declaration.data)(*declaration.children)
    first, end = statements[0].children[0] if statements else None, _end(text)
    declarations.check_complete(*((first.line or 1, first.column or 1) if first else end))
    return assemble(declarations, _entries(text, statements), Limits.of(len(text)), end)


def _entries(text: str, statements: Iterable[_Statement]) -> Iterator[Entry]:
    for statement in statements:
        if statement.data == "run":
            yield from of_run(text, statement.children[0])
        else:
            yield of_rule(text, *statement.children)


def _end(text: str) -> tuple[int, int]:
    """Return the line and column of the end of a text, both from 1."""
    return text.count("\n") + 1, len(text) - text.rfind("\n")
