"""The command line: ``python -m benchmarks run | status | tables | measure | merge | export | verify``.

Exit status: 0, all is done; 1, something is missing or failed; 2, wrong options or an unusable store; 3, nothing
more can be written (disk full or read-only); 130, 143, 129: stopped by Ctrl-C, SIGTERM or SIGHUP, with
checkpoints written. A call whose ``--time-limit`` is up ends like any other, with checkpoints written.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import pathlib
import sys
import time
from collections.abc import Generator, Iterator, Mapping, Sequence

from rich.console import Console
from rich.progress import track

from benchmarks import adoption, beginnings, plan, progress, registry, report, sharing
from benchmarks.events import Event, Idle
from benchmarks.executors import beside, packing, processes, sites, streams
from benchmarks.executors.sites import SchedulerLostError
from benchmarks.plan import Selection, State
from benchmarks.registry import Registry
from benchmarks.signals import Stopped, stoppable
from benchmarks.superfluous import discard_attempts
from benchmarks.tasks import CellTask, ReferenceTask, Task, Work
from bgn import domains
from bgn.errors import BgnError
from bgn.results import quarantine
from bgn.results.store import StorageError, Store, StoreError, writing_to
from bgn.training.physics_evaluation import has_physics

_FAILED, _USAGE, _STORAGE = 1, 2, 3
#: Seconds between looks at the clock, and at the other executor.
_TICK = 0.05
_RESULTS = pathlib.Path("results/local")
#: Cores that the threads of a GPU's cells keep busy.
_CORES_OF_A_GPU = 2
_FORMS: Mapping[str, report.Form] = {"md": "markdown", "csv": "csv", "html": "html", "latex": "latex"}


class DeviceError(BgnError, RuntimeError):
    """The device that was asked for is not there."""


def main(arguments: Sequence[str] | None = None, *, work: Work = Work()) -> int:  # noqa: B008
    """Run a command; return its exit status."""
    console = Console() if sys.stdout.isatty() else Console(width=report.TABLE_WIDTH)
    try:
        with stoppable():
            benchmark = registry.load(_registry_path(arguments))
            options = _parser(benchmark).parse_args(arguments)
            return _command(benchmark, options, work, console)
    except BgnError as error:
        print(f"error: {error}", file=sys.stderr)
        return _status(error)
    except Stopped as stop:
        print(f"stopped by {stop.signal.name}; the same command goes on from here", file=sys.stderr)
        return stop.exit_status


def _status(error: BgnError) -> int:
    if isinstance(error, StorageError):
        return _STORAGE
    return _FAILED if isinstance(error, SchedulerLostError) else _USAGE


def _command(benchmark: Registry, options: argparse.Namespace, work: Work, console: Console) -> int:
    if options.command in sharing.COMMANDS:
        return sharing.run(options, work, console)
    selections = [_select(benchmark, options, name) for name in dict.fromkeys(options.budget)]
    if options.command == "run":
        longest_first = sorted(selections, key=lambda selection: -selection.env_steps())
        return _run_budgets(longest_first, options, work, console)
    if options.results != _RESULTS and not options.results.is_dir():
        raise StoreError(f"--results {options.results}: there is no such folder")
    show = {"status": _show_status, "tables": _show_tables, "measure": _measure}[options.command]
    return max(show(selection, options, console) for selection in selections)


def _run_budgets(
    selections: Sequence[Selection], options: argparse.Namespace, work: Work, console: Console
) -> int:
    """Run one budget after the other, those first whose training passes through the others'."""
    _check_device(options)
    clock = _Clock(options.time_limit)
    with contextlib.ExitStack() as locks:
        for selection in selections:
            locks.enter_context(selection.store(options.results).lock())
        for selection in selections:  # before any is read, also as another's beginnings
            _sweep(selection.store(options.results))
        return max(
            _run(selection, selections[i + 1 :], options, work, console, clock)
            for i, selection in enumerate(selections)
        )


