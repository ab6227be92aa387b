"""Regular expressions of the .pomdp file format: what stands in a file by the thousand is one token a run.

A token costs microseconds and hundreds of bytes. Runs of numbers, of names and of well-formed entries are
therefore matched in one stroke, and taken apart later: a megabyte is read in a second, whatever it holds.
Everything is possessive (``*+``, ``++``): nothing is ever given back, so that a bad file is refused in linear
time and the matcher keeps no notes of where it could go back to.
"""

from __future__ import annotations

from typing import Final

GAP: Final = r"(?:[ \t\n]++|#[^\n]*+\n)*+"
_END = r"(?![A-Za-z0-9_.+-])"
_WORD = r"[A-Za-z][A-Za-z0-9_-]*+"
_DIGITS = rf"[0-9]++{_END}"
_NUMBER = rf"[+-]?(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?+{_END}"
_NEXT = rf"(?!(?:discount|values|states|actions|observations|start){_END}|[TOR]{GAP}:)"
# Whatever is repeated is atomic (`?>`) too: before 3.11.5 Python repeats possessively only what holds no choice.
_AT = rf"(?>{GAP}:{GAP}(?:{_WORD}|{_DIGITS}|\*))"


def _run(item: str, start: str = "") -> str:
    return rf"{item}(?:(?>{GAP}{start}{item}))*+"


NUMBERS: Final = _run(_NUMBER)
NAMES: Final = _run(_WORD, _NEXT)
"""Names up to the next declaration or entry."""
STATES: Final = _run(rf"(?:{_WORD}|{_DIGITS})", _NEXT)
"""Names and indices up to the next declaration or entry."""

_ENTRY = "|".join(
    (
        rf"[TO](?:{_AT}){{3}}{GAP}{NUMBERS}",
        rf"T(?:{_AT}){{2}}{GAP}(?:{NUMBERS}|(?:uniform|reset){_END})",
        rf"T{_AT}{GAP}(?:{NUMBERS}|(?:uniform|identity){_END})",
        rf"O(?:{_AT}){{1,2}}+{GAP}(?:{NUMBERS}|uniform{_END})",
        rf"R(?:{_AT}){{2,4}}+{GAP}{NUMBERS}",
    )
)
ENTRIES: Final = _run(rf"(?:{_ENTRY})(?={GAP}(?:[TOR]{GAP}:|\Z))")
"""Well-formed entries, each before another one or the end of the file.

All others are left to the rules of the grammar, which say what is wrong with them.
"""

PARTS: Final = rf"{GAP}(?P<head>[TOR](?:{_AT})++){GAP}(?P<body>{NUMBERS}|[a-z]++)"
"""One of ENTRIES, as its two parts."""
