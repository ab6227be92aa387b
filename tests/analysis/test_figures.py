from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from bgn.analysis.figures import across, curves, schematic, style
from bgn.domains.episode_opening import CLEAN, HIDDEN
from tests.analysis._evidence import AGENTS, cell, curve, reference, scores

RUNS = [
    *cell("hallway", "ah-ch", [0.3, 0.4]),
    *cell("hallway", "ah-ch+bgn", [0.5, 0.5], sampled_belief_kl=0.1),
    *cell("top-plate", "ah-ch+bgn", [1.0, 0.9], sampled_belief_kl=0.1),
]
CURVES = [
    curve(
        domain,
        agent,
        seed,
        [100, 1000, 10000],
        [0.1, 0.2 + 0.2 * seed, 0.9],
        belief_cross_entropy=[3.0, 2.0, 1.0],
    )
    for domain, agent in (("hallway", "ah-ch"), ("hallway", "ah-ch+bgn"), ("top-plate", "ah-ch+bgn"))
    for seed in (0, 1)
]
REFERENCES = [
    reference("hallway", "sarsop", CLEAN, 0.53),
    reference("hallway", "sarsop", HIDDEN, 0.54),
    reference("hallway", "random", HIDDEN, 0.05),
    reference("top-plate", "random", CLEAN, 0.04, success=0.04),
    reference("top-plate", "perfect", CLEAN, 1.0),
]
SCORES, EMPTY = scores(RUNS, CURVES, REFERENCES), scores([])
POLICIES = {"sarsop": "SARSOP", "qmdp": "QMDP", "drive-east": "Drive east"}
FIGURES = {
    "training curves": lambda s: curves.training_curves(s, AGENTS),
    "success curves": lambda s: curves.success_curves(s, AGENTS),
    "belief losses": lambda s: curves.belief_losses(s, AGENTS),
    "every seed": lambda s: across.every_seed(s, AGENTS, "classic"),
    "profiles": lambda s: across.performance_profiles(s, AGENTS),
    "belief against score": lambda s: across.belief_against_score(s, AGENTS),
    "openings": lambda s: across.openings(s, AGENTS, POLICIES),
    "cost": lambda s: across.cost(s, AGENTS),
}


def test_band_is_clipped_to_the_possible() -> None:
    band = curves.band(CURVES[:2], "success_100", within=(0.0, 0.35))
    assert band["env_steps"].iloc[[0, -1]].tolist() == pytest.approx([100, 10000])
    middle = band.iloc[(band["env_steps"] - 1000).abs().argmin()]
    assert middle["mean"] == pytest.approx(0.3, abs=0.01)  # of .2 and .4, sd .1
    assert middle["low"] == pytest.approx(0.2, abs=0.01)
    assert middle["high"] == 0.35
    assert (band["high"] <= 0.35).all()


def test_a_band_begins_where_all_runs_have_a_full_window() -> None:
    late = CURVES[0].assign(episodes=[50, 200, 300])
    assert curves.band([late, CURVES[1]], "success_100")["env_steps"].iloc[0] == pytest.approx(1000)
    assert curves.band([], "success_100").empty


@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_something_and_of_nothing(name: str) -> None:
    drawn = FIGURES[name](SCORES)
    image = np.asarray(Image.open(io.BytesIO(style.png(drawn, 40))).convert("RGB"))
    assert image.std() > 5
    assert isinstance(FIGURES[name](EMPTY), Figure)


def test_the_same_bytes_each_time() -> None:
    assert style.svg(schematic.architecture()) == style.svg(schematic.architecture())
    assert style.png(schematic.architecture(), 30) == style.png(schematic.architecture(), 30)


def test_curves_say_how_many_runs_they_are_of_and_start_on_a_log_axis() -> None:
    drawn = curves.training_curves(SCORES, AGENTS)
    (axes,) = (a for a in drawn.axes if a.get_visible() and a.has_data())
    assert axes.get_title("left") == "Hallway  n = 2"
    assert axes.get_xscale() == "log"
    levels = {line.get_label(): line.get_ydata()[0] for line in axes.lines if len(set(line.get_ydata())) == 1}
    assert levels["SARSOP (opening as the agents)"] == 0.54  # not the clean start's .53
    assert levels["Random"] == 0.05


def test_colours_of_agents_that_the_paper_does_not_have() -> None:
    agents = ("ah-ch", "mine", "yours")
    assert style.colour("ah-ch", agents) == style.COLOURS["ah-ch"]
    assert style.colour("mine", agents) != style.colour("yours", agents)
    assert not {style.colour("mine", agents), style.colour("yours", agents)} & set(style.COLOURS.values())


def test_tables_across_domains() -> None:
    table = across.aggregates(SCORES, AGENTS, "classic").set_index("agent")
    assert table.loc["Ah-Ch", "runs"] == 2
    assert table.loc["Ah-Ch", "P(Ah-Ch+BGN better) [95 %]"] == "1.00 [1.00, 1.00]"
    # 90 % of .54 is .486, reached between 1000 (.2 or .4) and 10000 (.9).
    steps = across.efficiency(SCORES, AGENTS)
    assert steps.loc["Ah-Ch", "Hallway"].startswith("5 k")
    assert across.efficiency(EMPTY, AGENTS).empty
