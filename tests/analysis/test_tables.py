from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import pandas as pd
import pytest
from rich.console import Console

from bgn.analysis import tables
from bgn.analysis.claims import judge_claims
from bgn.analysis.scores import Scores
from bgn.analysis.text_table import TextTable, plus_minus
from tests.analysis._evidence import DOMAINS, STEPS, curve, evidence, reference, run, scores

RUNS = [
    run("hallway", "ah-ch+bgn", 0, greedy_return=0.52, train_return=0.4, first_100_return=0.54),
    run("hallway", "ah-ch+bgn", 1, greedy_return=0.56, train_return=0.5, first_100_return=0.56),
    run("hallway", "ah-ch", 0, STEPS - 1, greedy_return=0.5),
    run("hallway", "ah-ch", 1, STEPS, greedy_return=0.5),
    run("rocksample-4-4", "ah-ch", 0, sampled_return=7.0, older=True),
    run("rocksample-4-4", "ah-ch", 1, sampled_return=9.0),
    run("rocksample-4-4", "ah-cb", 0, sampled_return=6.0),
    run("rocksample-4-4", "ah-cb", 1, sampled_return=6.2),
    run("top-plate", "ah-ch+bgn", 0, sampled_success=1.0, physics_success=0.95, sampled_belief_kl=0.5),
    run("top-plate", "ah-ch+bgn", 1, sampled_success=1.0, physics_success=0.95, sampled_belief_kl=0.5),
    run("top-plate", "ah-ch", 0, sampled_success=0.1, physics_success=0.15),
]
REFERENCES = [
    reference("rocksample-4-4", "sarsop", "clean", 18.0),
    reference("rocksample-4-4", "sarsop", "hidden-first-action", 14.0),
    reference("rocksample-4-4", "random", "hidden-first-action", -62.0),
    reference("rocksample-4-4", "random", "clean", -82.0),
    reference("top-plate", "random", "clean", 0.04, success=0.04),
    reference("top-plate", "perfect", "clean", 1.0),
]
EVIDENCE = evidence(RUNS, REFERENCES)


def rows(table: TextTable) -> dict[tuple[str, str], Mapping[str, str]]:
    """Index a table by title and row label."""
    found, title = {}, ""
    for row in table.rows:
        title = row[0] or title
        found[title, row[1]] = dict(zip(table.columns, row, strict=True))
    return found


def test_cells_use_the_judged_metric_and_horizon() -> None:
    cells = EVIDENCE.cells.set_index(["domain", "agent"])
    bgn = cells.loc["hallway", "ah-ch+bgn"]
    assert (bgn["metric"], bgn["runs"], bgn["mean"], bgn["sd"]) == pytest.approx(
        ("greedy_return", 2, 0.54, 0.02)
    )
    assert (bgn["authors_metric"], bgn["authors_runs"], bgn["authors_mean"]) == ("first_100_return", 2, 0.55)
    assert cells.loc["hallway", "ah-ch"]["verdict"] == "short"  # one of its two runs is
    assert cells.loc["rocksample-4-4", "ah-ch"]["older_runs"] == 1
    assert cells.loc["top-plate", "ah-ch"]["verdict"] == "too few runs"
    assert cells.loc["top-plate", "ah-ch+bgn"]["verdict"] == "reproduced"
    assert not cells.loc["rocksample-4-4", "ah-cb"]["attainable"]


def test_raw_table_has_ours_and_the_paper_s_in_one_block() -> None:
    table = rows(tables.raw_returns(EVIDENCE))
    assert table["Ah-Ch+BGN", "ours"]["Hallway"].startswith("0.54±0.02 ")
    assert table["Ah-Ch+BGN", "paper"]["Hallway"] == "0.54±0.01"
    assert table["Ah-Ch+BGN", "as authors"]["Hallway"].startswith("0.55±0.01")
    assert table["Ah-Ch", "ours"]["Hallway"] == "0.50±0.00 s"
    assert table["Ah-Ch", "ours"]["RockSample[4,4]"] == "8.00±1.00‡ ?"
    assert table["Ah-Ch", "n, power"]["RockSample[4,4]"] == "2, 0.00"
    assert table["Ah-Cb", "ours"]["RockSample[4,4]"].endswith("°")
    assert table["SARSOP", "ours"]["RockSample[4,4]"] == "18.00±0.20"
    assert table["Random", "ours"]["RockSample[4,4]"] == "-62.00±3.00"
    assert ("Ab-Cb+BGN", "paper") not in table
    assert "TopPlate" not in tables.raw_returns(EVIDENCE).columns


