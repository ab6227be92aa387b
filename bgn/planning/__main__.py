"""Command line of the planner: ``python -m bgn.planning solve|evaluate``."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

import bgn.pomdp
from bgn import domains
from bgn.planning import policy_file
from bgn.planning.appl import solve_with_appl
from bgn.planning.compiled import compile_model
from bgn.planning.episodic import start_beliefs
from bgn.planning.evaluate import DEFAULT_LIMIT, evaluate
from bgn.planning.policies import Policy, UniformRandom, always, informed, qmdp
from bgn.planning.sarsop import PlanningError, Progress, Solution, solve, warm_up
from bgn.pomdp.model import MOMDP, POMDP

INTERRUPTED = 130  # what shells report for Ctrl-C
_PLAIN_SECONDS = 5.0  # between progress lines where there is no terminal


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        return int(options.command(options))
    except KeyboardInterrupt:
        print("interrupted before there was a policy", file=sys.stderr)
        return INTERRUPTED
    except (OSError, ValueError, KeyError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bgn.planning", description=__doc__)
    commands = parser.add_subparsers(required=True)
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("model", metavar="FILE", help="a .pomdp file, or the id of a domain")
    common.add_argument(
        "--convention",
        choices=("clean", "hidden-first-action"),
        default="clean",
        help="how an episode opens; the second with an unseen random action, as for the paper's agents",
    )
    common.add_argument("--json", action="store_true", help="print the result as JSON")
    plan = commands.add_parser("solve", parents=[common], help="bound the optimum with SARSOP, find a policy")
    plan.add_argument("--precision", type=float, default=1e-3, help="stop at this gap between the bounds")
    plan.add_argument(
        "--timeout", type=float, default=60.0, help="CPU seconds, after the kernels are compiled"
    )
    plan.add_argument("--policy", type=Path, metavar="OUT", help="write the policy (APPL's XML format)")
    plan.add_argument("--solver", choices=("bgn", "appl"), default="bgn", help="appl: pomdpsol from the PATH")
    plan.set_defaults(command=_solve)
    judge = commands.add_parser("evaluate", parents=[common], help="simulate a policy")
    judge.add_argument("policy", help="a .policy file, or: random, qmdp, fib, always:ACTION")
    judge.add_argument("--episodes", type=int, default=10_000)
    judge.add_argument("--seed", type=int, default=0)
    judge.add_argument(
        "--limit", type=int, help="counted steps of an episode (default: the domain's, or 100)"
    )
    judge.set_defaults(command=_evaluate)
    return parser


def _solve(options: argparse.Namespace) -> int:
    model, _ = _load(options.model)
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
                convention=options.convention,
                on_progress=report,
            )
    if options.policy is not None:
        policy_file.save(solution.policy, options.policy, model=Path(options.model).name)
    _print_solution(solution, options)
    return INTERRUPTED if solution.reason == "interrupted" else 0


def _solve_with_appl(model: MOMDP, options: argparse.Namespace) -> Solution:
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
    _print(values, as_json=options.json)


def _evaluate(options: argparse.Namespace) -> int:
    model, limit = _load(options.model)
    outcome = evaluate(
        model,
        _policy(options.policy, model, options),
        episodes=options.episodes,
        seed=options.seed,
        convention=options.convention,
        limit=limit if options.limit is None else options.limit,
    )
    low, high = outcome.interval
    values = {
        "model": options.model,
        "policy": options.policy,
        "convention": options.convention,
        "episodes": outcome.episodes,
        "mean_return": outcome.mean,
        "standard_error": outcome.standard_error,
        "interval_95_low": low,
        "interval_95_high": high,
        "standard_deviation": outcome.standard_deviation,
        "success": outcome.success,
        "length": outcome.length,
    }
    _print(values, as_json=options.json)
    return 0


def _load(name: str) -> tuple[MOMDP, int]:
    """Return a model by file or domain id, and its episode limit."""
    if name in domains.ids():
        domain = domains.get(name)
        return domain.model, domain.episode_limit
    if not Path(name).exists():
        raise PlanningError(f"{name}: no such file, nor a domain; domains: {', '.join(domains.ids())}")
    return MOMDP(bgn.pomdp.load(name)), DEFAULT_LIMIT


def _policy(name: str, model: MOMDP, options: argparse.Namespace) -> Policy:
    joint: POMDP = model.joint
    if name == "random":
        return UniformRandom()
    if name.startswith("always:"):
        return always(joint, name.removeprefix("always:"))
    if name in ("qmdp", "fib"):
        compiled = compile_model(joint, start_beliefs(model, options.convention))
        return (qmdp if name == "qmdp" else informed)(joint, compiled)
    return policy_file.load(name)


def _print(values: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(values, indent=2))
        return
    for name, value in values.items():
        if value is not None:
            print(f"{name.replace('_', ' '):>20}  {f'{value:,.6g}' if isinstance(value, float) else value}")


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


if __name__ == "__main__":
    sys.exit(main())
