"""How fast the planner is: bounds reached in a given time, and the time to reach given bounds.

Times are CPU seconds of one core, kernels compiled before.
"""

from __future__ import annotations

import resource
import sys

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from bgn import domains
from bgn.planning.deterministic import solve_deterministic
from bgn.planning.evaluate import evaluate
from bgn.planning.sarsop import Solution, solve, warm_up
from bgn.policies.alpha_vectors import AlphaVectorPolicy

EPISODES = 20_000


@pytest.fixture(autouse=True, scope="module")
def _compiled() -> None:
    warm_up()


def _solve(name: str, precision: float, timeout: float) -> Solution:
    return solve(domains.get(name).model, precision=precision, timeout=timeout)


@pytest.mark.parametrize(
    ("name", "gap", "seconds"),
    [
        ("rocksample-4-4", 1e-3, 0.3),
        ("rocksample-5-5", 0.9, 10.0),
        ("rocksample-5-5", 0.25, 100.0),
        ("hallway", 0.055, 10.0),
    ],
)
def test_time_to_gap(benchmark: BenchmarkFixture, name: str, gap: float, seconds: float) -> None:
    """CPU seconds until the bounds at the start are that close."""
    domains.get(name).model.joint.expected_rewards  # noqa: B018  (reading the model is not the search's time)
    solution = benchmark.pedantic(_solve, args=(name, gap, seconds), rounds=1)  # type: ignore[no-untyped-call]
    progress = solution.progress
    benchmark.extra_info.update(
        cpu_seconds=progress.seconds, target_seconds=seconds, lower=progress.lower, upper=progress.upper
    )
    assert progress.gap <= gap


@pytest.mark.parametrize(
    ("name", "seconds", "lower", "simulated"),
    [("hallway", 10.0, 0.50, 0.515), ("hallway-2", 60.0, 0.25, 0.345)],
)
def test_policy_in_time(
    benchmark: BenchmarkFixture, name: str, seconds: float, lower: float, simulated: float
) -> None:
    """What the policy found in that many CPU seconds earns."""
    solution = benchmark.pedantic(_solve, args=(name, 1e-3, seconds), rounds=1)  # type: ignore[no-untyped-call]
    domain = domains.get(name)
    outcome = evaluate(domain, AlphaVectorPolicy(solution.policy, domain), episodes=EPISODES, seed=0)
    benchmark.extra_info.update(
        lower=solution.progress.lower,
        upper=solution.progress.upper,
        vectors=len(solution.policy),
        simulated=outcome.mean,
        standard_error=outcome.standard_error,
        megabytes=_peak_megabytes(),
    )
    assert solution.progress.lower >= lower
    assert outcome.mean >= simulated - 2 * outcome.standard_error


@pytest.mark.parametrize("name", ["top-plate", "two-bumps-1d", "two-bumps-2d"])
def test_exact_optimum(benchmark: BenchmarkFixture, name: str) -> None:
    """Seconds for the exact optimum of a deterministic domain."""
    model = domains.get(name).model
    solve_deterministic(domains.get("top-plate").model)
    optimum = benchmark.pedantic(solve_deterministic, args=(model,), rounds=1)  # type: ignore[no-untyped-call]
    assert optimum.mean_return == pytest.approx(1)


def _peak_megabytes() -> float:
    """Largest memory of this process so far, libraries included."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