def _sweep(store: Store) -> None:
    with writing_to(store.root):
        for damage in quarantine.sweep(store):
            print(f"{damage}; its run is computed anew", file=sys.stderr)


def _run(
    selection: Selection,
    shorter: Sequence[Selection],
    options: argparse.Namespace,
    work: Work,
    console: Console,
    clock: _Clock,
) -> int:
    store = selection.store(options.results)
    requests = selection.requests()
    with writing_to(store.root):
        found = plan.statuses(requests, store)
        for request in [s.request for s in found if s.state is State.CURRENT]:
            discard_attempts(store, request.kind, request.run, request.origin.key)
        missing = plan.to_compute(found)
        adopted = adoption.adopt(missing, store, options.results)
        missing = [request for request in missing if request not in adopted]
        tasks = selection.tasks(missing, store, options.device)
        done = len(requests) - len(missing) - sum(status.state is State.INCOMPLETE for status in found)
        asked = f"{selection.budget}, {selection.preset}"
        console.print(
            f"{done} of {len(requests)} runs and reference rows are done ({asked}).", highlight=False
        )
        if tasks and not clock.is_up():
            with _executor(tasks, shorter, options, work, console) as (parts, events):
                _show(parts, events, clock, console)
        if has_physics():
            found = plan.statuses(requests, store)
            incomplete = [s.request for s in found if s.state is State.INCOMPLETE]
            tasks = selection.physics_tasks(incomplete, store)
            _show(tasks, processes.run_tasks(tasks, jobs=options.jobs, work=work, tick=_TICK), clock, console)
        if clock.is_up():
            print("time is up; the same command goes on from here", file=sys.stderr)
        statuses = plan.statuses(requests, store)
        report.show_tables(selection, store, console, writing=contextlib.nullcontext())
    if all(status.state is State.CURRENT for status in statuses):
        return 0
    report.show_missing(statuses, console)
    return _FAILED


class _Clock:
    """Says when the time of a call is up."""

    def __init__(self, seconds: float | None) -> None:
        self._end = math.inf if seconds is None else time.monotonic() + seconds

    def is_up(self) -> bool:
        return time.monotonic() >= self._end


def _show(tasks: Sequence[Task], events: Generator[Event | Idle], clock: _Clock, console: Console) -> None:
    """Show what happens until all is done or time is up; then stop the workers, which leave checkpoints."""
    if not tasks or clock.is_up():
        return
    with progress.display(tasks, console) as display, contextlib.closing(events):
        for event in events:
            if clock.is_up():
                return
            if not isinstance(event, Idle):
                display.note(event)


def _check_device(options: argparse.Namespace) -> None:
    """Look for the GPU that is asked for, and settle how many cells it gets.

    Raises
    ------
    DeviceError
        There is none, or it cannot have so many cells.
    """
    sites.check_name(options.executor)
    if options.device == "cpu":
        options.jobs = options.jobs or _cores()
        return
    if options.executor != sites.LOCAL:
        raise DeviceError(
            f"--executor {options.executor} trains on cores; use --device cuda on the machine with the GPU"
        )
    import torch  # imported here because it takes seconds, and only workers need it otherwise

    from bgn.training.cuda import MAX_CELLS

    options.jobs = options.jobs or min(_cores(), MAX_CELLS)
    if options.jobs > MAX_CELLS:
        raise DeviceError(f"--jobs {options.jobs}: a GPU runs at most {MAX_CELLS} cells side by side")
    if not torch.cuda.is_available():
        build = torch.version.cuda or "none, this is a build for the CPU"
        raise DeviceError(
            f"--device cuda: torch {torch.__version__} sees no GPU (its CUDA: {build}); use --device cpu"
        )


