"""Measures the working tree against a git revision: both in processes of their own, turn by turn.

A machine's speed drifts by factors within hours, so only ratios of calls made right after one another count;
a workload's verdict is the median of such ratios.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.table import Table

from benchmarks.revisions import ROOT, RevisionError, ask_git, checked_out, resolve
from bgn.errors import BgnError

WORKLOADS = Path(__file__).with_name("workloads.py")
#: A slowdown beyond this factor fails; ratios of single turns vary by ten per cent or two.
THRESHOLD = 1.25
ROUNDS = 15
MAIN = "main"


class CompareError(BgnError, RuntimeError):
    """There is nothing to compare with; the message says why."""


@dataclass(frozen=True)
class Comparison:
    """One workload on both sides."""

    name: str
    ratios: tuple[float, ...] = ()
    """Seconds now over seconds then, one a round."""
    seconds: float = float("nan")
    """Median CPU seconds of one call now."""
    error: str = ""
    """Why it could not be measured on both sides; empty if it was."""

    @property
    def ratio(self) -> float:
        """Median of the ratios: above one is slower than before."""
        return median(self.ratios)

    def summary(self) -> str:
        """Return one line for a log."""
        return f"{self.name}: {self.error or f'{self.ratio:.2f} of the time it took'}"

    @property
    def slower(self) -> bool:
        """Whether it slowed down beyond the threshold."""
        return not self.error and self.ratio > THRESHOLD


class Side:
    """A process that runs the workloads against one revision's code."""

    def __init__(self, label: str, code: Path) -> None:
        self.label = label
        threads = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(WORKLOADS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=code,
            env={**os.environ, **threads, "PYTHONPATH": str(code)},
        )

    def seconds(self, name: str) -> float:
        """CPU seconds of one call; the first call of a name also sets it up, unmeasured.

        Raises
        ------
        CompareError
            The workload does not run on this side's code.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(name + "\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise CompareError(f"the workloads do not start on {self.label}")
        result = json.loads(answer)
        if "error" in result:
            raise CompareError(f"{self.label}: {result['error']}")
        return float(result["seconds"])

    def stop(self) -> None:
        """End the process."""
        with contextlib.suppress(BrokenPipeError):
            self.process.communicate()


def measure(name: str, now: Callable[[str], float], then: Callable[[str], float], rounds: int) -> Comparison:
    """Call both sides by turns, swapping who goes first."""
    pairs = []
    try:
        for i in range(rounds):
            first, second = (now, then) if i % 2 == 0 else (then, now)
            a, b = first(name), second(name)
            pairs.append((a, b) if i % 2 == 0 else (b, a))
    except CompareError as error:
        return Comparison(name, error=str(error))
    ratios = tuple(ours / theirs for ours, theirs in pairs)
    return Comparison(name, ratios, median(ours for ours, _ in pairs))


def compare(revision: str | None, names: Sequence[str], rounds: int = ROUNDS) -> Iterator[Comparison]:
    """Yield each workload's comparison with ``revision`` (default: :func:`default_revision`).

    Raises
    ------
    RevisionError
        This is not a git repository, or there is no such revision.
    """
    commit = resolve(revision or default_revision())
    with checked_out(commit) as code:
        now, then = Side("the working tree", ROOT), Side(commit[:10], code)
        try:
            for name in names:
                yield measure(name, now.seconds, then.seconds, rounds)
        finally:
            now.stop()
            then.stop()


def default_revision(root: Path = ROOT) -> str:
    """Return where this branch left main; on main itself, the commit before."""
    try:
        base, head = ask_git(root, "merge-base", "HEAD", MAIN), ask_git(root, "rev-parse", "HEAD")
    except RevisionError:
        return "HEAD~1"
    return "HEAD~1" if base == head else base


def table(revision: str, comparisons: Sequence[Comparison]) -> Table:
    """Lay the comparisons out for the terminal."""
    result = Table(title=f"Working tree against {revision}, turn by turn, one thread", title_justify="left")
    result.add_column("workload", no_wrap=True)
    for heading in ("ms now", "now / then", "quartiles"):
        result.add_column(heading, justify="right")
    result.add_column("verdict")
    for row in comparisons:
        if row.error:
            result.add_row(row.name, "", "", "", f"not compared: {row.error}", style="yellow")
            continue
        ordered = sorted(row.ratios)
        low, high = ordered[len(ordered) // 4], ordered[-1 - len(ordered) // 4]
        verdict = "slower" if row.slower else "faster" if row.ratio < 1 / THRESHOLD else "same"
        style = {"slower": "bold red", "faster": "green", "same": ""}[verdict]
        result.add_row(
            row.name,
            f"{row.seconds * 1e3:.2f}",
            f"{row.ratio:.2f}",
            f"{low:.2f} to {high:.2f}",
            verdict,
            style=style,
        )
    return result
