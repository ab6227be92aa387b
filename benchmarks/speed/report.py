"""Measures what ``docs/performance.md`` states and writes it there, between its markers.

A marked block is what lies between ``<!-- measured: NAME -->`` and ``<!-- end -->``.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks import registry
from benchmarks.speed import growth, machine
from benchmarks.speed.arithmetic import multiply_adds
from benchmarks.speed.profiles import launches, shares
from benchmarks.speed.suite import Suite, SuiteError, training_rows
from benchmarks.speed.workloads import Training
from bgn import domains
from bgn.agents.specs import AGENTS
from bgn.results.run_ids import CellId

DOCUMENT = Path(__file__).parents[2] / "docs" / "performance.md"
FIGURE = "performance-growth.png"
BUDGET, PRESET = "paper", "authors-code"
PROFILED = ("hallway/ah-ch+bgn", "rocksample-5-5/ah-ch+bgn")


def write(suite: Suite, document: Path = DOCUMENT) -> list[Path]:
    """Fill in the document's blocks and draw its figure; returns the files written.

    Raises
    ------
    SuiteError
        The suite did not measure every cell, or the document lacks a block.
    """
    missing = {f"{d}/{a}" for d, a in _cells()} - {speed.cell for speed in suite.training}
    if missing:
        raise SuiteError(f"the suite lacks {', '.join(sorted(missing))}; `nox -s speed` measures all cells")
    text = document.read_text(encoding="utf-8")
    blocks = {
        "machine": _machine(suite),
        "training": _table(
            ("cell", "env-steps/CPU-s", "GFLOP/s", "of peak", "x plain"),
            training_rows(suite),
        ),
        "profile": _profile(),
        "floors": _floors(),
        "cost": _cost(suite),
        "gpu": _gpu(),
        "others": _table(("what", "ms"), [(k, f"{v * 1e3:.3g}") for k, v in suite.others.items()]),
    }
    for name, block in blocks.items():
        text = fill(text, name, block)
    figure = document.with_name(FIGURE)
    growth.draw([growth.by_states(), growth.by_seeds(), growth.by_lanes()], figure)
    document.write_text(text, encoding="utf-8")
    return [document, figure]


def fill(text: str, name: str, block: str) -> str:
    """Replace one marked block of a document.

    Raises
    ------
    SuiteError
        The document has no such block.
    """
    pattern = re.compile(rf"(<!-- measured: {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not pattern.search(text):
        raise SuiteError(f"the document has no block <!-- measured: {name} --> … <!-- end -->")
    return pattern.sub(lambda match: f"{match[1]}{block}\n{match[2]}", text)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(headings)} |", f"|---{'|---:' * (len(headings) - 1)}|"]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines)


def _machine(suite: Suite) -> str:
    what = suite.machine
    day = datetime.datetime.now(datetime.UTC).date()
    peaks = [speed.peak_gflops for speed in suite.training]
    return (
        f"Measured on {day}: {what['processor']}, {what['cores']} cores, one thread, torch {what['torch']}. "
        f"The large product ran at {min(peaks):.0f} to {max(peaks):.0f} GFLOP/s during the suite."
    )


def _profile() -> str:
    rows = []
    for cell in PROFILED:
        named = CellId.parse(cell)
        training = Training.of_cell(named.domain, named.agent)
        for share in shares(training):
            rows.append((cell, share.what, f"{share.fraction:.0%}", f"{share.calls:.0f}"))
            cell = ""
    return _table(("cell", "operators", "of operator time", "calls an update"), rows)


def _floors() -> str:
    peak = machine.peak_flops()
    rows = []
    for domain_id, agent_id in _cells():
        needed = _multiply_adds(domain_id, agent_id)
        floor = 2 * needed / peak
        rows.append(
            (f"{domain_id}/{agent_id}", f"{needed / 1e6:.2f}", f"{floor * 1e6:.0f}", f"{1 / floor:,.0f}")
        )
    headings = ("cell", "million multiply-adds per env-step", "µs at peak", "env-steps/CPU-s at peak")
    return _table(headings, rows)


def _cost(suite: Suite) -> str:
    """Cost of one run, and of all, at the paper budget: time as measured, arithmetic as counted."""
    budget = registry.load().budget(BUDGET)
    rates = {speed.cell: speed.env_steps_per_cpu_second for speed in suite.training}
    rows, hours, flop = [], 0.0, 0.0
    for domain_id, steps in budget.env_steps.items():
        cells = [f"{domain_id}/{agent}" for agent in AGENTS]
        each = [steps / rates[cell] / 3600 for cell in cells]
        work = [2 * steps * _multiply_adds(domain_id, agent) for agent in AGENTS]
        hours, flop = hours + budget.seeds * sum(each), flop + budget.seeds * sum(work)
        total = f"{budget.seeds * sum(each):.1f}"
        rows.append((domain_id, f"{steps / 1e6:g}", f"{min(each):.2f} to {max(each):.2f}", total))
    rows.append(("all", "", "", f"{hours:.0f}"))
    table = _table(
        (
            "domain",
            "million env-steps a run",
            "core-hours a run",
            f"core-hours, {budget.seeds} seeds, 6 agents",
        ),
        rows,
    )
    return f"{table}\n\nNecessary products of all runs together: {flop / 1e15:.1f} PFLOP."


def _gpu() -> str:
    """Kernels, bytes and arithmetic of one update of ten seeds."""
    budget, rows = registry.load().budget(BUDGET), []
    for domain_id, agent_id in _cells():
        settings = registry.load().presets[PRESET].hyperparameters(domain_id)
        training = Training(domains.get(domain_id), agent_id, settings, seeds=tuple(range(budget.seeds)))
        asked = launches(training)
        flop = 2 * asked.multiply_adds / 1e9
        rows.append((f"{domain_id}/{agent_id}", str(asked.kernels), f"{asked.megabytes:.0f}", f"{flop:.1f}"))
    return _table(("cell, 10 seeds", "kernels per update", "MB touched", "GFLOP"), rows)


def _cells() -> list[tuple[str, str]]:
    return [(domain, agent) for domain in registry.load().domains for agent in AGENTS]


def _multiply_adds(domain_id: str, agent_id: str) -> float:
    settings = registry.load().presets[PRESET].hyperparameters(domain_id)
    return multiply_adds(AGENTS[agent_id], domains.get(domain_id), settings)