@contextlib.contextmanager
def _executor(
    tasks: Sequence[Task],
    shorter: Sequence[Selection],
    options: argparse.Namespace,
    work: Work,
    console: Console,
) -> Iterator[tuple[Sequence[Task], Generator[Event | Idle]]]:
    """Return the tasks as they will be done, and what happens while they are."""
    tasks = packing.along_checkpoints(tasks)
    if options.executor == sites.LOCAL:
        if options.device == "cpu":  # on a GPU it was never tried
            tasks = beginnings.take_along(tasks, shorter, options.results)
        yield tasks, _execute(tasks, options, work)
        return
    with sites.connect(options.executor, options.cluster) as site:
        from benchmarks.executors import cluster  # imported here because only clusters need Dask

        workers = site.workers(wanted=len(tasks))
        if not workers:
            console.print(f"No worker has joined {site.address} yet; waiting.", highlight=False)
        tasks = packing.split(tasks, workers)
        yield tasks, cluster.run_tasks(tasks, site=site, work=work, tick=_TICK)


def _execute(tasks: Sequence[Task], options: argparse.Namespace, work: Work) -> Generator[Event | Idle]:
    """Do all tasks: on the CPU in processes; on a GPU the cells in threads, planners in processes beside them."""
    if options.device == "cpu":
        return processes.run_tasks(tasks, jobs=options.jobs, work=work, tick=_TICK)
    planners = [task for task in tasks if isinstance(task, ReferenceTask)]
    cells = [task for task in tasks if isinstance(task, CellTask)]
    cores = max(1, _cores() - _CORES_OF_A_GPU)
    return beside(
        streams.run_tasks(cells, jobs=options.jobs, work=work, tick=_TICK),
        processes.run_tasks(planners, jobs=cores, work=work, tick=_TICK),
    )


