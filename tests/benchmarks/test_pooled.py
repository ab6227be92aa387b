from __future__ import annotations

import pathlib

import pytest

from benchmarks import evidence, pooled
from benchmarks.__main__ import main
from benchmarks.evidence import EvidenceError
from tests.benchmarks import fakes


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Hallway at two budgets, Hallway-2 at the shorter one."""
    folder = tmp_path_factory.mktemp("results")
    common = ["run", "--results", str(folder), "--jobs", "1", "--seeds", "0-1", "--agent", "ah-ch"]
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
    overview = pooled.stored(results)
    rows = overview[["budget", "domain", "agents", "runs", "env_steps"]].to_numpy().tolist()
    assert rows == [
        ["laptop", "hallway", 1, 2, 110_000],
        ["smoke", "hallway", 1, 2, 3200],
        ["smoke", "hallway-2", 1, 2, 3200],
    ]
