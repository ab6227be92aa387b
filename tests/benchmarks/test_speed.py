"""The speed tools: arithmetic by hand, comparisons with a clock of one's own, files and their errors."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from benchmarks import revisions
from benchmarks.revisions import RevisionError
from benchmarks.speed import compare, machine, profiles, report, suite
from benchmarks.speed.__main__ import main
from benchmarks.speed.arithmetic import multiply_adds
from benchmarks.speed.compare import CompareError, Comparison
from benchmarks.speed.suite import SuiteError, TrainingSpeed
from benchmarks.speed.workloads import Training, settings_of
from bgn import domains
from bgn.agents.specs import AGENTS


def test_multiply_adds_of_hallway_bgn_by_hand() -> None:
    """80 samples, 96 slots with the bootstrap; 22 observations, 6 actions, 60 states."""
    gru = 256 * 768 * (96 + 80 + 64) + 3 * 128 * 768 * (22 + 6)
    actor = 256 * 256 * 2 * 3 * 80 + 256 * 5 * 3 * 80 + 256 * 60 * 3 * 80
    critic = 256 * 256 * 2 * (96 + 160) + 256 * 1 * (96 + 160) + 256 * 60 * 3 * 80
    needed = multiply_adds(AGENTS["ah-ch+bgn"], domains.get("hallway"), settings_of("hallway"))
    assert needed == (gru + actor + critic) / 80


def test_multiply_adds_of_the_other_inputs_by_hand() -> None:
    needed = multiply_adds(AGENTS["ab-cb"], domains.get("hallway"), settings_of("hallway"))
    actor = 60 * 256 * 2 * 80 + 256 * 256 * 3 * 80 + 256 * 5 * 3 * 80
    critic = 60 * 256 * (96 + 80) + 256 * 256 * (96 + 160) + 256 * (96 + 160)
    assert needed == (actor + critic) / 80
    embedded = multiply_adds(AGENTS["ah-cs"], domains.get("hallway"), settings_of("hallway", "paper-text"))
    gru = 256 * 768 * (80 + 80 + 64) + 3 * 128 * 768 * (22 + 6)
    actor = 256 * 256 * 3 * 80 + 256 * 5 * 3 * 80
    critic = (128 * 256 + 256 * 256 + 256) * (96 + 160)
    assert embedded == (gru + actor + critic) / 80


@pytest.mark.parametrize("cell", [("hallway", "ab-cb"), ("two-bumps-1d", "ah-ch+bgn")])
def test_what_is_executed_is_hardly_more_than_what_is_needed(cell: tuple[str, str]) -> None:
    training = Training.of_cell(*cell)
    needed = multiply_adds(training.spec, training.domain, training.settings)
    asked = profiles.launches(training)
    single_column = 256 * (96 + 160) / 80  # the critic's head, which is not dispatched as products
    assert needed - single_column <= asked.multiply_adds / training.env_steps < 1.1 * needed
    assert 100 < asked.kernels < 2000


def test_shares_add_up() -> None:
    rows = profiles.shares(Training.of_cell("hallway", "ab-cb"), updates=2)
    assert sum(row.fraction for row in rows) == pytest.approx(1)
    assert {"products", "optimiser"} <= {row.what for row in rows}


def test_machine_is_measured() -> None:
    assert machine.peak_flops() > 1e8


def test_measure_takes_turns_and_reports_the_median_ratio() -> None:
    calls = []

    def now(name: str) -> float:
        calls.append("now")
        return 3.0

    def then(name: str) -> float:
        calls.append("then")
        return 2.0

    result = compare.measure("work", now, then, rounds=3)
    assert calls == ["now", "then", "then", "now", "now", "then"]
    assert result.ratio == 1.5
    assert result.slower
    assert result.seconds == 3.0


def test_a_loose_threshold_decides() -> None:
    assert not Comparison("work", (1.3, 1.1, 1.2)).slower
    assert Comparison("work", (1.3, 1.1, 1.4)).slower


def test_a_workload_that_one_side_lacks_is_named_not_compared() -> None:
    def lacking(name: str) -> float:
        raise CompareError("abc: no such thing")

    result = compare.measure("work", lambda name: 1.0, lacking, rounds=2)
    assert result.error == "abc: no such thing"
    assert not result.slower
    assert "no such thing" in result.summary()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    def git(*arguments: str) -> None:
        identity = ("-c", "user.name=t", "-c", "user.email=t@example.org")
        subprocess.run(["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True)

    git("init", "--initial-branch=main")
    for content in ("one", "two"):
        (tmp_path / "file").write_text(content, encoding="utf-8")
        git("add", "file")
        git("commit", "-m", content)
    return tmp_path


def test_a_revision_is_checked_out_and_removed(repository: Path) -> None:
    commit = revisions.resolve("HEAD~1", repository)
    with revisions.checked_out(commit, repository) as code:
        assert (code / "file").read_text(encoding="utf-8") == "one"
    assert not code.exists()


def test_default_revision_is_where_the_branch_left_main(repository: Path) -> None:
    assert compare.default_revision(repository) == "HEAD~1"
    first = revisions.resolve("HEAD~1", repository)
    subprocess.run(
        ["git", "-C", str(repository), "switch", "-c", "work", "HEAD"], check=True, capture_output=True
    )
    subprocess.run(
        ["git", "-C", str(repository), "branch", "-f", "main", first], check=True, capture_output=True
    )
    assert compare.default_revision(repository) == first


def test_unknown_revision_and_no_repository(
    repository: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    with pytest.raises(RevisionError, match="has no revision 'nosuch'"):
        revisions.resolve("nosuch", repository)
    with pytest.raises(RevisionError, match="has no revision '--help'"):
        revisions.resolve("--help", repository)
    with pytest.raises(RevisionError, match="is not a git repository"):
        revisions.resolve("HEAD", tmp_path_factory.mktemp("elsewhere"))


def test_suite_is_read_back(tmp_path: Path) -> None:
    speed = {
        "cell": "hallway/ah-ch+bgn",
        "env_steps_per_cpu_second": 10_000.0,
        "gflops": 30.0,
        "peak_gflops": 60.0,
    }
    entries = [
        {"group": "training", "extra_info": {"machine": {"cores": 2}, "speed": speed}},
        {"group": "plain", "extra_info": {"cell": "hallway/ah-ch+bgn", "ratio": 5.0}},
        {"group": None, "name": "test_load", "extra_info": {}, "stats": {"median": 0.5}},
    ]
    path = tmp_path / "speed.json"
    path.write_text(json.dumps({"benchmarks": entries}), encoding="utf-8")
    loaded = suite.load(path)
    (cell,) = loaded.training
    assert cell == TrainingSpeed(**speed)
    assert cell.roofline == 0.5
    assert loaded.others == {"test_load": 0.5}
    assert suite.training_rows(loaded) == [["hallway/ah-ch+bgn", "10,000", "30.0", "0.50", "5.0"]]
    assert main(["table", str(path)]) == 0


def test_suite_files_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SuiteError, match="`nox -s speed` writes it"):
        suite.load(tmp_path / "speed.json")
    broken = tmp_path / "broken.json"
    broken.write_text("{}", encoding="utf-8")
    with pytest.raises(SuiteError, match="not a result of the speed suite"):
        suite.load(broken)
    assert main(["report", "--suite", str(broken)]) == 2
    assert main(["compare", "--rounds", "0"]) == 2
    assert "must be at least 1" in capsys.readouterr().err


def test_fill_replaces_one_block() -> None:
    text = "a\n<!-- measured: x -->\nold\n<!-- end -->\nb\n<!-- measured: y -->\n<!-- end -->\n"
    filled = report.fill(text, "x", r"new \1")
    assert filled == text.replace("old", r"new \1")
    assert report.fill(text, "y", "z").endswith("<!-- measured: y -->\nz\n<!-- end -->\n")
    with pytest.raises(SuiteError, match="measured: q"):
        report.fill(text, "q", "")


def test_the_document_has_every_block() -> None:
    text = report.DOCUMENT.read_text(encoding="utf-8")
    for name in ("machine", "training", "profile", "floors", "cost", "gpu", "others"):
        report.fill(text, name, "")
    assert report.FIGURE in text