def test_normalised_by_hand() -> None:
    table = rows(tables.normalised_returns(EVIDENCE))
    # (8 + 62) / (18 + 62) and 1 / 80; if all rows start alike (8 + 62) / (14 + 62) and 1 / 76.
    assert table["RockSample[4,4]", "ours"]["Ah-Ch"] == "0.88±0.01"
    assert table["RockSample[4,4]", "ours, alike"]["Ah-Ch"] == "0.92±0.01"
    # The paper's 14.14 by its own 17.75 and -62, then by our 14 and -62.
    assert table["RockSample[4,4]", "paper"]["Ah-Ch+BGN"] == "0.95±0.00"
    assert table["RockSample[4,4]", "paper, alike"]["Ah-Ch+BGN"] == "1.00±0.00"


def test_borrowed_yardsticks_are_marked() -> None:
    table = tables.normalised_returns(EVIDENCE)
    # No reference rows for Hallway: (.54 - .05) / (.53 - .05), and nothing where all rows start alike.
    assert rows(table)["Hallway", "ours†"]["Ah-Ch+BGN"] == "1.02±0.04"
    assert rows(table)["Hallway", "ours, alike†"]["Ah-Ch+BGN"] == "–"
    assert any(note.startswith("†") for note in table.notes)


def test_robot_table_has_intervals_physics_random_and_perfect() -> None:
    table = rows(tables.success_rates(EVIDENCE))
    assert table["Ah-Ch+BGN", "ours"]["TopPlate"] == "1.000±0.000 ="
    assert table["Ah-Ch+BGN", "95 %, n"]["TopPlate"] == "0.998 to 1.000, 2"
    assert table["Ah-Ch", "in MuJoCo"]["TopPlate"] == "0.150±0.000"
    assert table["Random", ""]["TopPlate"] == "0.040"
    assert table["Perfect", ""]["TopPlate"] == "1.000"


def test_reference_table_shows_both_conventions() -> None:
    table = rows(tables.reference_policies(EVIDENCE))
    sarsop = table["RockSample[4,4]", "SARSOP"]
    assert sarsop["clean start"] == "18.000±0.196"
    assert sarsop["hidden first action"] == "14.000±0.196"
    assert sarsop["paper"] == "17.75±0.12"


def test_all_metrics_mark_the_judged_one() -> None:
    table = rows(tables.all_metrics(EVIDENCE))
    assert table["Hallway", "training"]["Ah-Ch+BGN"] == "0.45±0.05"
    assert table["Hallway", "greedy *"]["Ah-Ch+BGN"] == "0.54±0.02"
    assert table["TopPlate", "KL, nats"]["Ah-Ch+BGN"] == "0.500±0.000"
    assert table["TopPlate", "KL, nats"]["Ah-Ch"] == "–"
    assert ("Hallway", "KL, nats") not in table


def test_tables_without_any_reference_rows() -> None:
    bare = evidence(RUNS)
    assert ("SARSOP", "ours") not in rows(tables.raw_returns(bare))
    assert ("Random", "") not in rows(tables.success_rates(bare))


def test_a_line_per_claim_then_the_tables_fit_a_hundred_columns() -> None:
    claims = judge_claims(Scores(EVIDENCE.runs, pd.DataFrame(), EVIDENCE.references, DOMAINS))
    lines = tables.claim_lines(claims)
    assert len(lines.rows) == len(claims)
    for table in (
        lines,
        tables.raw_returns(EVIDENCE),
        tables.success_rates(EVIDENCE),
        tables.all_metrics(EVIDENCE),
    ):
        widths = [max(len(row[i]) for row in (table.columns, *table.rows)) for i in range(len(table.columns))]
        assert sum(widths) + 2 * len(widths) <= 100, table.title


