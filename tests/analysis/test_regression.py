from __future__ import annotations

import pytest

from bgn.analysis.regression import Outcome, Rule, alarm_rates, worst
from bgn.analysis.statistics import Sample, welch_p

REFERENCE = Sample.of([10.0, 11.0, 9.0, 10.5, 9.5, 10.0, 11.0, 9.0, 10.5, 9.5])


def test_screen_looks_for_a_drop_of_one_deviation() -> None:
    rule, limit = Rule(), REFERENCE.mean - REFERENCE.unbiased_sd
    assert rule.suspicious(REFERENCE, Sample(limit - 0.01, 0.1, 3))
    assert not rule.suspicious(REFERENCE, Sample(limit + 0.01, 0.1, 3))
    assert not rule.suspicious(REFERENCE, Sample(20.0, 0.1, 3))  # better is no regression


def test_confirmation() -> None:
    rule = Rule()
    much = Sample(8.0, 0.7, 10)
    assert rule.confirm(REFERENCE, much) is Outcome.REGRESSED
    assert rule.p_value(REFERENCE, much) == welch_p(much, REFERENCE, tail="less")
    assert rule.confirm(REFERENCE, Sample(9.1, 0.7, 10)) is Outcome.UNCLEAR
    assert rule.confirm(REFERENCE, Sample(10.1, 0.7, 10)) is Outcome.FINE


def test_false_alarms_and_power_of_the_rule() -> None:
    rule = Rule()
    unchanged = alarm_rates(rule, drop=0)
    assert unchanged.any_cell == pytest.approx(0.006, abs=0.006)
    assert unchanged.any_open == pytest.approx(0.067, abs=0.02)
    assert alarm_rates(rule, drop=0, cells=2, repeats=20_000).any_open == pytest.approx(0.008, abs=0.004)
    assert alarm_rates(rule, drop=2).cell == pytest.approx(0.73, abs=0.03)
    assert alarm_rates(rule, drop=3).cell == pytest.approx(0.99, abs=0.01)


def test_what_is_not_asked_for_cries_wolf() -> None:
    # Without the second stage's level, one in two looks at twenty unchanged cells would be an alarm or more.
    assert alarm_rates(Rule(level=0.05), drop=0).any_cell > 0.1
    one_stage = Rule(screening_sds=-100.0, confirming_seeds=5, level=0.05)
    assert alarm_rates(one_stage, drop=0).any_cell > 0.5


def test_verdict_of_all_cells() -> None:
    assert worst([Outcome.FINE, Outcome.UNCLEAR, Outcome.REGRESSED]) is Outcome.REGRESSED
    assert worst([Outcome.FINE, Outcome.UNCLEAR]) is Outcome.UNCLEAR
    assert worst([Outcome.FINE]) is Outcome.FINE
    assert worst([]) is Outcome.UNCLEAR
