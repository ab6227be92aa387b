"""Policies beside which the agents are judged, as rows of the tables."""

from __future__ import annotations

import math
from functools import lru_cache

from bgn.domains import Domain
from bgn.domains.episode_opening import CLEAN, EpisodeOpening
from bgn.errors import InputError
from bgn.planning.deterministic import solve_deterministic
from bgn.planning.evaluate import evaluate
from bgn.planning.heuristics import always, informed, qmdp
from bgn.planning.sarsop import solve
from bgn.policies.alpha_vectors import AlphaVectorPolicy, AlphaVectors
from bgn.policies.uniform import RandomPolicy
from bgn.simulation.policy import Policy

#: A solve stops when the bounds are this close, if time allows.
PRECISION = 1e-3
_DRIVE_EAST = "east"


REFERENCES = ("random", "sarsop", "qmdp", "fib", "drive-east", "perfect")
"""``random``: uniform actions. ``sarsop``: near-optimal planning. ``qmdp``, ``fib``: greedy on the QMDP values and
on the fast informed bound. ``drive-east`` (RockSample): straight to the exit. ``perfect`` (deterministic domains
that report success): the exact optimum. Which of them a domain's tables show is the benchmark's choice."""


def evaluate_reference(
    reference_id: str,
    domain: Domain,
    *,
    episodes: int,
    seed: int,
    convention: EpisodeOpening = CLEAN,
    backups: int = 10_000,
    timeout: float = 600.0,
) -> dict[str, float]:
    """Plan if need be, then simulate: the seed decides the episodes.

    A solve ends after ``backups`` beliefs backed up, so that a row is the same whenever it is computed; after
    ``timeout`` CPU seconds it is cut off, and the row says so.

    Returns ``return`` (discounted as the domain reports it), ``return_se``, ``return_sd``, ``success``,
    ``success_se``, ``length``. ``perfect`` is exact, without simulation; it adds ``value`` (V*, discounted as
    in training) and ``max_length``. ``sarsop`` adds ``lower_bound`` and ``upper_bound`` of the optimum (at
    the model's discount, without the episode limit), ``backups``, ``vectors`` and ``timed_out`` (0 or 1).

    Raises
    ------
    InputError
        There is no such reference policy, or it or the convention does not apply to the domain.
    bgn.planning.sarsop.PlanningError
        ``perfect``: the domain is not deterministic.
    """
    if reference_id not in REFERENCES:
        raise InputError(f"no reference policy {reference_id!r}; known: {', '.join(REFERENCES)}")
    if reference_id == "perfect":
        if domain.report_discount != 1:
            raise InputError(
                f"reference policy 'perfect' is a success rate; {domain.id} reports discounted returns"
            )
        return _perfect(domain)
    policy, metrics = _plan(reference_id, domain, convention, backups, timeout)
    outcome = evaluate(
        domain,
        policy,
        episodes=episodes,
        seed=seed,
        convention=convention,
        discount=domain.report_discount,
    )
    return {
        "return": outcome.mean,
        "return_se": outcome.standard_error,
        "return_sd": outcome.standard_deviation,
        "success": outcome.success,
        "success_se": math.sqrt(outcome.success * (1 - outcome.success) / episodes),
        "length": outcome.length,
        **metrics,
    }


def _perfect(domain: Domain) -> dict[str, float]:
    """Return the exact optimum of a domain that reports the undiscounted return, 1 for success."""
    optimum = solve_deterministic(domain.model)
    success = min(1.0, optimum.mean_return)  # a sum of probabilities may be rounded up
    return {
        "return": success,
        "return_se": 0.0,
        "return_sd": optimum.return_sd,
        "success": success,
        "success_se": 0.0,
        "length": optimum.mean_length,
        "value": optimum.value,
        "max_length": float(optimum.max_length),
    }


def _plan(
    reference_id: str, domain: Domain, convention: EpisodeOpening, backups: int, timeout: float
) -> tuple[Policy, dict[str, float]]:
    """Return a reference policy and what planning it said."""
    model = domain.model
    if reference_id == "random":
        return RandomPolicy(domain), {}
    metrics: dict[str, float] = {}
    if reference_id == "sarsop":
        alpha, metrics = _solve(domain, convention, backups, timeout)
    elif reference_id == "drive-east":
        alpha = always(model.joint, _DRIVE_EAST)
    else:
        alpha = (qmdp if reference_id == "qmdp" else informed)(model, convention)
    return AlphaVectorPolicy(alpha, domain), metrics


@lru_cache(maxsize=8)
def _solve(
    domain: Domain, convention: EpisodeOpening, backups: int, timeout: float
) -> tuple[AlphaVectors, dict[str, float]]:
    solution = solve(
        domain.model, precision=PRECISION, backups=backups, timeout=timeout, convention=convention
    )
    return solution.policy, {
        "lower_bound": solution.progress.lower,
        "upper_bound": solution.progress.upper,
        "backups": float(solution.progress.backups),
        "vectors": float(len(solution.policy)),
        "timed_out": float(solution.reason == "timeout"),
    }
