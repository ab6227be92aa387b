from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bgn.analysis.statistics import (
    Sample,
    at_least_p,
    binomial_interval,
    detectable_gap,
    equivalence_p,
    equivalence_power,
    holm,
    mean_interval,
    mean_p,
    prediction_interval,
    rank_sum_p,
    rate_error,
    rate_interval,
    rate_p,
    spearman_within,
    welch_p,
)

values = st.lists(st.floats(-100, 100), min_size=2, max_size=12).filter(lambda v: np.std(v) > 1e-3)


@given(values, values)
def test_welch_agrees_with_scipy(a: list[float], b: list[float]) -> None:
    for tail in ("two-sided", "less", "greater"):
        expected = stats.ttest_ind(a, b, equal_var=False, alternative=tail).pvalue
        assert welch_p(Sample.of(a), Sample.of(b), tail=tail) == pytest.approx(expected, abs=1e-9)


@given(values, st.floats(-100, 100))
def test_a_mean_against_a_value_agrees_with_scipy_and_with_its_interval(v: list[float], value: float) -> None:
    sample = Sample.of(v)
    for tail in ("two-sided", "less", "greater"):
        expected = stats.ttest_1samp(v, value, alternative=tail).pvalue
        assert mean_p(sample, value, tail=tail) == pytest.approx(expected, abs=1e-9)
    low, high = mean_interval(sample)
    if min(abs(value - low), abs(value - high)) > 1e-6 * (high - low):
        assert (mean_p(sample, value, tail="less") < 0.025) == (value > high)
        assert (mean_p(sample, value, tail="greater") < 0.025) == (value < low)


@given(st.lists(st.integers(0, 40), min_size=2, max_size=6), st.floats(0.01, 0.99))
def test_a_rate_against_a_value_agrees_with_its_interval(successes: list[int], value: float) -> None:
    rates, episodes = [count / 40 for count in successes], [40] * len(successes)
    low, high = rate_interval(rates, episodes)
    if min(abs(value - low), abs(value - high)) > 1e-6:
        assert (rate_p(rates, episodes, value, tail="less") < 0.025) == (value > high)
        assert (rate_p(rates, episodes, value, tail="greater") < 0.025) == (value < low)


def test_nothing_is_sure_of_a_mean_without_spread() -> None:
    assert math.isnan(mean_p(Sample(0.5, 0.0, 3), 0.1, tail="greater"))
    assert math.isnan(mean_p(Sample(0.5, 0.0, 1, error=0.1), 0.1, tail="greater"))
    # Three seeds that always succeed in 40 episodes: .9 of 120 all at once is .9^120.
    assert rate_p([1.0] * 3, [40] * 3, 0.9, tail="greater") == pytest.approx(0.9**120)


def test_at_least_so_many_of_some() -> None:
    p = [0.01, 0.2, 0.02, math.nan]
    assert at_least_p(p, 1) == pytest.approx(4 * 0.01)
    assert at_least_p(p, 2) == pytest.approx(3 * 0.02)
    assert at_least_p(p, 3) == pytest.approx(2 * 0.2)
    assert at_least_p(p, 4) == 1.0


def test_welch_by_hand() -> None:
    # Unbiased variances 1 and 4, three values each: t = 2 / sqrt(1/3 + 4/3), df = (25/9) / (17/18).
    a, b = Sample.of([4, 5, 6]), Sample.of([1, 3, 5])
    t, freedom = 2 / math.sqrt(5 / 3), (25 / 9) / (17 / 18)
    assert welch_p(a, b) == pytest.approx(2 * stats.t.sf(t, freedom))


def test_no_spread_and_no_known_error_is_no_certainty() -> None:
    same, other = Sample(1.0, 0.0, 3), Sample(2.0, 0.0, 3)
    assert math.isnan(welch_p(same, same))
    assert math.isnan(welch_p(same, other))
    assert math.isnan(equivalence_p(same, other, tolerance=5.0))
    assert math.isnan(detectable_gap(same, other, level=0.05))


def test_spread_is_never_less_than_the_error_of_measuring() -> None:
    # Three seeds that all succeeded a hundred times of a hundred: (100.5 / 101), its error over 100 episodes.
    rate = 100.5 / 101
    error = math.sqrt(rate * (1 - rate) / 100)
    assert rate_error(1.0, 100) == pytest.approx(error)
    perfect = Sample.of([1.0, 1.0, 1.0], [rate_error(1.0, 100)] * 3)
    assert perfect.unbiased_sd == pytest.approx(error)
    # Against .99 in three seeds of as many episodes: not significant, though neither has any spread.
    other = Sample.of([0.99, 0.99, 0.99], [rate_error(0.99, 100)] * 3)
    assert 0.05 < welch_p(other, perfect, tail="less") < 0.5
    # Where seeds differ by more, their spread counts.
    assert Sample.of([0.0, 1.0], [0.01, 0.01]).unbiased_sd == pytest.approx(math.sqrt(0.5))


