"""The command line: ``python -m benchmarks run | status | tables | measure``."""

from __future__ import annotations

import argparse
import contextlib
import os
import pathlib
import sys
from collections.abc import Generator, Mapping, Sequence

from rich.console import Console

from benchmarks import adoption, plan, progress, registry, report
from benchmarks.events import Event
from benchmarks.executors import processes, streams
from benchmarks.plan import Selection, State
from benchmarks.registry import Registry, RegistryError
from benchmarks.tasks import CellTask, ReferenceTask, Task, Work
from bgn.domains import UnknownDomainError
from bgn.errors import BgnError
from bgn.results.store import StoreError

_FAILED, _USAGE, _INTERRUPTED = 1, 2, 130
_FORMS: Mapping[str, report.Form] = {"md": "markdown", "csv": "csv", "html": "html", "latex": "latex"}


class DeviceError(BgnError, RuntimeError):
    """The device that was asked for is not there."""


def main(arguments: Sequence[str] | None = None, *, work: Work = Work()) -> int:  # noqa: B008
    """Run a command; return its exit status."""
    console = Console() if sys.stdout.isatty() else Console(width=report.TABLE_WIDTH)
    try:
        benchmark = registry.load(_registry_path(arguments))
        options = _parser(benchmark).parse_args(arguments)
        selection = _select(benchmark, options)
        if options.command == "run":
            _check_device(options.device)
            return _run(selection, options, work, console)
        show = {"status": _show_status, "tables": _show_tables, "measure": _measure}[options.command]
        return show(selection, options, console)
    except (RegistryError, StoreError, UnknownDomainError, DeviceError) as error:
        print(f"error: {error}", file=sys.stderr)
        return _USAGE
    except KeyboardInterrupt:
        print("interrupted; the same command goes on where this one stopped", file=sys.stderr)
        return _INTERRUPTED


def _run(selection: Selection, options: argparse.Namespace, work: Work, console: Console) -> int:
    store = selection.store(options.results)
    requests = selection.requests()
    with store.lock():
        missing = [s.request for s in plan.statuses(requests, store) if s.state is not State.CURRENT]
        adopted = adoption.adopt(missing, store, options.results)
        missing = [request for request in missing if request not in adopted]
        tasks = selection.tasks(missing, store, options.device)
        done = len(requests) - len(missing)
        console.print(f"{done} of {len(requests)} runs and reference rows are done.", highlight=False)
        if tasks:
            events = _execute(tasks, options, work)
            with progress.display(tasks, console) as display, contextlib.closing(events):
                for event in events:
                    display.note(event)
    statuses = plan.statuses(requests, store)
    report.show_tables(selection, store, console)
    if all(status.state is State.CURRENT for status in statuses):
        return 0
    report.show_missing(statuses, console)
    return _FAILED


def _check_device(device: str) -> None:
    if device == "cpu":
        return
    import torch  # imported here because it takes seconds, and only workers need it otherwise

    if not torch.cuda.is_available():
        build = torch.version.cuda or "none, this is a build for the CPU"
        raise DeviceError(
            f"--device cuda: torch {torch.__version__} sees no GPU (its CUDA: {build}); use --device cpu"
        )


def _execute(tasks: Sequence[Task], options: argparse.Namespace, work: Work) -> Generator[Event]:
    """Do all tasks: on the CPU in processes; on a GPU the cells in threads, the planners before them."""
    if options.device == "cpu":
        yield from processes.run_tasks(tasks, jobs=options.jobs, work=work)
        return
    planners = [task for task in tasks if isinstance(task, ReferenceTask)]
    cells = [task for task in tasks if isinstance(task, CellTask)]
    yield from processes.run_tasks(planners, jobs=options.jobs, work=work)
    yield from streams.run_tasks(cells, jobs=options.jobs, work=work)


