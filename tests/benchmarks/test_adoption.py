"""What another budget or preset has computed with the same settings is taken from there."""

from __future__ import annotations

import pathlib

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.__main__ import main
from bgn.results.store import Store
from tests.benchmarks import fakes


def command(results: pathlib.Path, preset: str, *domains: str) -> list[str]:
    options = [
        "--budget",
        "smoke",
        "--preset",
        preset,
        "--domain",
        *domains,
        "--agent",
        "ah-ch",
        "--jobs",
        "1",
    ]
    return ["run", "--results", str(results), *options]


def test_equal_settings_are_not_computed_twice(tmp_path: pathlib.Path) -> None:
    theirs, ours = (Store(tmp_path / "smoke" / preset) for preset in ("authors-code", "calibrated"))
    assert main(command(tmp_path, "authors-code", "hallway"), work=fakes.WORKING) == 0
    assert main(command(tmp_path, "calibrated", "hallway"), work=fakes.BREAKING) == 0
    computed, taken = theirs.read("runs"), ours.read("runs")
    assert set(taken["taken_from"]) == {"smoke/authors-code"}
    assert set(taken["preset"]) == {"calibrated"}
    told = ["preset", "taken_from"]
    assert taken.drop(columns=told).equals(computed.drop(columns="preset"))
    for run in taken["run"]:
        assert ours.policy(run).read_bytes() == theirs.policy(run).read_bytes()
        assert pq.read_table(ours.shard("curves", run)).equals(pq.read_table(theirs.shard("curves", run)))


def test_what_was_measured_of_a_policy_comes_along(tmp_path: pathlib.Path) -> None:
    assert main(command(tmp_path, "authors-code", "hallway"), work=fakes.WORKING) == 0
    theirs = Store(tmp_path / "smoke" / "authors-code")
    run, key = theirs.read("runs").loc[0, ["run", "key"]]
    theirs.write("measures", run, pa.table({"run": [run], "key": [key], "first_100_return": [0.5]}))
    assert main(command(tmp_path, "calibrated", "hallway"), work=fakes.BREAKING) == 0
    taken = Store(tmp_path / "smoke" / "calibrated").read("measures")
    assert taken.to_dict("list") == {"run": [run], "key": [key], "first_100_return": [0.5]}


def test_a_checkpoint_of_what_is_taken_is_of_no_more_use(tmp_path: pathlib.Path) -> None:
    theirs, ours = (Store(tmp_path / "smoke" / preset) for preset in ("authors-code", "calibrated"))
    assert main(command(tmp_path, "authors-code", "hallway"), work=fakes.WORKING) == 0
    checkpoint = ours.checkpoint("hallway/ah-ch", theirs.read("runs")["key"][0], (0, 1))
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    assert main(command(tmp_path, "calibrated", "hallway"), work=fakes.BREAKING) == 0
    assert not checkpoint.exists()


def test_where_it_was_computed_is_kept_when_taken_again(tmp_path: pathlib.Path) -> None:
    for preset in ("calibrated", "authors-code", "orthogonal-start"):  # all the authors' code in this domain
        work = fakes.WORKING if preset == "calibrated" else fakes.BREAKING
        assert main(command(tmp_path, preset, "hallway"), work=work) == 0
    (tmp_path / "smoke" / "calibrated" / "runs" / "hallway" / "ah-ch" / "seed-0.parquet").unlink()
    last = Store(tmp_path / "smoke" / "orthogonal-start").read("runs")
    assert set(last["taken_from"]) == {"smoke/calibrated"}


def test_other_settings_are_computed(tmp_path: pathlib.Path) -> None:
    assert main(command(tmp_path, "authors-code", "top-plate"), work=fakes.WORKING) == 0
    assert main(command(tmp_path, "calibrated", "top-plate"), work=fakes.WORKING) == 0
    assert "taken_from" not in Store(tmp_path / "smoke" / "calibrated").read("runs")


def test_failures_are_not_taken(tmp_path: pathlib.Path) -> None:
    failing = [*command(tmp_path, "authors-code", "hallway")[:-4], "--agent", fakes.FAILING_AGENT]
    assert main(failing, work=fakes.BREAKING) == 1
    ours = [*command(tmp_path, "calibrated", "hallway")[:-4], "--agent", fakes.FAILING_AGENT]
    assert main(ours, work=fakes.WORKING) == 0
    assert "taken_from" not in Store(tmp_path / "smoke" / "calibrated").read("runs")