def test_power_by_hand() -> None:
    # Unbiased deviation 1, ten values each: the difference's error is sqrt(.2), 18 degrees of freedom.
    sd = 1 / math.sqrt(10 / 9)
    a, b = Sample(0.0, sd, 10), Sample(0.0, sd, 10)
    error = math.sqrt(0.2)
    reach = stats.t.ppf(0.975, 18) + stats.t.ppf(0.8, 18)
    assert detectable_gap(a, b, level=0.05) == pytest.approx(reach * error)
    expected = 2 * stats.t.cdf(2 / error - stats.t.ppf(0.95, 18), 18) - 1
    assert equivalence_power(a, b, tolerance=2.0, level=0.05) == pytest.approx(expected)
    assert equivalence_power(a, b, tolerance=0.1, level=0.05) == 0.0


def test_detectable_gap_is_seen_four_times_in_five() -> None:
    random = np.random.default_rng(0)
    gap = detectable_gap(Sample(0, math.sqrt(0.9), 10), Sample(0, math.sqrt(0.9), 10), level=0.05)
    a, b = random.normal(size=(4000, 10)), random.normal(gap, size=(4000, 10))
    seen = np.mean(stats.ttest_ind(a, b, axis=1, equal_var=False).pvalue < 0.05)
    assert seen == pytest.approx(0.8, abs=0.03)


def test_rate_interval_keeps_seeds_and_episodes_in_sight() -> None:
    # .990, .995, .998: pooled "perfect" (.992 at the lower end), but a seed's mean may be .984.
    low, high = rate_interval([0.990, 0.995, 0.998], [1000] * 3)
    assert low == pytest.approx(0.9843, abs=2e-4)
    assert high == 1.0
    # 300 of 300 in three seeds without any spread: Clopper-Pearson's .025^(1/300).
    assert rate_interval([1.0, 1.0, 1.0], [100] * 3) == pytest.approx((0.025 ** (1 / 300), 1.0))
    assert rate_interval([0.5], [1000]) == (0.0, 1.0)  # one seed says nothing of others


def test_rank_sums_are_exact_with_ties_too() -> None:
    # Of the 20 ways to choose three of six, one gives the three lowest, tied or not.
    assert rank_sum_p([1, 2, 3], [4, 5, 6]) == pytest.approx(1 / 20)
    assert rank_sum_p([1, 2, 3], [math.inf] * 3) == pytest.approx(1 / 20)
    assert rank_sum_p([math.inf] * 3, [1, 2, 3]) == rank_sum_p([4, 4], [4, 4]) == 1
    # Ranks 1, 2.5, 2.5 and 4: sums of two are 3.5, 3.5, 5, 5, 6.5 and 6.5.
    assert rank_sum_p([1, 2], [2, 3]) == pytest.approx(2 / 6)
    random = np.random.default_rng(0)
    a, b = random.normal(size=10), random.normal(1, size=10)
    exact = stats.mannwhitneyu(a, b, alternative="less", method="exact").pvalue
    assert rank_sum_p(a.tolist(), b.tolist()) == pytest.approx(exact)


def test_rank_correlation_within_strata_by_hand() -> None:
    # Centred ranks -1.5, -.5, .5, 1.5: products add up to -5 in the first stratum and -3 in the second, of 5 + 5.
    # r = -8 / 10 with 8 - 1 - 2 = 5 degrees of freedom: t = -.8 sqrt(5 / .36) = -2.981, p = .031 (.017 with 6).
    strata = [([1, 2, 3, 4], [9, 8, 7, 6]), ([10, 20, 30, 40], [300, 400, 100, 200])]
    rho, p = spearman_within(strata)
    assert rho == pytest.approx(-0.8)
    assert p == pytest.approx(2 * stats.t.sf(2.981424, 5))
    assert p == pytest.approx(0.0307, abs=1e-4)
    # A stratum's level, which separates them here, is no part of it.
    assert spearman_within([([1, 2], [1, 2]), ([8, 9, 10], [-1, -2, -3])])[0] < 0
    assert spearman_within([]) == pytest.approx((math.nan, math.nan), nan_ok=True)


def test_rank_correlation_in_one_stratum_is_spearman_s() -> None:
    x, y = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0], [2.0, 7.0, 1.0, 8.0, 2.0, 8.0]
    expected = stats.spearmanr(x, y)
    assert spearman_within([(x, y)]) == pytest.approx((expected.statistic, expected.pvalue))
    assert spearman_within([([1, 2, 3, 4], [4, 3, 2, 1])]) == pytest.approx((-1.0, 0.0))
    assert math.isnan(spearman_within([([1, 2, 3], [5, 5, 5])])[0])
    assert math.isnan(
        spearman_within([([1, 2], [2, 1])])[0]
    )  # two points lie on a line: no degree of freedom


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
    # What could not be tested stays undecided, and counts as not done yet.
    undecided = holm([0.01, math.nan], family=2)
    assert undecided[0] == pytest.approx(0.02)
    assert math.isnan(undecided[1])
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
