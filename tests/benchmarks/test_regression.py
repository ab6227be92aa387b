"""The command from end to end, with a trainer that takes no time."""

from __future__ import annotations

import json
import pathlib
from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks import regression
from benchmarks.__main__ import main as run_benchmarks
from benchmarks.tasks import Work
from bgn.results import schema
from bgn.training.cell import CellSpec, RunResult
from tests.benchmarks import fakes

Capture = pytest.CaptureFixture[str]


def trained(spec: CellSpec, seeds: Sequence[int], drop: float) -> list[RunResult]:
    """Return results whose level is the same for every seed but for a little noise of its own."""
    results = []
    for seed in seeds:
        value = 0.5 - drop + 0.02 * float(np.random.default_rng(seed).normal())
        metrics = dict.fromkeys(schema.RUN_METRICS, value) | {
            "greedy_return_se": 0.001,
            "sampled_return_se": 0.001,
        }
        points = [dict.fromkeys(schema.CURVE_COLUMNS, share * value) for share in (0.0, 1.0)]
        results.append(RunResult(seed=seed, points=points, metrics=metrics, policy={}))
    return results


def same(spec: CellSpec, seeds: Sequence[int], **options: object) -> list[RunResult]:
    return trained(spec, seeds, 0.0)


def worse(spec: CellSpec, seeds: Sequence[int], **options: object) -> list[RunResult]:
    return trained(spec, seeds, 0.1 if spec.domain == "hallway" else 0.0)


def failing(spec: CellSpec, seeds: Sequence[int], **options: object) -> list[RunResult]:
    raise FloatingPointError("the loss is NaN")


def work(train: object) -> Work:
    return Work(train, fakes.save_policy, fakes.evaluate_reference, fakes.evaluate_in_physics)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("reference")
    command = [
        "run",
        "--results",
        str(folder),
        "--budget",
        "regress",
        "--preset",
        "calibrated",
        "--jobs",
        "1",
    ]
    assert run_benchmarks([*command, "--agent", "ah-ch+bgn"], work=work(same)) == 0
    return folder


def files(folder: pathlib.Path) -> dict[pathlib.Path, float]:
    return {path: path.stat().st_mtime for path in folder.rglob("*") if path.is_file()}


def compare(reference: pathlib.Path, train: object, *more: str) -> int:
    return regression.main(["--against", str(reference), "--jobs", "1", *more], work=work(train))


def test_fresh_seeds_of_the_same_code_are_fine(
    reference: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture
) -> None:
    before = files(reference)
    assert compare(reference, same, "--json", str(tmp_path / "found.json")) == 0
    assert files(reference) == before  # nothing is written to the results
    printed = capsys.readouterr().out
    assert "Verdict: fine." in printed
    assert max(map(len, printed.splitlines())) <= 100
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["verdict"] == "fine"
    assert {cell["cell"] for cell in found["cells"]} == {"hallway/ah-ch+bgn", "top-plate/ah-ch+bgn"}
    assert all(cell["reference_runs"] == 10 for cell in found["cells"])


def test_a_drop_is_confirmed_with_other_seeds(
    reference: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture
) -> None:
    assert compare(reference, worse, "--json", str(tmp_path / "found.json")) == 1
    assert "Verdict: regressed." in capsys.readouterr().out
    cells = {cell["cell"]: cell for cell in json.loads((tmp_path / "found.json").read_text())["cells"]}
    hallway = cells["hallway/ah-ch+bgn"]
    assert (hallway["outcome"], hallway["runs"]) == ("regressed", 10)
    assert hallway["p"] < 0.001
    assert hallway["difference"] == pytest.approx(-0.1, abs=0.03)
    assert cells["top-plate/ah-ch+bgn"]["outcome"] == "fine"


def test_what_cannot_be_told(reference: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture) -> None:
    assert compare(reference, failing) == 2
    assert "the loss is NaN" in capsys.readouterr().out
    few = [
        "run",
        "--results",
        str(tmp_path),
        "--budget",
        "regress",
        "--preset",
        "calibrated",
        "--seeds",
        "0-2",
    ]
    assert run_benchmarks([*few, "--agent", "ah-ch", "--domain", "hallway"], work=work(same)) == 0
    capsys.readouterr()
    assert compare(tmp_path, same) == 2
    assert "3 reference runs; 5 are needed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--domain", "hallway-3"], "unknown domain 'hallway-3'"),
        (
            ["--agent", "ab-cb"],
            "no stored cell is among those asked for; stored at regress: hallway/ah-ch+bgn",
        ),
        (["--budget", "paper"], "holds no results of paper/reproduction"),
    ],
)
def test_wrong_usage(reference: pathlib.Path, more: list[str], message: str, capsys: Capture) -> None:
    assert compare(reference, same, *more) == 2
    assert message in capsys.readouterr().err
