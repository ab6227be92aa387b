"""What the speed suite stored (``.benchmarks/speed.json``), as tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from bgn.errors import BgnError


class SuiteError(BgnError, RuntimeError):
    """There is no (or no readable) result of the speed suite."""


@dataclass(frozen=True)
class TrainingSpeed:
    """How fast one cell trains, and what the machine could do in the same minute."""

    cell: str
    env_steps_per_cpu_second: float
    gflops: float
    peak_gflops: float

    @property
    def roofline(self) -> float:
        """Necessary arithmetic done over what a large product does in the same time."""
        return self.gflops / self.peak_gflops


@dataclass(frozen=True)
class Suite:
    """All results of one run of the suite."""

    machine: Mapping[str, str | int]
    training: Sequence[TrainingSpeed]
    over_plain: Mapping[str, float]
    """Environment steps per CPU second over the plain learner's, side by side, by cell."""
    others: Mapping[str, float]
    """Median seconds of one call of everything else, by name."""


def load(path: Path) -> Suite:
    """Read what ``nox -s speed`` wrote.

    Raises
    ------
    SuiteError
        No such file, or not one of the suite's.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return _suite(content)
    except OSError as error:
        raise SuiteError(f"{path}: {error.strerror}; `nox -s speed` writes it") from error
    except (ValueError, KeyError, TypeError) as error:
        raise SuiteError(f"{path} is not a result of the speed suite: {error!r}") from error


def _suite(content: Mapping[str, Any]) -> Suite:
    training, ratios, others = [], {}, {}
    machine: Mapping[str, str | int] = {}
    for entry in content["benchmarks"]:
        extra = entry["extra_info"]
        if entry["group"] == "training":
            machine = extra["machine"]
            training.append(TrainingSpeed(**extra["speed"]))
        elif entry["group"] == "plain":
            ratios[extra["cell"]] = extra["ratio"]
        else:
            others[entry["name"]] = entry["stats"]["median"]
    return Suite(machine, training, ratios, others)


def training_table(suite: Suite) -> Table:
    """Lay the training speeds out for the terminal."""
    table = Table(title="Training, one thread, three seeds stacked", title_justify="left")
    table.add_column("cell", no_wrap=True)
    for heading in ("env-steps per CPU-second", "GFLOP/s", "of peak", "x plain"):
        table.add_column(heading, justify="right")
    for row in training_rows(suite):
        table.add_row(*row)
    return table


def training_rows(suite: Suite) -> list[list[str]]:
    """Return the training speeds as text, in the columns of :func:`training_table`."""
    rows = []
    for speed in suite.training:
        ratio = suite.over_plain.get(speed.cell)
        rows.append(
            [
                speed.cell,
                f"{speed.env_steps_per_cpu_second:,.0f}",
                f"{speed.gflops:.1f}",
                f"{speed.roofline:.2f}",
                "" if ratio is None else f"{ratio:.1f}",
            ]
        )
    return rows
