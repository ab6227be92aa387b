"""Compares fresh runs with stored ones: ``python -m benchmarks.regression [--against DIR] [--domain …] [--agent …]``.

Trains a few fresh seeds of each cell with the present code, in a temporary folder, and asks whether they are worse
than the stored reference (docs/regression.md). Nothing is written to the results. Exit status: 0 fine, 1 regressed,
2 could not tell, or wrong usage.
"""

from __future__ import annotations

import argparse
import json
import pathlib
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import pandas as pd
from rich.console import Console

from benchmarks import evidence
from benchmarks import registry as registries
from benchmarks.events import Finished
from benchmarks.evidence import StoredEvidence
from benchmarks.executors import processes
from benchmarks.plan import Selection
from benchmarks.registry import Registry
from benchmarks.tasks import Work
from bgn.analysis import cells
from bgn.analysis.regression import FEWEST_REFERENCE_SEEDS, Outcome, Rule, worst
from bgn.analysis.statistics import Sample
from bgn.analysis.text_table import BLANK, TextTable, plus_minus
from bgn.errors import BgnError, InputError

BUDGET = "regress"
#: Seeds that no published run uses; those of the second stage are others than those of the first.
FIRST_SCREENING_SEED, FIRST_CONFIRMING_SEED = 1000, 1100
_EXIT = {Outcome.FINE: 0, Outcome.REGRESSED: 1, Outcome.UNCLEAR: 2}
_WIDTH = 100

Trainer = Callable[[Sequence[tuple[str, str]], Sequence[int]], StoredEvidence]
"""Trains seeds of (domain, agent) cells and returns them read back."""


@dataclass(frozen=True)
class Comparison:
    """One cell, then and now."""

    cell: str
    metric: str
    outcome: str
    why: str
    reference_mean: float
    reference_sd: float
    reference_runs: int
    mean: float
    sd: float
    runs: int
    """Of the stage that decided."""
    difference: float
    p: float
    """Of the second stage; NaN where the first one was enough."""
    cpu_seconds: float


def main(arguments: Sequence[str] | None = None, *, work: Work = Work()) -> int:  # noqa: B008
    """Compare, print and return the exit status."""
    options = _parser().parse_args(arguments)
    console = Console(width=_WIDTH) if not sys.stdout.isatty() else Console()
    try:
        registry = registries.load()
        reference = evidence.load(
            options.against, budget=options.budget, preset=options.preset, registry=registry
        )
        options.preset = reference.preset  # the budget's own, where none was named
        chosen = _chosen(reference, registry, options)
        started = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="bgn-regression-") as folder:
            trainer = _trainer(registry, options, pathlib.Path(folder), work, console)
            found = compare(reference, chosen, trainer, options.rule)
        minutes = (time.monotonic() - started) / 60
    except BgnError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    total = worst([Outcome(one.outcome) for one in found])
    console.print(_table(found, options, minutes).rich())
    console.print(f"Verdict: {total.value}.")
    if options.json:
        content = {"verdict": total.value, "minutes": minutes, "cells": [asdict(one) for one in found]}
        options.json.write_text(json.dumps(content, indent=2).replace("NaN", "null") + "\n", encoding="utf-8")
    return _EXIT[total]


def compare(
    reference: StoredEvidence, chosen: Sequence[tuple[str, str]], train: Trainer, rule: Rule
) -> list[Comparison]:
    """Judge cells by the two stages; the second trains only those that the first finds suspicious."""
    metrics = {domain.id: domain.metric for domain in reference.domains}
    known = {cell: _sample(reference, cell, metrics[cell[0]]) for cell in chosen}
    enough = [cell for cell in chosen if (s := known[cell]) is not None and s.n >= FEWEST_REFERENCE_SEEDS]
    screened = train(enough, _seeds(FIRST_SCREENING_SEED, rule.screening_seeds)) if enough else None
    found = {}
    suspicious = []
    for cell in chosen:
        then = known[cell]
        now = None if screened is None else _sample(screened, cell, metrics[cell[0]])
        outcome, why = Outcome.FINE, "the screen saw no drop"
        if cell not in enough:
            n = 0 if then is None else then.n
            outcome, why = Outcome.UNCLEAR, f"{n} reference runs; {FEWEST_REFERENCE_SEEDS} are needed"
        elif then is None or now is None or now.n < rule.screening_seeds:
            outcome, why = Outcome.UNCLEAR, f"fresh runs failed{_first_error(screened, cell)}"
        elif rule.suspicious(then, now):
            suspicious.append(cell)
        found[cell] = _comparison(cell, metrics[cell[0]], then, now, screened, outcome, why)
    confirmed = (
        train(suspicious, _seeds(FIRST_CONFIRMING_SEED, rule.confirming_seeds)) if suspicious else None
    )
    for cell in suspicious:
        then, now = known[cell], None if confirmed is None else _sample(confirmed, cell, metrics[cell[0]])
        outcome, why, p = Outcome.UNCLEAR, f"fresh runs failed{_first_error(confirmed, cell)}", float("nan")
        if then is not None and now is not None and now.n == rule.confirming_seeds:
            outcome, p = rule.confirm(then, now), rule.p_value(then, now)
            why = f"the screen saw a drop; {rule.confirming_seeds} other seeds: p = {p:.2g}"
        first = found[cell].cpu_seconds
        found[cell] = _comparison(cell, metrics[cell[0]], then, now, confirmed, outcome, why, p, first)
    return list(found.values())


def _seeds(first: int, count: int) -> tuple[int, ...]:
    return tuple(range(first, first + count))


