"""The published numbers computed once more, from parquet alone and with scipy alone.

Nothing of the project's analysis is used: the rules are written out again here.
"""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy import stats

from benchmarks import pooled
from tests.benchmarks.published_rows import RESULTS
from tests.benchmarks.published_stores import POOLED, stored
from tests.benchmarks.recomputed_statistics import AGENTS, METRICS, TABLE_6, TOLERANCES, holm, sample


@pytest.fixture(scope="module")
def printed() -> pooled.PooledEvidence:
    found = stored(POOLED)
    assert isinstance(found, pooled.PooledEvidence)
    return found


@pytest.fixture(scope="module")
def runs(printed: pooled.PooledEvidence) -> dict[tuple[str, str], pd.DataFrame]:
    """Return the runs of each cell that is printed, read from its shards."""
    found = {}
    for domain, budget in printed.budgets.items():
        for path in sorted((RESULTS / budget / printed.preset / "runs" / domain).glob("*")):
            shards = [shard for shard in path.glob("seed-*.parquet") if ".failed" not in shard.name]
            tables = [pq.read_table(shard, partitioning=None) for shard in shards]
            if tables:
                found[domain, path.name] = pa.concat_tables(tables, promote_options="default").to_pandas()
    return found


def test_means_and_deviations(
    printed: pooled.PooledEvidence, runs: dict[tuple[str, str], pd.DataFrame]
) -> None:
    assert len(printed.cells) == len(runs)
    for _, row in printed.cells.iterrows():
        values = runs[row["domain"], row["agent"]][METRICS[row["domain"]]].to_numpy()
        assert row["mean"] == pytest.approx(values.mean())
        assert row["sd"] == pytest.approx(values.std(ddof=0))
        assert row["runs"] == len(values)


def test_success_intervals(printed: pooled.PooledEvidence, runs: dict[tuple[str, str], pd.DataFrame]) -> None:
    for _, row in printed.cells.iterrows():
        group = runs[row["domain"], row["agent"]]
        rates = group["sampled_success"].to_numpy()
        n = [json.loads(spec)["evaluation_episodes"] for spec in group["spec"]]
        pooled_interval = stats.binomtest(round(sum(rates * n)), sum(n)).proportion_ci(0.95, "exact")
        low, high = stats.t.interval(0.95, len(rates) - 1, rates.mean(), stats.sem(rates) or 1e-300)
        assert row["success_low"] == pytest.approx(max(0.0, min(pooled_interval.low, low)), abs=1e-9)
        assert row["success_high"] == pytest.approx(min(1.0, max(pooled_interval.high, high)), abs=1e-9)


def test_p_values_and_verdicts_of_the_numbers(
    printed: pooled.PooledEvidence, runs: dict[tuple[str, str], pd.DataFrame]
) -> None:
    differ, equal, cells = [], [], []
    for _, row in printed.cells.iterrows():
        domain, agent = row["domain"], row["agent"]
        if domain not in TABLE_6 or agent not in AGENTS:
            continue
        steps = [json.loads(spec)["env_steps"] for spec in runs[domain, agent]["spec"]]
        if min(steps) < row["horizon"]:
            assert row["verdict"] == "short"
            continue
        mean, sd = TABLE_6[domain][AGENTS.index(agent)]
        p_differ, p_equal = compare(
            sample(runs[domain, agent], METRICS[domain]), mean, sd, TOLERANCES[domain]
        )
        differ.append(p_differ)
        equal.append(p_equal)
        cells.append(row)
    for row, p_differ, p_equal in zip(cells, holm(differ, 20), holm(equal, 20), strict=True):
        assert row["p_difference"] == pytest.approx(p_differ, rel=1e-6)
        assert row["p_equivalence"] == pytest.approx(p_equal, rel=1e-6)
        words = {(False, True): "reproduced", (True, True): "reproduced, negligible shift"}
        words |= {(False, False): "inconclusive"}
        direction = "exceeds" if row["mean"] > row["paper_mean"] else "falls short"
        words[True, False] = f"not reproduced: {direction}"
        assert row["verdict"] == words[p_differ < 0.05, p_equal < 0.05]


def compare(ours: tuple[float, float, int], mean: float, sd: float, tolerance: float) -> tuple[float, float]:
    """Return p of Welch's test and of TOST against the least favourable of what prints as mean ± sd (ddof 0)."""

    def welch(theirs: float, deviation: float, shift: float, tail: str) -> float:
        a, (m, s, n) = (theirs + shift, deviation * np.sqrt(10 / 9), 10), ours
        return stats.ttest_ind_from_stats(m, s, n, *a, equal_var=False, alternative=tail).pvalue

    deviations = (max(sd - 0.005, 0.0), sd + 0.005)
    nearest = min(max(ours[0], mean - 0.005), mean + 0.005)
    differ = max(welch(nearest, d, 0.0, "two-sided") for d in deviations)
    corners = [(m, d) for m in (mean - 0.005, mean + 0.005) for d in deviations]
    below = max(welch(m, d, tolerance, "less") for m, d in corners)
    above = max(welch(m, d, -tolerance, "greater") for m, d in corners)
    return differ, max(below, above)


def test_claims_of_the_robot_cells(
    printed: pooled.PooledEvidence, runs: dict[tuple[str, str], pd.DataFrame]
) -> None:
    less, greater, equal, rows = [], [], [], []
    for _, row in printed.cells.iterrows():
        domain, better = row["domain"], (row["domain"], "ah-ch+bgn")
        robot = domain not in TABLE_6
        steps = [json.loads(spec)["env_steps"] for spec in runs[domain, row["agent"]]["spec"]]
        if not robot or row["agent"] == "ah-ch+bgn" or better not in runs or min(steps) < row["horizon"]:
            continue
        a, b = sample(runs[domain, row["agent"]], "sampled_success"), sample(runs[better], "sampled_success")

        def welch(shift: float, tail: str, a: tuple = a, b: tuple = b) -> float:
            shifted = (a[0] - shift, *a[1:])
            return stats.ttest_ind_from_stats(*shifted, *b, equal_var=False, alternative=tail).pvalue

        less.append(welch(0.0, "less"))
        greater.append(welch(0.0, "greater"))
        equal.append(max(welch(0.01, "less"), welch(-0.01, "greater")))
        rows.append(row)
    for row, p_less, p_greater, p_equal in zip(
        rows, holm(less, 15), holm(greater, 15), holm(equal, 15), strict=True
    ):
        assert row["p_difference"] == pytest.approx(p_less, rel=1e-6)
        assert row["p_equivalence"] == pytest.approx(p_equal, rel=1e-6)
        refuted = min(p_greater, p_equal) < 0.05
        expected = "not reproduced: exceeds" if refuted else "inconclusive"
        assert row["verdict"] == ("reproduced" if p_less < 0.05 else expected)
