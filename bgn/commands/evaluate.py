"""``bgn evaluate``: simulate a policy on a model."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from bgn.commands.parsing import Commands
from bgn.commands.planning import add_model, load_domain, print_values

if TYPE_CHECKING:
    from bgn.domains.domain import Domain
    from bgn.domains.episode_opening import EpisodeOpening
    from bgn.simulation.policy import Policy


def add_evaluate(commands: Commands) -> None:
    """Add the command that simulates a policy."""
    command = commands.add_parser("evaluate", help="simulate a policy on a model")
    add_model(command)
    command.add_argument(
        "policy", help="a saved policy, or: random, qmdp, fib, always:ACTION, scripted (robot domains)"
    )
    command.add_argument("--episodes", type=int, default=10_000)
    command.add_argument("--seed", type=int, default=0)
    command.add_argument(
        "--limit", type=int, help="counted steps of an episode (default: the domain's, or 100)"
    )
    command.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    from bgn.planning.evaluate import evaluate

    domain = load_domain(options.model)
    outcome = evaluate(
        domain,
        _policy(options.policy, domain, options.convention),
        episodes=options.episodes,
        seed=options.seed,
        convention=options.convention,
        limit=options.limit,
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


def _policy(name: str, domain: Domain, convention: EpisodeOpening) -> Policy:
    """Return the policy of a name, importing only what it needs."""
    from bgn import policies
    from bgn.planning.heuristics import always, informed, qmdp
    from bgn.policies.alpha_vectors import AlphaVectorPolicy
    from bgn.policies.scripted import scripted_policy
    from bgn.policies.uniform import RandomPolicy

    if name == "random":
        return RandomPolicy(domain)
    if name == "scripted":
        return scripted_policy(domain)
    if name.startswith("always:"):
        return AlphaVectorPolicy(always(domain.model.joint, name.removeprefix("always:")), domain)
    if name in ("qmdp", "fib"):
        return AlphaVectorPolicy((qmdp if name == "qmdp" else informed)(domain.model, convention), domain)
    return policies.load(name, domain)
