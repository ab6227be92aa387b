from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from bgn.analysis import aggregate
from tests.analysis._evidence import curve


def test_iqm_by_hand() -> None:
    # Of 1 to 8 a quarter is cut at either end: the mean of 3, 4, 5, 6.
    assert float(aggregate.iqm([8, 1, 7, 2, 6, 3, 5, 4])) == 4.5
    assert float(aggregate.iqm([0, 0, 0, 100])) == 0.0
    assert aggregate.iqm(np.arange(16).reshape(2, 8)).tolist() == [3.5, 11.5]


def test_bootstrap_draws_within_each_domain() -> None:
    drawn = aggregate.resample({"a": [1.0, 2.0], "b": [10.0, 20.0, 30.0]}, draws=500)
    assert drawn["a"].shape == (500, 2)
    assert drawn["b"].shape == (500, 3)
    assert set(np.unique(drawn["a"])) == {1.0, 2.0}
    assert set(np.unique(drawn["b"])) == {10.0, 20.0, 30.0}
    again = aggregate.resample({"a": [1.0, 2.0], "b": [10.0, 20.0, 30.0]}, draws=500)
    assert np.array_equal(drawn["b"], again["b"])


def test_bootstrap_interval_agrees_with_scipy() -> None:
    values = np.random.default_rng(1).normal(size=20)
    ours = aggregate.bootstrap({"one": values}, lambda strata: strata["one"].mean(axis=-1), draws=5000)
    theirs = stats.bootstrap(
        (values,), np.mean, n_resamples=5000, method="percentile", rng=np.random.default_rng(2)
    )
    assert ours.value == pytest.approx(values.mean())
    assert ours.low == pytest.approx(theirs.confidence_interval.low, abs=0.03)
    assert ours.high == pytest.approx(theirs.confidence_interval.high, abs=0.03)


def test_iqm_of_equal_runs_has_no_width() -> None:
    estimate = aggregate.bootstrap_iqm({"a": [0.5] * 3, "b": [0.5] * 4})
    assert (estimate.value, estimate.low, estimate.high) == (0.5, 0.5, 0.5)
    assert str(estimate) == "0.50 [0.50, 0.50]"


def test_profile_by_hand() -> None:
    # Above .5: one of two runs of a, none of b; every domain weighs the same.
    profile = aggregate.performance_profile({"a": [0.2, 0.8], "b": [0.1, 0.2, 0.3]}, [0.0, 0.25, 0.5, 1.0])
    assert profile["share"].tolist() == pytest.approx([1.0, (1 / 2 + 1 / 3) / 2, 0.25, 0.0])
    assert (profile["low"] <= profile["share"]).all()
    assert (profile["share"] <= profile["high"]).all()


def test_probability_of_improvement_by_hand() -> None:
    # Domain a: pairs (3,1) win, (3,3) tie, (2,1) win, (2,3) lose: 2.5 of 4. Domain b: always. Domain c is not shared.
    x, y = {"a": [3.0, 2.0], "b": [5.0], "c": [0.0]}, {"a": [1.0, 3.0], "b": [4.0]}
    estimate = aggregate.improvement_probability(x, y)
    assert estimate.value == pytest.approx((2.5 / 4 + 1) / 2)
    u = stats.mannwhitneyu(x["a"], y["a"]).statistic
    assert u / 4 == 2.5 / 4
    assert estimate.low <= estimate.value <= estimate.high


def test_steps_to_a_level() -> None:
    learnt = curve("hallway", "ah-ch", 0, [100, 200, 300], [0.0, 0.5, 0.4])
    assert aggregate.steps_to(learnt, "return_100", 0.25) == 150.0
    assert aggregate.steps_to(learnt, "return_100", 0.5) == 200.0
    assert aggregate.steps_to(learnt, "return_100", 0.6) == math.inf
    early = learnt.assign(episodes=[50, 100, 200])  # the first mean is over too few episodes
    assert aggregate.steps_to(early, "return_100", 0.25) == 200.0


def test_median_steps_with_runs_that_never_get_there() -> None:
    good = curve("hallway", "ah-ch", 0, [100, 200], [0.0, 1.0])
    bad = curve("hallway", "ah-ch", 1, [100, 200], [0.0, 0.1])
    assert aggregate.sample_efficiency([good, good, bad], "return_100", 0.9).value == pytest.approx(190.0)
    never = aggregate.sample_efficiency([good, bad], "return_100", 0.9)
    assert never.value == math.inf
    assert never.high == math.inf