def _show_status(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    statuses = plan.statuses(selection.requests(), selection.store(options.results))
    report.show_status(selection, statuses, console)
    return 0


def _show_tables(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    store = selection.store(options.results)
    report.show_tables(selection, store, console, everything=options.all, form=_FORMS.get(options.format))
    return 0


def _measure(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    from benchmarks import authors_evaluation  # imported here because torch takes seconds

    wanted = [d for d in selection.domains if selection.registry.domains[d].authors_metric]
    store = selection.store(options.results)
    with store.lock():
        measured = authors_evaluation.measure(store, wanted)
    console.print(f"Measured {measured} policies of {', '.join(wanted)}.", highlight=False)
    return 0


def _select(benchmark: Registry, options: argparse.Namespace) -> Selection:
    budget = benchmark.budget(options.budget)
    benchmark.select("preset", [options.preset])
    only_agents, only_references = options.agent is not None, options.reference is not None
    return Selection(
        registry=benchmark,
        budget=options.budget,
        preset=options.preset,
        domains=benchmark.select_domains(options.domain, budget=options.budget),
        agents=() if only_references and not only_agents else benchmark.select("agent", options.agent),
        references=(
            () if only_agents and not only_references else benchmark.select("reference", options.reference)
        ),
        seeds=options.seeds or tuple(range(budget.seeds)),
    )


def _registry_path(arguments: Sequence[str] | None) -> pathlib.Path:
    """Return the file that ``--registry`` names: it says which names the other options may hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", add_help=False, allow_abbrev=False)
    _add_registry(parser)
    path: pathlib.Path = parser.parse_known_args(arguments)[0].registry
    return path


def _add_registry(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--registry",
        type=pathlib.Path,
        metavar="FILE",
        default=registry.DEFAULT_PATH,
        help='another registry; with `extends = "shipped"` it adds to the one that is shipped',
    )


def _parser(benchmark: Registry) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="compute what is missing, then print the tables")
    status = commands.add_parser("status", help="say which runs are done, older, failed or missing")
    tables = commands.add_parser("tables", help="print and write the tables of everything stored")
    tables.set_defaults(domain=None, agent=None, reference=None, seeds=None)
    tables.add_argument(
        "--all", action="store_true", help="also what the verdicts rest on and every other metric"
    )
    tables.add_argument("--format", choices=tuple(_FORMS), help="print for another program")
    measure = commands.add_parser("measure", help="measure stored Hallway policies as the authors did")
    measure.set_defaults(domain=None, agent=None, reference=None, seeds=None)
    for command in (run, status, tables, measure):
        _add_store(command, benchmark)
    for command in (run, status):
        _add_selection(command, benchmark)
    run.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to train (default: cpu)")
    run.add_argument("--jobs", type=_positive, default=_cores(), help="cells side by side (default: cores)")
    return parser


def _add_store(command: argparse.ArgumentParser, benchmark: Registry) -> None:
    _add_registry(command)
    for kind in ("budget", "preset"):
        default, known = getattr(benchmark.defaults, kind), ", ".join(getattr(benchmark, kind + "s"))
        command.add_argument(f"--{kind}", default=default, help=f"{known} (default: {default})")
    command.add_argument(
        "--results",
        type=pathlib.Path,
        default=pathlib.Path("results/local"),
        help="folder of the store (default: results/local; published results are in results/published)",
    )


def _add_selection(command: argparse.ArgumentParser, benchmark: Registry) -> None:
    for kind in ("domain", "agent", "reference"):
        known = ", ".join(getattr(benchmark, kind + "s"))
        command.add_argument(f"--{kind}", nargs="+", metavar=kind.upper(), help=f"only these of {known}")
    command.add_argument("--seeds", type=parse_seeds, help="such as 0-9 or 0,2,5-7 (default: the budget's)")


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read a list of seeds and ranges such as ``0,2,5-7``."""
    seeds: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or (dash and int(last) < int(first)):
            raise argparse.ArgumentTypeError(
                f"{part!r} is not a seed or a rising range; write 0-9 or 0,2,5-7"
            )
        seeds.update(range(int(first), int(last or first) + 1))
    return tuple(sorted(seeds))


def _cores() -> int:
    """Return how many cores this process may use (macOS cannot tell, and has them all)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
