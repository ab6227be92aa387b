"""What the speed suite stored (``.benchmarks/speed.json``), as tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from bgn.errors import BgnError

#: The authors' code: env-steps/s x seconds of the calibration kernel measured beside it (Hallway: 1,451/s at
#: 183 µs and 1,152/s at 208 µs; RockSample[5,5]: 386/s at 205 µs).
AUTHORS_STEPS_PER_KERNEL = {"hallway/ah-ch+bgn": 0.25, "rocksample-5-5/ah-ch+bgn": 0.079}


class SuiteError(BgnError, RuntimeError):
    """There is no (or no readable) result of the speed suite."""


@dataclass(frozen=True)
class TrainingSpeed:
    """How fast one cell trains, and what the machine could do in the same minute."""

    cell: str
    env_steps_per_cpu_second: float
    gflops: float
    peak_gflops: float
    kernel_microseconds: float

    @property
    def roofline(self) -> float:
        """Necessary arithmetic done over what a large product does in the same time."""
        return self.gflops / self.peak_gflops

    @property
    def steps_per_kernel(self) -> float:
        """Environment steps made while the calibration kernel runs once: a unit that machines share."""
        return self.env_steps_per_cpu_second * self.kernel_microseconds * 1e-6

    @property
    def over_authors(self) -> float | None:
        """How many times the published speed of the authors' code, where there is one."""
        theirs = AUTHORS_STEPS_PER_KERNEL.get(self.cell)
        return None if theirs is None else self.steps_per_kernel / theirs


@dataclass(frozen=True)
class Suite:
    """All results of one run of the suite."""

    machine: Mapping[str, str | int]
    training: Sequence[TrainingSpeed]
    over_baseline: Mapping[str, float]
    """Environment steps a CPU second over the baseline's, side by side, by cell."""
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
        elif entry["group"] == "baseline":
            ratios[extra["cell"]] = extra["ratio"]
        else:
            others[entry["name"]] = entry["stats"]["median"]
    return Suite(machine, training, ratios, others)


def training_table(suite: Suite) -> Table:
    """Lay the training speeds out for the terminal."""
    table = Table(title="Training, one thread, three seeds stacked", title_justify="left")
    table.add_column("cell", no_wrap=True)
    for heading in (
        "env-steps per CPU-second",
        "GFLOP/s",
        "of peak",
        "steps per kernel",
        "x authors'",
        "x baseline",
    ):
        table.add_column(heading, justify="right")
    for row in training_rows(suite):
        table.add_row(*row)
    return table


def training_rows(suite: Suite) -> list[list[str]]:
    """Return the training speeds as text, in the columns of :func:`training_table`."""
    rows = []
    for speed in suite.training:
        baseline = suite.over_baseline.get(speed.cell)
        rows.append(
            [
                speed.cell,
                f"{speed.env_steps_per_cpu_second:,.0f}",
                f"{speed.gflops:.1f}",
                f"{speed.roofline:.2f}",
                f"{speed.steps_per_kernel:.2f}",
                "" if speed.over_authors is None else f"{speed.over_authors:.1f}",
                "" if baseline is None else f"{baseline:.1f}",
            ]
        )
    return rows