def _trainer(
    registry: Registry, options: argparse.Namespace, folder: pathlib.Path, work: Work, console: Console
) -> Trainer:
    def train(chosen: Sequence[tuple[str, str]], seeds: Sequence[int]) -> StoredEvidence:
        selections = [
            Selection(registry, options.budget, options.preset, (domain,), (agent,), (), tuple(seeds))
            for domain, agent in chosen
        ]
        stage = folder / f"from-{seeds[0]}"
        store = selections[0].store(stage)
        tasks = [task for one in selections for task in one.tasks(one.requests(), store, "cpu")]
        names = ", ".join(task.name for task in tasks)
        console.print(f"Training {len(seeds)} fresh seeds of {names} …", highlight=False)
        for event in processes.run_tasks(tasks, jobs=options.jobs, work=work):
            if isinstance(event, Finished) and event.failure is not None:
                console.print(f"{event.task.name} failed: {event.failure.error}", highlight=False)
        return evidence.gather(registry, options.budget, options.preset, store)

    return train


def _chosen(
    reference: StoredEvidence, registry: Registry, options: argparse.Namespace
) -> list[tuple[str, str]]:
    stored = list(dict.fromkeys(zip(reference.runs["domain"], reference.runs["agent"], strict=True)))
    wanted_domains = registry.select("domain", options.domain)
    wanted_agents = registry.select("agent", options.agent)
    chosen = [(str(d), str(a)) for d, a in stored if d in wanted_domains and a in wanted_agents]
    if not options.all and options.domain is None and options.agent is None:
        chosen = _default(reference, chosen)
    if not chosen:
        have = ", ".join(f"{domain}/{agent}" for domain, agent in stored)
        raise InputError(f"no stored cell is among those asked for; stored at {options.budget}: {have}")
    return chosen


def _default(reference: StoredEvidence, chosen: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return one classic and one robot cell: the grounded history agent's where it is stored."""
    families = {domain.id: domain.family for domain in reference.domains}
    found: dict[str, tuple[str, str]] = {}
    for cell in sorted(chosen, key=lambda cell: cell[1] != cells.GROUNDED):
        found.setdefault(families[cell[0]], cell)
    return list(found.values())


def _sample(found: StoredEvidence, cell: tuple[str, str], metric: str) -> Sample | None:
    runs = _runs(found, cell)
    return cells.sample(runs, metric) if len(runs) else None


def _runs(found: StoredEvidence, cell: tuple[str, str]) -> pd.DataFrame:
    return found.runs[(found.runs["domain"] == cell[0]) & (found.runs["agent"] == cell[1])]


def _first_error(found: StoredEvidence | None, cell: tuple[str, str]) -> str:
    if found is None:
        return ""
    rows = found.store.read("runs")
    if rows.empty:
        return ""
    failed = rows[(rows["domain"] == cell[0]) & (rows["agent"] == cell[1]) & (rows["status"] != "ok")]
    return f": {failed['error'].iloc[0]}" if len(failed) else ""


def _comparison(
    cell: tuple[str, str],
    metric: str,
    then: Sample | None,
    now: Sample | None,
    fresh: StoredEvidence | None,
    outcome: Outcome,
    why: str,
    p: float = float("nan"),
    seconds_before: float = 0.0,
) -> Comparison:
    missing = Sample(float("nan"), float("nan"), 0)
    before, after = then or missing, now or missing
    seconds = 0.0 if fresh is None or now is None else float(_runs(fresh, cell)["cpu_seconds"].sum())
    return Comparison(
        cell="/".join(cell),
        metric=metric,
        outcome=outcome.value,
        why=why,
        reference_mean=before.mean,
        reference_sd=before.sd,
        reference_runs=before.n,
        mean=after.mean,
        sd=after.sd,
        runs=after.n,
        difference=after.mean - before.mean,
        p=p,
        cpu_seconds=seconds_before + seconds,
    )


def _table(found: Sequence[Comparison], options: argparse.Namespace, minutes: float) -> TextTable:
    rows = [
        [
            one.cell,
            f"{plus_minus(one.reference_mean, one.reference_sd, 3)} ({one.reference_runs})",
            f"{plus_minus(one.mean, one.sd, 3)} ({one.runs})" if one.runs else BLANK,
            f"{one.difference:+.3f}" if one.runs else BLANK,
            f"{one.p:.2g}" if one.p == one.p else BLANK,
            one.outcome,
        ]
        for one in found
    ]
    rule: Rule = options.rule
    notes = [
        f"Against {options.against}, budget {options.budget}, preset {options.preset}; mean ± sd (runs).",
        f"Two stages: {rule.screening_seeds} fresh seeds more than {rule.screening_sds:g} sd below, then "
        f"{rule.confirming_seeds} others at p < {rule.level:g}. {minutes:.1f} minutes in all.",
        *(f"{one.cell}: {one.why}; {one.cpu_seconds:.0f} CPU seconds." for one in found),
    ]
    columns = ["Cell", "Reference", "Now", "Change", "p", "Verdict"]
    return TextTable("Regression", columns, rows, notes, labels=1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.regression", description=__doc__)
    parser.add_argument(
        "--against", type=pathlib.Path, default=pathlib.Path("results/published"), metavar="DIR"
    )
    parser.add_argument("--budget", default=BUDGET, help=f"of the reference (default: {BUDGET})")
    parser.add_argument("--preset", help="of the reference (default: the budget's own)")
    parser.add_argument("--domain", nargs="+", help="only cells of these")
    parser.add_argument("--agent", nargs="+", help="only cells of these")
    parser.add_argument(
        "--all", action="store_true", help="every cell that is stored (default: one of each family)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="cells side by side (default: 2)")
    parser.add_argument("--json", type=pathlib.Path, help="also write what was found to this file")
    parser.set_defaults(rule=Rule())
    return parser


if __name__ == "__main__":
    sys.exit(main())
