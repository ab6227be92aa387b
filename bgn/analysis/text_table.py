"""A printed table: rows of text with notes below, for the terminal, as Markdown, CSV, HTML and LaTeX."""

from __future__ import annotations

import csv
import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from rich import box
from rich.console import Group, JustifyMethod
from rich.table import Table
from rich.text import Text

BLANK = "–"
_BETWEEN, _EDGES = 3, 2  # characters between two columns of a rich table, and at its ends
_SHORT_TITLE, _SHORT_LABEL = 26, 10


@dataclass(frozen=True)
class TextTable:
    """A table of texts. A row whose first text is empty continues the row above."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()
    labels: int = 2
    """How many columns at the left are words; the others are numbers."""

    def markdown(self) -> str:
        """Return the table as GitHub Markdown."""
        lines = [_line(self.columns), _line(["---"] * len(self.columns))]
        lines += [_line(row) for row in self.rows]
        notes = [f"- {note}" for note in self.notes]
        return "\n".join([f"## {self.title}", "", *lines, *([""] if notes else []), *notes, ""])

    def csv(self, source: Mapping[str, str] = MappingProxyType({})) -> str:
        """Return the table as comma-separated values: no title, no notes, every row with its first text.

        ``source`` says where the values come from: columns at the left, by name.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*source, *self.columns])
        first = ""
        for row in self.rows:
            first = row[0] or first
            writer.writerow([*source.values(), first, *row[1:]])
        return text.getvalue()

    def html(self) -> str:
        """Return the table as HTML."""
        head = "".join(f"<th>{html.escape(column)}</th>" for column in self.columns)
        body = [_html_row(row, self.labels) for row in self.rows]
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return "\n".join(
            [
                f"<h2>{html.escape(self.title)}</h2>",
                f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>",
                *body,
                "</tbody>\n</table>",
                *([f"<ul>{notes}</ul>"] if notes else []),
                "",
            ]
        )

    def latex(self) -> str:
        """Return the table as LaTeX, for the booktabs package."""
        form = "l" * self.labels + "r" * (len(self.columns) - self.labels)
        lines = [rf"\begin{{tabular}}{{{form}}}", r"\toprule", _latex_row(self.columns), r"\midrule"]
        for number, row in enumerate(self.rows):
            if number and row[0]:
                lines.append(r"\addlinespace")
            lines.append(_latex_row(row))
        lines += [r"\bottomrule", r"\end{tabular}", ""]
        return "\n".join([f"% {self.title}", *lines, *(f"% {note}" for note in self.notes), ""])

    @property
    def narrowest(self) -> int:
        """Least number of characters in which :meth:`rich` shows numbers and short titles whole and breaks no word."""
        columns = list(zip(self.columns, *self.rows, strict=True))
        whole = [max(map(len, texts)) for texts in columns]
        words = [max(len(word) for text in texts for word in ["", *text.split()]) for texts in columns]
        least = [words[i] if self._wraps(i) else whole[i] for i in range(len(columns))]
        return sum(least) + _BETWEEN * (len(columns) - 1) + _EDGES

    def _wraps(self, column: int) -> bool:
        """Say whether a column may be broken into lines: labels may that are not short."""
        longest = max(len(line[column]) for line in (self.columns, *self.rows))
        return column < self.labels and longest > (_SHORT_LABEL if column else _SHORT_TITLE)

    def rich(self) -> Group:
        """Return the table for a rich console."""
        table = Table(
            title=self.title, title_justify="left", title_style="bold", pad_edge=False, box=box.HORIZONTALS
        )
        for number, column in enumerate(self.columns):
            justify: JustifyMethod = "left" if number < self.labels else "right"
            table.add_column(Text(column), justify=justify, no_wrap=not self._wraps(number))
        grouped = any(not row[0] for row in self.rows)
        for number, row in enumerate(self.rows):
            last = number + 1 == len(self.rows) or bool(self.rows[number + 1][0])
            table.add_row(*(Text(cell) for cell in row), end_section=grouped and last)
        return Group(table, *(Text(f"- {note}", style="dim") for note in self.notes), Text())


def plus_minus(mean: float | None, spread: float | None, digits: int = 2) -> str:
    """Format mean ± spread; a dash where there is no mean, no ± where there is no spread."""
    if mean is None or math.isnan(mean):
        return BLANK
    text = f"{mean:.{digits}f}"
    return text if spread is None or math.isnan(spread) else f"{text}±{spread:.{digits}f}"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _html_row(row: Sequence[str], labels: int) -> str:
    start = ' class="start"' if row[0] else ""
    cells = (
        f"<{tag}>{html.escape(cell)}</{tag}>"
        for tag, cell in zip(["th"] * labels + ["td"] * (len(row) - labels), row, strict=True)
    )
    return f"<tr{start}>{''.join(cells)}</tr>"


_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "#": r"\#",
    "_": r"\_",
    "±": r"$\pm$",
    "≈": r"$\approx$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "‡": r"$\ddagger$",
    "†": r"$\dagger$",
    "°": r"$^\circ$",
    "β": r"$\beta$",
    "‖": r"$\|$",
    "b̂": r"$\hat b$",
    "–": "--",
    "…": r"\ldots{}",
    "§": r"\S",
}


def _latex_row(row: Sequence[str]) -> str:
    cells = list(row)
    for plain, command in _LATEX.items():
        cells = [cell.replace(plain, command) for cell in cells]
    return " & ".join(cells) + r" \\"
