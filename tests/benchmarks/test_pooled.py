from __future__ import annotations

import pathlib
import shutil

import pytest

from benchmarks import evidence, pooled, registry
from benchmarks.__main__ import main
from benchmarks.evidence import EvidenceError
from tests.benchmarks import fakes

PRESET = registry.load().defaults.preset
OPENINGS = ("clean", "hidden-first-action")


def command(folder: pathlib.Path, *more: str, preset: str = PRESET) -> list[str]:
    return ["run", "--results", str(folder), "--jobs", "1", "--preset", preset, *more]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Hallway at two budgets, Hallway-2 at the shorter one."""
    folder = tmp_path_factory.mktemp("results")
    common = command(folder, "--seeds", "0-1", "--agent", "ah-ch")
    short = ["--budget", "smoke", "--domain", "hallway", "hallway-2", "--reference", "random"]
    assert main([*common, *short], work=fakes.WORKING) == 0
    assert main([*common, "--budget", "laptop", "--domain", "hallway"], work=fakes.WORKING) == 0
    return folder


def test_each_domain_comes_from_its_longest_budget(results: pathlib.Path) -> None:
    found = pooled.load(results)
    assert dict(found.budgets) == {"hallway": "laptop", "hallway-2": "smoke"}
    steps = found.cells.set_index("domain")["env_steps"]
    assert steps.to_dict() == {"hallway": 110_000, "hallway-2": 3200}
    assert set(zip(found.runs["domain"], found.runs["budget"], strict=True)) == set(found.budgets.items())
    # Reference rows are not trained: Hallway's longer budget has none, so those of the other one are shown.
    assert set(zip(found.references["domain"], found.references["budget"], strict=True)) == {
        ("hallway", "smoke"),
        ("hallway-2", "smoke"),
    }
    assert len(found.curves) == 4 * 3
    assert set(found.policies()) == {f"{d}/ah-ch/seed-{s}" for d in ("hallway", "hallway-2") for s in (0, 1)}


def test_reference_rows_belong_to_no_preset(results: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """What a domain's own budget lacks is taken from wherever the present code evaluated most episodes."""
    folder = pathlib.Path(shutil.copytree(results, tmp_path / "results"))
    elsewhere = command(folder, "--budget", "laptop", "--domain", "hallway", preset="paper-text")
    assert main([*elsewhere, "--reference", "random", "qmdp"], work=fakes.WORKING) == 0
    rows = pooled.load(folder, preset=PRESET).references.set_index("run")
    assert rows["budget"].to_dict() == {
        **{f"hallway/{name}/{opening}": "laptop" for name in ("random", "qmdp") for opening in OPENINGS},
        **{f"hallway-2/random/{opening}": "smoke" for opening in OPENINGS},
    }


def test_longer_runs_of_fewer_agents_are_named_but_not_shown(
    results: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    folder = pathlib.Path(shutil.copytree(results, tmp_path / "results"))
    more = command(folder, "--seeds", "0-1", "--agent", "ab-cb", "--budget", "smoke", "--domain", "hallway")
    assert main(more, work=fakes.WORKING) == 0
    found = pooled.load(folder)
    assert found.budgets["hallway"] == "smoke"
    assert "Not shown: 2 longer runs of 1 agent in hallway, 0.11 M steps: `--budget laptop`." in found.remarks


def test_of_equally_long_budgets_the_one_with_more_runs_is_shown(tmp_path: pathlib.Path) -> None:
    common = command(tmp_path, "--agent", "ah-ch")
    for budget, seeds in (("overnight", "0-2"), ("paper", "0-1")):
        selected = ["--budget", budget, "--seeds", seeds, "--domain", "top-plate"]
        assert main([*common, *selected], work=fakes.WORKING) == 0
    overview = pooled.folder(tmp_path).overview
    assert overview["env_steps"].nunique() == 1
    assert dict(pooled.load(tmp_path).budgets) == {"top-plate": "overnight"}


def test_one_budget_can_be_asked_for(results: pathlib.Path) -> None:
    found = pooled.load(results, budget="smoke")
    assert set(found.budgets.values()) == {"smoke"}
    alone = evidence.load(results, budget="smoke")
    assert found.cells["mean"].tolist() == alone.cells["mean"].tolist()
    with pytest.raises(EvidenceError, match=r"no runs of paper/.*; stored: laptop/.*, smoke/"):
        pooled.load(results, budget="paper")
    with pytest.raises(EvidenceError, match="stored: nothing"):
        pooled.load(results / "nowhere")


def test_overview_lists_what_is_stored(results: pathlib.Path) -> None:
    overview = pooled.folder(results).overview
    rows = overview[["budget", "domain", "agents", "runs", "env_steps"]].to_numpy().tolist()
    assert rows == [
        ["laptop", "hallway", 1, 2, 110_000],
        ["smoke", "hallway", 1, 2, 3200],
        ["smoke", "hallway-2", 1, 2, 3200],
    ]
