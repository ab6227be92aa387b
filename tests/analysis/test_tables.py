from __future__ import annotations

import json
from collections.abc import Mapping

import pandas as pd
import pytest

from bgn.agents.specs import AGENTS
from bgn.analysis import tables
from bgn.analysis.cells import DomainRow, summarise
from bgn.analysis.evidence import Evidence
from bgn.analysis.text_table import TextTable, plus_minus
from bgn.results.schema import HIDDEN

DOMAINS = (
    DomainRow("hallway", "Hallway", "classic", "greedy_return", 0.05, HIDDEN),
    DomainRow("rocksample-4-4", "RockSample[4,4]", "classic", "train_return", 1.0, HIDDEN),
    DomainRow("top-plate", "TopPlate", "robot", "train_success", 0.05),
)


def run(domain: str, agent: str, **metrics: float | bool) -> dict[str, object]:
    names = [f"{kind}_{what}" for kind in ("train", "sampled", "greedy") for what in ("return", "success")]
    spec = json.dumps({"evaluation_episodes": 1000})
    row = {"domain": domain, "agent": agent, "spec": spec, "older": False}
    return row | dict.fromkeys(names, 0.0) | metrics


def reference(domain: str, policy: str, convention: str, value: float) -> dict[str, object]:
    row = {"domain": domain, "reference": policy, "convention": convention, "return": value}
    return row | {"return_se": 0.1, "return_sd": 3.0}


RUNS = [
    run("hallway", "ah-ch+bgn", greedy_return=0.52, train_return=0.4),
    run("hallway", "ah-ch+bgn", greedy_return=0.56, train_return=0.5),
    run("rocksample-4-4", "ah-ch", train_return=7.0, older=True),
    run("rocksample-4-4", "ah-ch", train_return=9.0),
    run("top-plate", "ah-ch+bgn", train_success=1.0, sampled_success=1.0, physics_success=0.95)
    | {"sampled_length": 9.25, "sampled_belief_kl": 0.5},
    run("top-plate", "ah-ch", train_success=0.1, sampled_success=0.1, physics_success=0.15),
]
REFERENCES = [
    reference("rocksample-4-4", "sarsop", "clean", 18.0),
    reference("rocksample-4-4", "sarsop", "hidden-first-action", 14.0),
    reference("rocksample-4-4", "random", "hidden-first-action", -62.0),
    reference("rocksample-4-4", "random", "clean", -82.0),
    reference("top-plate", "random", "clean", 0.04) | {"length": 5.0},
    reference("top-plate", "perfect", "clean", 1.0) | {"length": 8.3},
]


def evidence(references: list[dict[str, object]] = REFERENCES) -> Evidence:
    runs = pd.DataFrame(RUNS)
    return Evidence(
        cells=summarise(runs, DOMAINS, AGENTS),
        runs=runs,
        references=pd.DataFrame(references),
        domains=DOMAINS,
        agent_titles={agent: spec.title for agent, spec in AGENTS.items()},
        reference_titles={"random": "Random", "sarsop": "SARSOP"},
    )


def rows(grid: TextTable) -> dict[tuple[str, str], Mapping[str, str]]:
    """Index a grid by domain title and row label."""
    found, title = {}, ""
    for row in grid.rows:
        title = row[0] or title
        found[title, row[1]] = dict(zip(grid.columns, row, strict=True))
    return found


def test_cells_use_the_paper_s_metric() -> None:
    cells = evidence().cells.set_index(["domain", "agent"])
    bgn = cells.loc["hallway", "ah-ch+bgn"]
    assert (bgn["metric"], bgn["runs"], bgn["mean"], bgn["sd"]) == pytest.approx(
        ("greedy_return", 2, 0.54, 0.02)
    )
    assert bgn["paper_mean"] == 0.54
    assert cells.loc["rocksample-4-4", "ah-ch"]["mean"] == 8.0
    assert cells.loc["rocksample-4-4", "ah-ch"]["older_runs"] == 1
    assert cells.loc["top-plate", "ah-ch"]["verdict"] == "too few runs"
    assert cells.loc["top-plate", "ah-ch+bgn"]["verdict"] == "reproduced"


