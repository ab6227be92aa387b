from __future__ import annotations

import math

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bgn.analysis.collapses import LEARNT, LOST, collapses, late_success
from tests.analysis._evidence import curve


def _curve(*values: float, entropy: float = 0.5, length: float = 50.0) -> pd.DataFrame:
    steps = [100_000.0 * (i + 1) for i in range(len(values))]
    return curve(
        "top-plate",
        "ah-ch",
        0,
        steps,
        values,
        episodes=[s / length for s in steps],
        entropy=[entropy] * len(values),
    )


def test_a_run_that_never_learns_does_not_collapse() -> None:
    found = collapses(_curve(0.0, 0.1, 0.0, 0.19, 0.0))
    assert (found.count, found.recoveries, found.ends_lost) == (0, 0, False)
    assert math.isnan(found.entropy)
    assert math.isnan(found.episode_steps)


def test_collapses_and_recoveries_by_hand() -> None:
    # Up, down, up again, half down (no collapse), up, down: two collapses, and one recovery.
    found = collapses(_curve(0.0, 0.5, 0.0, 0.1, 0.0, 0.9, 0.05, 0.3, 0.01))
    assert (found.count, found.recoveries, found.ends_lost) == (2, 1, True)
    assert collapses(_curve(0.5, 0.0, 0.2)).ends_lost is False


def test_what_is_done_while_lost() -> None:
    frame = _curve(0.5, 0.0, 0.0, 0.9)
    frame["entropy"] = [0.1, 0.6, 0.8, 0.2]
    frame["episodes"] = [10_000, 12_000, 16_000, 30_000]  # 100,000 steps to a point: 50 and 25 to an episode
    found = collapses(frame)
    assert found.entropy == pytest.approx(0.7)
    assert found.episode_steps == pytest.approx(37.5)


def test_what_comes_before_a_full_window_does_not_count() -> None:
    frame = _curve(1.0, 0.0, 0.0)
    frame["episodes"] = [20, 2000, 4000]
    assert collapses(frame).count == 0


def test_late_success_weighs_by_steps() -> None:
    # The last fifth of 1 M steps: from 0.8 M (.4) over 0.9 M (.6) to 1 M (0): (.5 + .3) / 2.
    assert late_success(_curve(*[1.0] * 7, 0.4, 0.6, 0.0)) == pytest.approx(0.4)
    assert late_success(_curve(0.3)) == 0.3
    assert math.isnan(late_success(_curve()))


@given(st.lists(st.sampled_from([0.0, LOST, 0.1, LEARNT, 0.7]), max_size=40))
def test_every_recovery_follows_a_collapse(values: list[float]) -> None:
    found = collapses(_curve(*values))
    assert found.recoveries <= found.count <= found.recoveries + 1
    # Moving over the curve's extremes alone gives the same count: what lies between them changes nothing.
    extremes = [v for v in values if v >= LEARNT or v <= LOST]
    alone = collapses(_curve(*extremes))
    assert (alone.count, alone.recoveries) == (found.count, found.recoveries)