def _show_status(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    statuses = plan.statuses(selection.requests(), selection.store(options.results))
    report.show_status(selection, statuses, console)
    return 0


def _show_tables(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    store = selection.store(options.results)
    with writing_to(store.root):
        report.show_tables(
            selection,
            store,
            console,
            everything=options.all,
            form=_FORMS.get(options.format),
            writing=store.lock() if options.write else None,
        )
    return 0


def _measure(selection: Selection, options: argparse.Namespace, console: Console) -> int:
    from benchmarks import measures  # imported here because torch takes seconds

    store = selection.store(options.results)
    if not (store.root / "policies").is_dir():
        raise StoreError(
            f"{store.root} holds no policies to measure; `python -m benchmarks run` with the same options leaves them"
        )
    of_domains = measures.measures_of(selection.registry)
    wanted = {domain: of_domains[domain] for domain in selection.domains if domain in of_domains}
    with writing_to(store.root), store.lock():
        left = [row for row in measures.unmeasured(store, wanted) if row["agent"] in selection.agents]
        rows = track(left, "Measuring", console=console, transient=True, disable=not console.is_terminal)
        counts, problems = measures.measure(store, rows, wanted)
    said = ", ".join(f"{domains.get(domain).title} {count}" for domain, count in counts.items())
    nothing = "No policy could be measured." if left else "No stored policy is left to measure."
    console.print(f"Policies measured: {said}." if said else nothing, highlight=False)
    for problem in problems:
        print(f"error: {problem}", file=sys.stderr)
    return _FAILED if problems else 0


def _select(benchmark: Registry, options: argparse.Namespace, budget_name: str) -> Selection:
    budget = benchmark.budget(budget_name)
    preset = options.preset or benchmark.preset_of(budget_name)
    benchmark.select("preset", [preset])
    only_agents, only_references = options.agent is not None, options.reference is not None
    return Selection(
        registry=benchmark,
        budget=budget_name,
        preset=preset,
        domains=benchmark.select_domains(options.domain, budget=budget_name),
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
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, allow_abbrev=False)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser(
        "run", help="compute what is missing, then print the tables", allow_abbrev=False
    )
    status = commands.add_parser(
        "status", help="say which runs are done, older, failed or missing", allow_abbrev=False
    )
    tables = commands.add_parser("tables", help="print the tables of everything stored", allow_abbrev=False)
    tables.set_defaults(domain=None, agent=None, reference=None, seeds=None)
    tables.add_argument(
        "--all", action="store_true", help="also what the verdicts rest on and every other metric"
    )
    tables.add_argument(
        "--write", action="store_true", help="write them beside the results too, as `run` does"
    )
    tables.add_argument("--format", choices=tuple(_FORMS), help="print for another program")
    measure = commands.add_parser(
        "measure",
        help="measure stored policies: the Hallways as the authors did, in the robot domains what they do",
        allow_abbrev=False,
    )
    measure.set_defaults(reference=None, seeds=None)
    for command in (run, status, tables, measure):
        _add_store(command, benchmark)
    for command in (run, status):
        _add_selection(command, benchmark, "domain", "agent", "reference")
        command.add_argument(
            "--seeds", type=parse_seeds, help="such as 0-9 or 0,2,5-7 (default: the budget's)"
        )
    _add_selection(measure, benchmark, "domain", "agent")
    sharing.add_commands(commands, benchmark)
    run.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to train (default: cpu)")
    run.add_argument(
        "--jobs", type=_positive, help="cells side by side (default: cores; on a GPU at most 31)"
    )
    run.add_argument(
        "--time-limit",
        type=parse_duration,
        metavar="TIME",
        help="stop after a time such as 540, 9m or 1.5h, with checkpoints written; the same command goes on",
    )
    run.add_argument(
        "--executor",
        default=sites.LOCAL,
        help="local (default), dask://HOST:PORT (a running Dask scheduler), slurm, pbs or lsf; see docs/cluster.md",
    )
    run.add_argument(
        "--cluster",
        type=pathlib.Path,
        metavar="FILE",
        default=pathlib.Path("cluster.toml"),
        help="what to ask slurm, pbs or lsf for (default: cluster.toml)",
    )
    return parser


def _add_store(command: argparse.ArgumentParser, benchmark: Registry) -> None:
    _add_registry(command)
    default = benchmark.defaults.budget
    several = (
        f"one or several of {', '.join(benchmark.budgets)} (default: {default}); `run` trains what begins alike once, "
        "where it can"
    )
    command.add_argument("--budget", nargs="+", default=[default], help=several)
    own = [f"{entry.preset} for {name}" for name, entry in benchmark.budgets.items() if entry.preset]
    usual = ", ".join([*own, benchmark.defaults.preset + (" for the others" if own else "")])
    command.add_argument("--preset", help=f"{', '.join(benchmark.presets)} (default: {usual})")
    command.add_argument(
        "--results",
        type=pathlib.Path,
        default=_RESULTS,
        help="folder of the store (default: results/local; published results are in results/published)",
    )


def _add_selection(command: argparse.ArgumentParser, benchmark: Registry, *kinds: str) -> None:
    for kind in kinds:
        known = ", ".join(getattr(benchmark, kind + "s"))
        command.add_argument(f"--{kind}", nargs="+", metavar=kind.upper(), help=f"only these of {known}")


#: Far more than anybody trains, few enough to be listed.
MAX_SEED = 999_999


def parse_seeds(text: str) -> tuple[int, ...]:
    """Read a list of seeds and ranges such as ``0,2,5-7``."""
    seeds: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or (dash and int(last) < int(first)):
            raise argparse.ArgumentTypeError(
                f"{part!r} is not a seed or a rising range; write 0-9 or 0,2,5-7"
            )
        if int(last or first) > MAX_SEED:
            raise argparse.ArgumentTypeError(f"seeds go up to {MAX_SEED}, not {last or first}")
        seeds.update(range(int(first), int(last or first) + 1))
    return tuple(sorted(seeds))


def _cores() -> int:
    """Return how many cores this process may use (macOS cannot tell, and has them all)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def parse_duration(text: str) -> float:
    """Read seconds (``540``), minutes (``9m``) or hours (``1.5h``); returns seconds."""
    units = {"s": 1.0, "m": 60.0, "h": 3600.0}
    number, unit = (text[:-1], text[-1]) if text[-1:] in units else (text, "s")
    try:
        seconds = float(number) * units[unit]
    except ValueError:
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time; write seconds, or 9m or 1.5h")
    return seconds


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
