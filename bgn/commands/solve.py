"""``bgn solve``: bound the optimum of a model with SARSOP and find a policy."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from bgn.commands.parsing import INTERRUPTED, Commands
from bgn.commands.planning import add_model, load_domain, print_values
from bgn.planning.appl import solve_with_appl
from bgn.planning.sarsop import PlanningError, Progress, Solution, solve, warm_up
from bgn.policies import alpha_file
from bgn.pomdp.model import MOMDP

_PLAIN_SECONDS = 5.0  # between progress lines where there is no terminal


def add_solve(commands: Commands) -> None:
    """Add the command that plans."""
    command = commands.add_parser("solve", help="bound a model's optimum with SARSOP, find a policy")
    add_model(command)
    command.add_argument("--precision", type=float, default=1e-3, help="stop at this gap between the bounds")
    command.add_argument(
        "--timeout", type=float, default=60.0, help="CPU seconds, after the kernels are compiled"
    )
    command.add_argument(
        "--backups", type=int, help="stop after this much work, which finds the same on every run"
    )
    command.add_argument("--policy", type=Path, metavar="OUT", help="write the policy (APPL's XML format)")
    command.add_argument(
        "--solver", choices=("bgn", "appl"), default="bgn", help="appl: pomdpsol from the PATH"
    )
    command.set_defaults(run=_solve)


def _solve(options: argparse.Namespace) -> int:
    model = load_domain(options.model).model
    if options.policy is not None and not options.policy.absolute().parent.is_dir():
        raise PlanningError(f"{options.policy}: there is no folder {options.policy.absolute().parent}")
    if options.solver == "appl":
        solution = _solve_with_appl(model, options)
    else:
        with _Reporter() as report:
            warm_up()
            solution = solve(
                model,
                precision=options.precision,
                timeout=options.timeout,
                backups=options.backups,
                convention=options.convention,
                on_progress=report,
            )
    if options.policy is not None:
        alpha_file.save(solution.policy, options.policy, model=Path(options.model).name)
    _print_solution(solution, options)
    return INTERRUPTED if solution.reason == "interrupted" else 0


def _solve_with_appl(model: MOMDP, options: argparse.Namespace) -> Solution:
    if options.backups is not None:
        raise PlanningError("pomdpsol cannot be bounded by backups: use --timeout")
    if options.convention != "clean" or model.n_observed > 1:
        raise PlanningError("pomdpsol solves one start belief: only clean episodes of models that show no x")
    return solve_with_appl(model.joint, precision=options.precision, timeout=options.timeout)


def _print_solution(solution: Solution, options: argparse.Namespace) -> None:
    progress = solution.progress
    values: dict[str, Any] = {
        "model": options.model,
        "solver": options.solver,
        "convention": options.convention,
        "lower": progress.lower,
        "upper": progress.upper,
        "gap": progress.gap,
        "seconds": progress.seconds,
        "vectors": len(solution.policy),
        "beliefs": progress.beliefs,
        "trials": progress.trials,
        "backups": progress.backups,
        "stopped": solution.reason,
        "policy": None if options.policy is None else str(options.policy),
    }
    print_values(values, as_json=options.json)


class _Reporter:
    """Shows a search's progress on stderr: one live line on a terminal, else a plain line now and then."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._live = Live(
            "preparing (the first time, kernels are compiled)", console=self._console, transient=True
        )
        self._printed = time.monotonic()

    def __enter__(self) -> _Reporter:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def __call__(self, progress: Progress) -> None:
        line = (
            f"{progress.seconds:8.1f} s   lower {progress.lower:.6g}   upper {progress.upper:.6g}   "
            f"gap {progress.gap:.3g}   {progress.vectors:,} vectors   {progress.beliefs:,} beliefs"
        )
        if self._console.is_terminal:
            self._live.update(line)
        elif time.monotonic() - self._printed > _PLAIN_SECONDS:
            self._printed = time.monotonic()
            self._console.print(line)
