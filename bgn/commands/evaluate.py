"""``bgn evaluate``: simulate a policy on a model."""

from __future__ import annotations

import argparse

from bgn.commands.parsing import Commands
from bgn.commands.planning import add_model, load_model, print_values
from bgn.planning import policy_file
from bgn.planning.compiled import compile_model
from bgn.planning.episodic import start_beliefs
from bgn.planning.evaluate import evaluate
from bgn.planning.policies import Policy, UniformRandom, always, informed, qmdp
from bgn.pomdp.model import MOMDP, POMDP


def add_evaluate(commands: Commands) -> None:
    """Add the command that simulates a policy."""
    command = commands.add_parser("evaluate", help="simulate a policy on a model")
    add_model(command)
    command.add_argument("policy", help="a .policy file, or: random, qmdp, fib, always:ACTION")
    command.add_argument("--episodes", type=int, default=10_000)
    command.add_argument("--seed", type=int, default=0)
    command.add_argument(
        "--limit", type=int, help="counted steps of an episode (default: the domain's, or 100)"
    )
    command.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    model, limit = load_model(options.model)
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
    print_values(values, as_json=options.json)
    return 0


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