def test_forms_for_other_programs() -> None:
    table = TextTable("A & B", ["a", "b", "c"], [["x|y", "1±2", "<"], ["", "50%", "3"]], ["note"])
    assert table.markdown() == (
        "## A & B\n\n| a | b | c |\n| --- | --- | --- |\n| x\\|y | 1±2 | < |\n|  | 50% | 3 |\n\n- note\n"
    )
    assert list(csv.reader(io.StringIO(table.csv()))) == [
        ["a", "b", "c"],
        ["x|y", "1±2", "<"],
        ["x|y", "50%", "3"],
    ]
    page = table.html()
    assert "<h2>A &amp; B</h2>" in page
    assert '<tr class="start"><th>x|y</th><th>1±2</th><td>&lt;</td></tr>' in page
    latex = table.latex()
    assert r"x|y & 1$\pm$2 & < \\" in latex
    assert r" & 50\% & 3 \\" in latex
    assert r"\begin{tabular}{llr}" in latex


def test_plus_minus() -> None:
    assert plus_minus(1.0, 0.25) == "1.00±0.25"
    assert plus_minus(1.0, None) == "1.00"
    assert plus_minus(None, 0.1) == plus_minus(float("nan"), 0.1) == "–"


def test_collapses_by_hand() -> None:
    lost = {"episodes": [1000, 2000, 3000, 4000], "entropy": [0.1, 0.2, 0.7, 0.8]}
    steps = [100_000, 200_000, 300_000, 400_000]
    curves = [
        curve("top-plate", "ah-ch", 0, steps, [0.0, 0.5, 0.0, 0.01], **lost),
        curve("top-plate", "ah-ch", 1, steps, [0.0, 0.5, 0.0, 0.4], **lost),
        curve("top-plate", "ah-ch+bgn", 0, steps, [0.0, 0.5, 0.9, 1.0], **lost),
    ]
    table = rows(tables.success_collapses(EVIDENCE, scores(RUNS, curves)))
    assert table["TopPlate", "collapses"] == {
        "Domain": "TopPlate",
        "": "collapses",
        "Ah-Ch": "2 (1)",
        "Ah-Ch+BGN": "0 (0)",
    }
    assert table["TopPlate", "end lost"]["Ah-Ch"] == "1 of 2"
    # Seed 0 is lost at .7 and .8 nats, seed 1 at .7; a thousand episodes to a hundred thousand steps.
    assert table["TopPlate", "nats, lost"]["Ah-Ch"] == f"{(0.75 + 0.7) / 2:.2f}"
    assert table["TopPlate", "steps, lost"]["Ah-Ch"] == "100"
    assert table["TopPlate", "nats, lost"]["Ah-Ch+BGN"] == "–"
    assert table["TopPlate", "last fifth"]["Ah-Ch+BGN"] == "1.00±0.00"


def test_a_table_loses_no_number_and_breaks_no_word_at_its_least_width() -> None:
    row = ["TwoBumps-1D", "sampled success", "0.99±0.01 (5)"]
    table = TextTable("T", ["Domain", "", "Ah-Ch"], [row])
    assert table.narrowest == len("TwoBumps-1D") + len("sampled") + len("0.99±0.01 (5)") + 2 * 3 + 2
    printed = io.StringIO()
    Console(width=table.narrowest, file=printed).print(table.rich())
    assert "…" not in printed.getvalue()
    assert all(word in printed.getvalue() for word in ("TwoBumps-1D", "sampled", "success", "0.99±0.01 (5)"))
    too_narrow = io.StringIO()
    Console(width=table.narrowest - 1, file=too_narrow).print(table.rich())
    assert "…" in too_narrow.getvalue()
