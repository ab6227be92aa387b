"""The command line: ``python -m benchmarks run | status | tables``."""

from __future__ import annotations

import argparse
import contextlib
import os
import pathlib
import sys
from collections.abc import Sequence

from rich.console import Console

from benchmarks import local_executor, plan, progress, registry, report
from benchmarks.plan import Selection, State
from benchmarks.registry import Registry, RegistryError
from benchmarks.tasks import Tools
from bgn.domains import UnknownDomainError
from bgn.results.store import StoreError

_FAILED, _USAGE, _INTERRUPTED = 1, 2, 130
_PLAIN_WIDTH = 160  # where the output is no terminal, tables are not squeezed


def main(arguments: Sequence[str] | None = None, *, tools: Tools = Tools()) -> int:  # noqa: B008
    """Run a command; return its exit status."""
    console = Console() if sys.stdout.isatty() else Console(width=_PLAIN_WIDTH)
    try:
        benchmark = registry.load()
        options = _parser(benchmark).parse_args(arguments)
        selection = _select(benchmark, options)
        if options.command == "run":
            return _run(selection, options, tools, console)
        return _show(selection, options, console)
    except (RegistryError, StoreError, UnknownDomainError) as error:
        print(f"error: {error}", file=sys.stderr)
        return _USAGE
    except KeyboardInterrupt:
        print("interrupted; the same command goes on where this one stopped", file=sys.stderr)
        return _INTERRUPTED


def _run(selection: Selection, options: argparse.Namespace, tools: Tools, console: Console) -> int:
    store = selection.store(options.results)
    wanted = selection.wanted()
    with store.lock():
        lacking = [s.wanted for s in plan.statuses(wanted, store) if s.state is not State.CURRENT]
        tasks = selection.tasks(lacking, store, options.device)
        done = len(wanted) - len(lacking)
        console.print(f"{done} of {len(wanted)} runs and reference rows are done.", highlight=False)
        if tasks:
            events = local_executor.run_tasks(tasks, jobs=options.jobs, tools=tools)
            with progress.display(tasks, console) as display, contextlib.closing(events):
                for event in events:
                    display.note(event)
    statuses = plan.statuses(wanted, store)
    report.show_tables(selection, statuses, store, console)
    if all(status.state is State.CURRENT for status in statuses):
        return 0
    report.show_missing(statuses, console)
    return _FAILED


def _show(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    store = selection.store(options.results)
    statuses = plan.statuses(selection.wanted(), store)
    if options.command == "tables":
        report.show_tables(selection, statuses, store, console)
    else:
        report.show_status(selection, statuses, console)
    return 0


def _select(benchmark: Registry, options: argparse.Namespace) -> Selection:
    budget = benchmark.budget(options.budget)
    benchmark.select("preset", [options.preset])
    only_agents, only_references = options.agent is not None, options.reference is not None
    return Selection(
        registry=benchmark,
        budget=options.budget,
        preset=options.preset,
        domains=benchmark.select("domain", options.domain),
        agents=() if only_references and not only_agents else benchmark.select("agent", options.agent),
        references=(
            () if only_agents and not only_references else benchmark.select("reference", options.reference)
        ),
        seeds=options.seeds or tuple(range(budget.seeds)),
    )


def _parser(benchmark: Registry) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="compute what is missing, then print the tables")
    status = commands.add_parser("status", help="say which runs are done, older, failed or missing")
    tables = commands.add_parser("tables", help="print and write the tables of what is stored")
    for command in (run, status, tables):
        _add_selection(command, benchmark)
    run.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to train (default: cpu)")
    run.add_argument(
        "--jobs",
        type=_positive,
        default=len(os.sched_getaffinity(0)),
        help="cells side by side (default: cores)",
    )
    return parser


def _add_selection(command: argparse.ArgumentParser, benchmark: Registry) -> None:
    defaults = benchmark.defaults
    known = {kind: ", ".join(getattr(benchmark, kind + "s")) for kind in ("domain", "agent", "reference")}
    command.add_argument(
        "--budget",
        default=defaults.budget,
        help=f"{', '.join(benchmark.budgets)} (default: {defaults.budget})",
    )
    command.add_argument(
        "--preset",
        default=defaults.preset,
        help=f"{', '.join(benchmark.presets)} (default: {defaults.preset})",
    )
    for kind in ("domain", "agent", "reference"):
        command.add_argument(
            f"--{kind}", nargs="+", metavar=kind.upper(), help=f"only these of {known[kind]}"
        )
    command.add_argument("--seeds", type=parse_seeds, help="such as 0-9 or 0,2,5-7 (default: the budget's)")
    command.add_argument(
        "--results",
        type=pathlib.Path,
        default=pathlib.Path("results/local"),
        help="folder of the store (default: results/local; published results are in results/published)",
    )


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read a list of seeds and ranges such as ``0,2,5-7``."""
    seeds: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or (dash and int(last) < int(first)):
            raise argparse.ArgumentTypeError(f"{part!r} is no seed or rising range; write 0-9 or 0,2,5-7")
        seeds.update(range(int(first), int(last or first) + 1))
    return tuple(sorted(seeds))


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