def test_raw_table_has_ours_above_the_paper_s() -> None:
    table = rows(tables.raw_returns(evidence()))
    assert table["Hallway", "ours"]["Ah-Ch+BGN"] == "0.54±0.02"
    assert table["Hallway", "paper"]["Ah-Ch+BGN"] == "0.54±0.01"
    assert table["Hallway", "ours"]["Ah-Ch"] == "–"
    assert table["Hallway", "paper"]["Ah-Ch"] == "0.50±0.02"
    assert table["RockSample[4,4]", "ours"]["Ah-Ch"] == "8.00±1.00‡"
    assert table["RockSample[4,4]", "ours"]["SARSOP"] == "18.00±0.20"
    assert table["RockSample[4,4]", "ours"]["Random"] == "-62.00±3.00"
    assert table["RockSample[4,4]", "paper"]["Ab-Cb+BGN"] == "–"
    assert ("TopPlate", "ours") not in table


def test_normalised_by_hand() -> None:
    table = rows(tables.normalised_returns(evidence()))
    # (8 + 62) / (18 + 62) and 1 / 80; under one convention (8 + 62) / (14 + 62) and 1 / 76.
    assert table["RockSample[4,4]", "ours"]["Ah-Ch"] == "0.88±0.01"
    assert table["RockSample[4,4]", "ours, consistent"]["Ah-Ch"] == "0.92±0.01"
    # The paper's 14.14 by its own 17.75 and -62, then by our 14 and -62.
    assert table["RockSample[4,4]", "paper"]["Ah-Ch+BGN"] == "0.95±0.00"
    assert table["RockSample[4,4]", "paper, consistent"]["Ah-Ch+BGN"] == "1.00±0.00"


def test_borrowed_yardsticks_are_marked() -> None:
    grid = tables.normalised_returns(evidence())
    # No reference rows for Hallway: (.54 - .05) / (.53 - .05), and nothing under the consistent convention.
    assert rows(grid)["Hallway", "ours†"]["Ah-Ch+BGN"] == "1.02±0.04"
    assert rows(grid)["Hallway", "ours, consistent†"]["Ah-Ch+BGN"] == "–"
    assert any(note.startswith("†") for note in grid.notes)


def test_robot_table_has_physics_random_and_perfect() -> None:
    table = rows(tables.success_rates(evidence()))
    assert table["TopPlate", "ours"]["Ah-Ch+BGN"] == "1.00±0.00"
    assert table["TopPlate", "ours"]["Random"] == "0.04±0.20"
    assert table["TopPlate", "ours"]["Perfect"] == "1.00"
    lengths = table["TopPlate", "steps an episode"]
    assert (lengths["Ah-Ch+BGN"], lengths["Random"], lengths["Perfect"]) == ("9.25±0.00", "5.00", "8.30")
    assert table["TopPlate", "ours, in MuJoCo"]["Ah-Ch"] == "0.15±0.00"
    assert table["TopPlate", "paper's claim"]["Ah-Ch+BGN"] == "="


def test_reference_table_shows_both_conventions() -> None:
    table = rows(tables.reference_policies(evidence()))
    sarsop = table["RockSample[4,4]", "SARSOP"]
    assert sarsop["clean start"] == "18.000±0.196"
    assert sarsop["hidden first action"] == "14.000±0.196"
    assert sarsop["paper"] == "17.75±0.12"


def test_all_metrics_mark_the_paper_s() -> None:
    table = rows(tables.all_metrics(evidence()))
    assert table["Hallway", "last 100 training"]["Ah-Ch+BGN"] == "0.45±0.05"
    assert table["Hallway", "evaluated, greedy *"]["Ah-Ch+BGN"] == "0.54±0.02"
    assert table["TopPlate", "KL of the belief, nats"]["Ah-Ch+BGN"] == "0.500±0.000"
    assert table["TopPlate", "KL of the belief, nats"]["Ah-Ch"] == "–"
    assert ("Hallway", "KL of the belief, nats") not in table


def test_tables_without_any_reference_rows() -> None:
    bare = evidence(references=[])
    assert rows(tables.raw_returns(bare))["Hallway", "ours"]["SARSOP"] == "–"
    assert rows(tables.success_rates(bare))["TopPlate", "ours"]["Random"] == "–"
    assert rows(tables.success_rates(bare))["TopPlate", "ours"]["Perfect"] == "–"


def test_markdown() -> None:
    grid = TextTable("Title", ["a", "b"], [["x|y", "1"]], ["note"])
    assert grid.markdown() == "## Title\n\n| a | b |\n| --- | --- |\n| x\\|y | 1 |\n\n- note\n"


def test_plus_minus() -> None:
    assert plus_minus(1.0, 0.25) == "1.00±0.25"
    assert plus_minus(1.0, None) == "1.00"
    assert plus_minus(None, 0.1) == plus_minus(float("nan"), 0.1) == "–"
