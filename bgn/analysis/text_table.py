"""A printed table: rows of text with notes below, for the terminal and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Group
from rich.table import Table
from rich.text import Text

BLANK = "–"


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

    def rich(self) -> Group:
        """Return the table for a rich console."""
        table = Table(title=self.title, title_justify="left", title_style="bold", pad_edge=False)
        for number, column in enumerate(self.columns):
            label = number < self.labels
            table.add_column(Text(column), justify="left" if label else "right", no_wrap=not label)
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
