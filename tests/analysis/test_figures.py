from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from bgn.analysis import figures
from bgn.analysis.cells import DomainRow
from bgn.analysis.evidence import Evidence

CURVES = pd.DataFrame(
    {
        "run": ["a", "a", "a", "b", "b"],
        "domain": "hallway",
        "agent": "ah-ch",
        "episodes": [90, 200, 300, 200, 300],
        "env_steps": [0, 100, 200, 100, 200],
        "return_100": [np.nan, 0.0, 1.0, 1.0, 3.0],
    }
)


def test_band_is_the_mean_over_runs_where_all_have_values() -> None:
    band = figures.band(CURVES, "return_100")
    first, last = band.iloc[0], band.iloc[-1]
    assert tuple(first) == pytest.approx((100, 0.5, 0.5))
    assert tuple(last) == pytest.approx((200, 2.0, 1.0))


def test_picture_has_a_panel_for_each_domain_with_curves() -> None:
    domains = [
        DomainRow("hallway", "Hallway", "classic", "greedy_return", 0.05),
        DomainRow("top-plate", "TopPlate", "robot", "train_success", 0.05),
    ]
    empty = pd.DataFrame()
    evidence = Evidence(
        cells=empty,
        runs=empty,
        references=empty,
        domains=domains,
        agent_titles={"ah-ch": "Ah-Ch"},
        reference_titles={},
    )
    one = Image.open(io.BytesIO(figures.learning_curves(evidence, CURVES)))
    robot = CURVES.assign(domain="top-plate", success_100=CURVES["return_100"])
    two = Image.open(io.BytesIO(figures.learning_curves(evidence, pd.concat([CURVES, robot]))))
    assert two.width == pytest.approx(2 * one.width, abs=2)
    assert np.asarray(one.convert("RGB")).std() > 5  # something is drawn
