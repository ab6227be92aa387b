from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bgn.analysis import paper, verdicts
from bgn.analysis.paper import Printed
from bgn.analysis.statistics import Sample, equivalence_p, welch_p
from bgn.analysis.verdicts import Verdict

TOLERANCES = {"hallway": 0.05, "hallway-2": 0.05, "rocksample-4-4": 1.0, "rocksample-5-5": 1.0}
CELL = ("rocksample-4-4", "ah-ch+bgn")  # the paper: 14.14 ± 0.21


@pytest.mark.parametrize(
    ("ours", "expected"),
    [
        (Sample(14.14, 0.2, 10), Verdict.REPRODUCED),
        (Sample(13.70, 0.2, 10), Verdict.NEGLIGIBLE_SHIFT),
        (Sample(17.00, 0.2, 10), Verdict.EXCEEDS),
        (Sample(11.00, 0.2, 10), Verdict.FALLS_SHORT),
        (Sample(13.00, 6.0, 10), Verdict.INCONCLUSIVE),
        # The paper's own mean, but three seeds are too few where the test is one of twenty.
        (Sample(14.14, 0.2, 3), Verdict.INCONCLUSIVE),
    ],
)
def test_the_outcomes(ours: Sample, expected: Verdict) -> None:
    assert verdicts.judge_numbers({CELL: ours}, TOLERANCES)[CELL].verdict is expected


def test_both_families_are_corrected_for_all_twenty_numbers() -> None:
    ours = Sample(13.9, 0.2, 10)
    alone = verdicts.judge_numbers({CELL: ours}, TOLERANCES)[CELL]
    assert alone.p_difference == pytest.approx(20 * verdicts.difference_p(ours, paper.RETURNS[CELL]))
    uncorrected = verdicts.rounded_equivalence_p(ours, paper.RETURNS[CELL], tolerance=1.0)
    assert alone.p_equivalence == pytest.approx(20 * uncorrected)
    assert alone.power > 0.99


def test_equivalence_is_out_of_reach_in_two_cells_of_the_paper() -> None:
    out = {
        cell
        for cell, printed in paper.RETURNS.items()
        if not verdicts.attainable(printed, tolerance=TOLERANCES[cell[0]])
    }
    assert out == {("hallway", "ah-cs"), ("rocksample-4-4", "ah-cb")}


def test_single_runs_and_cells_without_numbers_are_not_judged() -> None:
    ours = {CELL: Sample(14.0, 0.0, 1), ("hallway", "ab-cb+bgn"): Sample(0.5, 0.1, 10)}
    assert verdicts.judge_numbers(ours, TOLERANCES) == {}


def test_a_difference_within_the_rounding_is_none() -> None:
    # 0.54±0.01 may stand for 0.544±0.015, so a precise 0.544 does not differ.
    assert verdicts.difference_p(Sample(0.544, 1e-4, 10), Printed(0.54, 0.01)) == pytest.approx(1.0)


@given(
    st.floats(-1, 1), st.floats(0.001, 0.5), st.floats(-1, 1), st.floats(0.005, 1), st.sampled_from([-1, 1])
)
def test_rounding_is_taken_at_its_least_favourable(
    mean: float, sd: float, at_mean: float, printed_sd: float, at_sd: int
) -> None:
    ours, printed = Sample(mean, sd, 5), Printed(0.0, printed_sd)
    true = Sample(at_mean * paper.HALF_UNIT, printed_sd + at_sd * paper.HALF_UNIT, paper.SEEDS)
    assert welch_p(ours, true) <= verdicts.difference_p(ours, printed) + 1e-6
    rounded = verdicts.rounded_equivalence_p(ours, printed, tolerance=0.1)
    assert equivalence_p(ours, true, tolerance=0.1) <= rounded + 1e-6


def test_perfection_is_of_seeds() -> None:
    judge = verdicts.judge_perfection
    assert judge([1.0] * 3, [1000] * 3, tolerance=0.01).verdict is Verdict.REPRODUCED
    assert judge([0.990, 0.995, 0.998], [1000] * 3, tolerance=0.01).verdict is Verdict.INCONCLUSIVE
    assert judge([0.8, 0.82, 0.81], [1000] * 3, tolerance=0.01).verdict is Verdict.FALLS_SHORT
    assert judge([1.0] * 3, [100] * 3, tolerance=0.01).verdict is Verdict.INCONCLUSIVE
    assert judge([1.0], [100000], tolerance=0.01).verdict is Verdict.TOO_FEW_RUNS


def test_claims_of_being_below_the_grounded_agent() -> None:
    better = {"top-plate": Sample(0.99, 0.01, 10)}
    ours = {
        ("top-plate", "ah-ch"): Sample(0.2, 0.1, 10),
        ("top-plate", "ab-cb"): Sample(0.985, 0.02, 10),
        ("two-bumps-1d", "ah-ch"): Sample(0.2, 0.1, 10),
    }
    tolerances = {"top-plate": 0.01, "two-bumps-1d": 0.01}
    found = verdicts.judge_below(ours, better, tolerances)
    assert {cell: judgement.verdict for cell, judgement in found.items()} == {
        ("top-plate", "ah-ch"): Verdict.REPRODUCED,
        ("top-plate", "ab-cb"): Verdict.INCONCLUSIVE,
    }
    reversed_ = verdicts.judge_below(
        {("top-plate", "ah-ch"): Sample(0.9, 0.01, 10)}, {"top-plate": Sample(0.2, 0.1, 10)}, tolerances
    )
    assert reversed_["top-plate", "ah-ch"].verdict is Verdict.EXCEEDS
    as_good = verdicts.judge_below(
        {
            ("top-plate", "ah-ch"): Sample(1.0, 0.0, 10, 0.0007),
            ("top-plate", "ah-cs"): Sample(0.98, 0.02, 10),
        },
        {"top-plate": Sample(1.0, 0.0, 10, 0.0007)},
        tolerances,
    )
    assert as_good["top-plate", "ah-ch"].verdict is Verdict.EXCEEDS
    assert as_good["top-plate", "ah-cs"].verdict is Verdict.INCONCLUSIVE
