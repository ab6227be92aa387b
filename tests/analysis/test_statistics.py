from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bgn.analysis.statistics import (
    Sample,
    binomial_interval,
    equivalence_p,
    holm,
    prediction_interval,
    welch_p,
)

values = st.lists(st.floats(-100, 100), min_size=2, max_size=12).filter(lambda v: np.std(v) > 1e-3)


@given(values, values)
def test_welch_agrees_with_scipy(a: list[float], b: list[float]) -> None:
    for tail in ("two-sided", "less", "greater"):
        expected = stats.ttest_ind(a, b, equal_var=False, alternative=tail).pvalue
        assert welch_p(Sample.of(a), Sample.of(b), tail=tail) == pytest.approx(expected, abs=1e-9)


def test_welch_by_hand() -> None:
    # Unbiased variances 1 and 4, three values each: t = 2 / sqrt(1/3 + 4/3), df = (25/9) / (17/18).
    a, b = Sample.of([4, 5, 6]), Sample.of([1, 3, 5])
    t, freedom = 2 / math.sqrt(5 / 3), (25 / 9) / (17 / 18)
    assert welch_p(a, b) == pytest.approx(2 * stats.t.sf(t, freedom))


def test_welch_without_spread_is_certain() -> None:
    same, other = Sample(1.0, 0.0, 3), Sample(2.0, 0.0, 3)
    assert welch_p(same, same) == 1.0
    assert welch_p(same, other) == 0.0
    assert welch_p(same, other, tail="less") == 0.0
    assert welch_p(same, other, tail="greater") == 1.0


def test_one_value_has_no_test() -> None:
    assert math.isnan(welch_p(Sample.of([1.0]), Sample(1.0, 0.1, 10)))
    assert math.isnan(equivalence_p(Sample.of([1.0]), Sample(1.0, 0.1, 10), tolerance=1.0))


def test_equivalence_is_the_larger_of_two_one_sided_tests() -> None:
    a, b = Sample.of([1.0, 1.1, 1.2]), Sample.of([1.0, 1.2, 1.1])
    shifted_up = [v + 0.5 for v in (1.0, 1.2, 1.1)]
    below = stats.ttest_ind([1.0, 1.1, 1.2], shifted_up, equal_var=False, alternative="less").pvalue
    assert equivalence_p(a, b, tolerance=0.5) == pytest.approx(below)
    assert equivalence_p(a, b, tolerance=0.05) > 0.05 > equivalence_p(a, b, tolerance=0.5)


def test_holm_by_hand() -> None:
    # Sorted .01, .02, .04 in a family of 3: .03, max(.03, .04), max(.04, .04).
    assert holm([0.04, 0.01, 0.02], family=3) == pytest.approx([0.04, 0.03, 0.04])
    # Two tests not done yet count as undecided ones.
    assert holm([0.04, 0.01, 0.02], family=5) == pytest.approx([0.12, 0.05, 0.08])
    assert holm([0.6, 0.9], family=2) == [1.0, 1.0]
    with pytest.raises(ValueError, match="family of 1"):
        holm([0.1, 0.2], family=1)


def test_binomial_interval_of_all_successes() -> None:
    # Clopper-Pearson: the lower end p satisfies p^n = 2.5 %.
    assert binomial_interval(50, 50) == pytest.approx((0.025 ** (1 / 50), 1.0))


def test_prediction_interval_for_ten_new_seeds() -> None:
    unbiased = 1 / math.sqrt(10 / 9)  # a population deviation whose unbiased estimate is 1
    low, high = prediction_interval(Sample(2.0, unbiased, 10), n=10)
    assert (low, high) == pytest.approx((2 - 1.0117, 2 + 1.0117), abs=1e-4)


def test_prediction_interval_covers_as_often_as_it_says() -> None:
    random = np.random.default_rng(0)
    old, new = random.normal(size=(4000, 10)), random.normal(size=(4000, 3)).mean(axis=1)
    intervals = [prediction_interval(Sample.of(row.tolist()), n=3) for row in old]
    covered = np.mean([low <= mean <= high for (low, high), mean in zip(intervals, new, strict=True)])
    assert covered == pytest.approx(0.95, abs=0.015)
