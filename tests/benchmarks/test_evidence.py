from __future__ import annotations

import pathlib
import re

import pytest

from benchmarks import evidence, registry
from benchmarks.__main__ import main
from benchmarks.evidence import EvidenceError, StoredEvidence
from benchmarks.registry import RegistryError
from bgn.analysis.verdicts import Verdict
from bgn.results.run_ids import RunId, RunIdError
from tests.benchmarks import fakes

PUBLISHED = pathlib.Path(__file__).parents[2] / "results" / "published"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("results")
    chosen = ["--domain", "hallway", "--agent", "ah-ch+bgn", "ah-ch", "--reference", "random"]
    command = ["run", "--results", str(folder), "--budget", "smoke", *chosen, "--jobs", "1"]
    assert main(command, work=fakes.WORKING) == 0
    return folder


@pytest.fixture
def stored(results: pathlib.Path) -> StoredEvidence:
    return evidence.load(results, budget="smoke")


def test_frames_hold_what_was_run(stored: StoredEvidence) -> None:
    assert (stored.budget, stored.preset) == ("smoke", registry.load().defaults.preset)
    assert list(stored.cells["agent"]) == ["ah-ch", "ah-ch+bgn"]  # the registry's order
    # The fakes report .50 and .51 for seeds 0 and 1; the paper prints .50 ± .02 and .54 ± .01.
    assert stored.cells["mean"].tolist() == pytest.approx([0.505, 0.505])
    assert set(stored.cells["verdict"]) <= {verdict.value for verdict in Verdict}
    assert len(stored.runs) == 4
    assert "4 runs of 2 cells, 2 reference rows, 4 policies" in repr(stored)
    assert not stored.runs["older"].any()
    assert set(stored.references["convention"]) == {"clean", "hidden-first-action"}
    curve = stored.curves[stored.curves["run"] == "hallway/ah-ch/seed-1"]
    assert list(curve["return_100"]) == pytest.approx([0, 0.255, 0.51])
    assert set(curve["agent"]) == {"ah-ch"}


def test_curves_are_read_once_and_only_when_asked_for(
    results: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    original = evidence.Store.read  # type: ignore[attr-defined]
    monkeypatch.setattr(evidence.Store, "read", lambda self, kind: read.append(kind) or original(self, kind))  # type: ignore[attr-defined, func-returns-value]
    found = evidence.load(results, budget="smoke")
    assert read == ["runs", "measures", "references"]
    assert found.curves is found.curves
    assert read == ["runs", "measures", "references", "curves"]


def test_what_is_not_stored_is_answered_with_what_is(
    results: pathlib.Path, stored: StoredEvidence, tmp_path: pathlib.Path
) -> None:
    with pytest.raises(EvidenceError, match="no results of laptop/paper-text; stored: smoke/"):
        evidence.load(results, budget="laptop", preset="paper-text")
    with pytest.raises(EvidenceError, match="nothing is stored there"):
        evidence.load(tmp_path)
    with pytest.raises(RegistryError, match="unknown budget 'huge'; known: smoke"):
        evidence.load(results, budget="huge")
    with pytest.raises(
        EvidenceError, match=re.escape("seed-7; stored: hallway/ah-ch/seed-0, hallway/ah-ch/seed-1")
    ):
        stored.policy("hallway/ah-ch/seed-7")
    with pytest.raises(RunIdError, match="is not a run id"):
        stored.policy("hallway/ah-ch")


def test_published_policies_act() -> None:
    """The README's loop, shortened."""
    stored = evidence.load(PUBLISHED, budget="paper")
    run = stored.policies()[0]
    policy = stored.policy(run)
    assert policy.domain.id == RunId.parse(run).cell.domain
    assert 0 <= policy.act(0, None) < policy.domain.model.joint.n_actions


def test_runs_of_cells_that_the_registry_does_not_name_are_counted(
    results: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    text = registry.DEFAULT_PATH.read_text(encoding="utf-8").replace("[agents.ah-ch]\ncost = 1.0\n", "")
    path = tmp_path / "registry.toml"
    path.write_text(text, encoding="utf-8")
    found = evidence.load(results, budget="smoke", registry=registry.load(path))
    assert set(found.cells["agent"]) == {"ah-ch+bgn"}
    assert "Not shown: 2 runs of cells that this registry does not name, hallway/ah-ch;" in found.remarks[-1]
