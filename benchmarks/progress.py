"""Shows what the workers are doing: live bars in a terminal, plain lines anywhere else."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.events import Advanced, Event, Finished, Restarted, Started
from benchmarks.tasks import CellTask, Task

Runs = tuple[str, ...]
"""What tells tasks apart: the ids of their runs."""

_SECONDS_BETWEEN_LINES = 30.0


class Display(Protocol):
    """Takes note of events; used as a context manager."""

    def __enter__(self) -> Display:
        """Begin to show."""

    def __exit__(self, *exception: object) -> None:
        """Stop showing."""

    def note(self, event: Event) -> None:
        """Show what an event changes."""


def display(tasks: Sequence[Task], console: Console) -> Display:
    """Return the display that suits the console."""
    return _Bars(tasks, console) if console.is_terminal else _Lines(tasks, console)


class _Ledger:
    """Counts work done, over all tasks, in the unit of their estimated cost."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self.tasks = tasks
        self.total = sum(task.cost for task in tasks)
        self.runs = sum(len(task.runs) for task in tasks)
        self.names = Counter(task.name for task in tasks)
        self.fractions: dict[Runs, float] = {}
        self.rates: dict[Runs, float] = {}
        self.finished = self.failed = self.finished_runs = 0
        self.started = time.monotonic()

    def note(self, event: Event) -> None:
        runs = event.task.runs
        if isinstance(event, Advanced):
            self.fractions[runs] = event.progress.env_steps / event.progress.total_env_steps
            self.rates[runs] = event.progress.steps_per_second
        elif isinstance(event, Finished):
            self.fractions[runs] = 1.0
            self.rates.pop(runs, None)
            self.finished += 1
            self.finished_runs += len(event.task.runs)
            self.failed += len(event.task.runs) if event.failure else 0

    def label(self, task: Task) -> str:
        """Return what a task is called: its cell or row, with its seeds where tasks share a cell."""
        if self.names[task.name] == 1 or not isinstance(task, CellTask):
            return task.name
        return f"{task.name} (seed{'s' if len(task.seeds) > 1 else ''} {', '.join(map(str, task.seeds))})"

    def describe(self, event: Restarted | Finished) -> str:
        """Say how a task ended, or begins again, in a line."""
        label = self.label(event.task)
        if isinstance(event, Restarted):
            return f"again  {label}: {event.reason}"
        if event.failure:
            return f"FAILED {label}: {event.failure.error}"
        runs = len(event.task.runs)
        return f"done   {label} ({runs} run{'s' if runs > 1 else ''})"

    @property
    def done(self) -> float:
        """Cost of what is done."""
        return sum(task.cost * self.fractions.get(task.runs, 0.0) for task in self.tasks)

    def summary(self) -> str:
        """Say how far everything is."""
        failed = f", {self.failed} failed" if self.failed else ""
        rate = f", {sum(self.rates.values()):,.0f} steps/s" if self.rates else ""
        return (
            f"{self.finished}/{len(self.tasks)} cells and rows, {self.finished_runs}/{self.runs} runs"
            f"{failed}{rate}"
        )

    def remaining_seconds(self) -> float | None:
        """Estimate the time left from the pace so far."""
        if not self.done:
            return None
        return (time.monotonic() - self.started) * (self.total - self.done) / self.done


class _Bars:
    """One bar for everything, one for each running task."""

    def __init__(self, tasks: Sequence[Task], console: Console) -> None:
        self._ledger = _Ledger(tasks)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            TextColumn("{task.fields[note]}"),
            console=console,
            speed_estimate_period=600,
        )
        self._all = self._bars.add_task("all", total=self._ledger.total, note="")
        self._running: dict[Runs, TaskID] = {}

    def __enter__(self) -> _Bars:
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

    def note(self, event: Event) -> None:
        self._ledger.note(event)
        runs = event.task.runs
        if isinstance(event, Started):
            self._running[runs] = self._bars.add_task(self._ledger.label(event.task), total=None, note="")
        elif isinstance(event, Advanced):
            progress = event.progress
            note = f"{progress.steps_per_second:,.0f} steps/s, return {progress.return_100:.2f}"
            self._bars.update(
                self._running[runs],
                total=progress.total_env_steps,
                completed=progress.env_steps,
                note=note if progress.stage == "train" else "evaluating",
            )
        else:
            if isinstance(event, Finished):
                self._bars.remove_task(self._running.pop(runs))
            self._bars.console.print(self._ledger.describe(event), highlight=False, markup=False)
        self._bars.update(self._all, completed=self._ledger.done, note=self._ledger.summary())


class _Lines:
    """A line when a task ends, and one now and then in between."""

    def __init__(self, tasks: Sequence[Task], console: Console) -> None:
        self._ledger = _Ledger(tasks)
        self._console = console
        self._last = time.monotonic()

    def __enter__(self) -> _Lines:
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def note(self, event: Event) -> None:
        self._ledger.note(event)
        if isinstance(event, Finished | Restarted):
            self._print(self._ledger.describe(event) + " | ")
        elif time.monotonic() - self._last >= _SECONDS_BETWEEN_LINES:
            self._print("")

    def _print(self, prefix: str) -> None:
        left = self._ledger.remaining_seconds()
        estimate = f", about {left / 60:.0f} min left" if left else ""
        line = prefix + self._ledger.summary() + estimate
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)
        self._last = time.monotonic()
