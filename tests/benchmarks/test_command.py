"""The command line from end to end, with a trainer that takes no time."""

from __future__ import annotations

import argparse
import os
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Sequence

import pandas as pd
import pytest

from benchmarks import registry
from benchmarks.__main__ import main, parse_seeds
from bgn.results.store import Store
from tests.benchmarks import fakes

ROOT = pathlib.Path(__file__).parents[2]
REGISTRY = registry.load()
PRESET = REGISTRY.defaults.preset
Capture = pytest.CaptureFixture[str]


def smoke(results: pathlib.Path, *domains: str, agents: Sequence[str] = ()) -> list[str]:
    """Return the options that choose a store and some cells."""
    chosen = ["--results", str(results), "--budget", "smoke", "--domain", *domains]
    return [*chosen, *(["--agent", *agents] if agents else [])]


def stored(results: pathlib.Path) -> Store:
    return Store(results / "smoke" / PRESET)


def test_a_second_run_does_nothing_but_print(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "run",
        "--budget",
        "smoke",
        "--results",
        str(tmp_path),
        "--domain",
        "hallway",
        "rocksample-4-4",
    ]
    assert main([*command, "--jobs", "2"], work=fakes.WORKING) == 0
    first = capsys.readouterr().out
    runs = stored(tmp_path).read("runs")
    budget = REGISTRY.budgets["smoke"]
    n_runs = 2 * len(REGISTRY.agents) * budget.seeds
    assert len(runs) == n_runs
    assert set(runs["status"]) == {"ok"}
    assert len(stored(tmp_path).read("references")) == 4 * 2 + 5 * 2
    written = runs["finished_at"].max()

    assert main(command, work=fakes.BREAKING) == 0
    second = capsys.readouterr().out
    assert stored(tmp_path).read("runs")["finished_at"].max() == written
    n = n_runs + 4 * 2 + 5 * 2
    assert f"{n} of {n} runs and reference rows are done" in second
    tables = first[first.index("What the paper claims") :]
    assert second.endswith(tables)
    assert "Raw returns (paper, Table 6)" in tables
    assert "Normalised returns" not in tables
    written = (tmp_path / "smoke" / PRESET / "tables" / "tables.md").read_text()
    assert "Normalised returns (paper, Table 7)" in written

    show = ["tables", "--budget", "smoke", "--results", str(tmp_path)]
    assert main([*show, "--all"]) == 0
    everything = capsys.readouterr().out
    assert "Normalised returns (paper, Table 7)" in everything
    lines = [
        line for line in everything.splitlines() if str(tmp_path) not in line
    ]  # a path is as long as it is
    assert max(map(len, lines)) <= 110  # six agents with two numbers each need a little more than 100
    assert main([*show, "--format", "csv"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("Table,Budget,Preset,Agent,,Hallway") for line in lines)
    assert any(
        line.startswith(f'"Raw returns (paper, Table 6)",smoke,{PRESET},Ah-Ch,ours,') for line in lines
    )


def test_failures_are_rows_and_the_rest_goes_on(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agents = ["ah-ch", fakes.FAILING_AGENT, fakes.DYING_AGENT]
    command = ["run", *smoke(tmp_path, "hallway", agents=agents), "--jobs", "1"]
    assert main(command, work=fakes.BREAKING) == 1
    printed = capsys.readouterr().out
    runs = stored(tmp_path).read("runs").set_index("run")
    assert runs.loc["hallway/ah-ch/seed-0", "status"] == "ok"
    raised = runs.loc["hallway/ah-cs/seed-1"]
    assert (raised["status"], raised["error"]) == ("failed", "FloatingPointError: the loss is NaN")
    assert "train_or_fail" in raised["traceback"]
    assert "SIGKILL" in runs.loc["hallway/ab-cb/seed-0", "error"]
    missing = printed[printed.index("Missing runs") :]
    assert all(f"hallway/{agent}/seed-{seed}" in missing for agent in agents[1:] for seed in (0, 1))
    assert "hallway/ah-ch/seed-0" not in missing

    status = ["status", "--budget", "smoke", "--results", str(tmp_path)]
    assert main(status) == 0
    printed = capsys.readouterr().out
    assert "0/2 (2 failed)" in printed
    assert "the loss is NaN" in printed
    assert "Traceback" in printed

    assert main(command, work=fakes.WORKING) == 0
    runs = stored(tmp_path).read("runs")
    assert len(runs) == 6
    assert set(runs["status"]) == {"ok"}


def test_only_missing_seeds_are_run(tmp_path: pathlib.Path) -> None:
    command = [
        "run",
        "--results",
        str(tmp_path),
        "--budget",
        "smoke",
        "--domain",
        "hallway",
        "--agent",
        "ah-ch",
    ]
    assert main([*command, "--seeds", "1"], work=fakes.WORKING) == 0
    assert main([*command, "--seeds", "0-2"], work=fakes.WORKING) == 0
    stacks = stored(tmp_path).read("runs").set_index("seed")["stack_seeds"]
    assert {seed: list(stack) for seed, stack in stacks.items()} == {0: [0, 2], 1: [1], 2: [0, 2]}


def test_older_results_are_shown_as_such_and_computed_anew(
    tmp_path: pathlib.Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = smoke(tmp_path, "hallway", agents=["ah-ch"])
    assert main(["run", *command], work=fakes.WORKING) == 0
    old = stored(tmp_path).read("runs")
    with monkeypatch.context() as patch:
        patch.setattr("bgn.results.provenance.code_hash", lambda *_, **__: "edited")
        capsys.readouterr()
        assert main(["status", *command]) == 0
        printed = capsys.readouterr().out
        assert "0/2 (2 older)" in printed
        assert "2 stored results are older: older code" in printed
        assert main(["tables", "--results", str(tmp_path), "--budget", "smoke"]) == 0
        printed = capsys.readouterr().out
        assert "0.51±0.01‡" in printed or "0.50±0.01‡" in printed
        assert "2 of 2 runs are of other code" in printed
        assert main(["run", *command], work=fakes.WORKING) == 0
        new = stored(tmp_path).read("runs")
    assert set(new["code_hash"]) == {"edited"}
    assert len(new) == len(old)
    assert not set(new["key"]) & set(old["key"])


def test_killed_at_any_moment_it_goes_on(tmp_path: pathlib.Path) -> None:
    command = [
        "run",
        "--results",
        str(tmp_path),
        "--budget",
        "smoke",
        "--domain",
        "hallway",
        "--agent",
        "ah-ch",
    ]
    code = (
        "import sys; from benchmarks.__main__ import main; from tests.benchmarks import fakes;"
        "sys.exit(main(sys.argv[1:], work=fakes.HANGING))"
    )
    process = subprocess.Popen([sys.executable, "-c", code, *command], cwd=ROOT, stdout=subprocess.DEVNULL)
    worker = _await_checkpoint(tmp_path)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    _await_death(worker)
    assert stored(tmp_path).read("runs").empty
    assert main(command, work=fakes.HANGING) == 0  # the fake goes on where there is a checkpoint
    assert len(stored(tmp_path).read("runs")) == 2
    assert not list(tmp_path.rglob("*.checkpoint"))


def _await_checkpoint(results: pathlib.Path) -> int:
    """Return the process id of the worker, which the fake writes into its checkpoint."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        for path in results.rglob("*.checkpoint"):
            if text := path.read_text():
                return int(text)
        time.sleep(0.05)
    raise AssertionError("no worker started")


def _await_death(pid: int) -> None:
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        if pathlib.Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z":
            return
        time.sleep(0.05)
    raise AssertionError("the worker outlived its parent")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "--domain", "hallway-3"], "unknown domain 'hallway-3'; known: hallway, hallway-2"),
        (["run", "--agent", "ppo"], "unknown agent 'ppo'; known: ah-ch, ah-ch+bgn"),
        (["status", "--budget", "huge"], "unknown budget 'huge'; known: smoke, laptop, paper"),
        (["tables", "--preset", "mine"], "unknown preset 'mine'; known: authors-code"),
    ],
)
def test_unknown_names(arguments: list[str], message: str, capsys: Capture) -> None:
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def test_tables_of_nothing(tmp_path: pathlib.Path, capsys: Capture) -> None:
    assert main(["tables", "--results", str(tmp_path)]) == 0
    assert "Nothing is stored" in capsys.readouterr().out


def test_several_budgets_are_shown_in_the_order_asked_for(tmp_path: pathlib.Path, capsys: Capture) -> None:
    asked = ["--results", str(tmp_path), "--budget", "smoke", "laptop", "smoke"]
    assert main(["status", *asked]) == 0
    printed = capsys.readouterr().out
    assert printed.count("Runs done, budget") == 2
    assert printed.index("budget smoke") < printed.index("budget laptop")
    assert main(["tables", *asked]) == 0
    assert capsys.readouterr().out.count("Nothing is stored in") == 2


def test_a_folder_that_is_not_there_is_an_error(tmp_path: pathlib.Path, capsys: Capture) -> None:
    for command in ("tables", "status", "measure"):
        assert main([command, "--results", str(tmp_path / "nowhere")]) == 2
        assert "there is no such folder" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert main(["run", *smoke(tmp_path / "file", "hallway", agents=["ah-ch"])]) == 3
    assert "Not a directory; make room there, or choose another folder" in capsys.readouterr().err


def test_reading_a_store_changes_nothing_in_it(tmp_path: pathlib.Path) -> None:
    fakes.fill(tmp_path, fakes.WORKING, domain="hallway", agent="ah-ch", reference="random")
    before = sorted(tmp_path.rglob("*"))
    assert main(["tables", "--all", "--results", str(tmp_path), "--budget", "smoke"]) == 0
    assert sorted(tmp_path.rglob("*")) == before


def test_a_checkpoint_that_outlived_its_run_is_removed(tmp_path: pathlib.Path) -> None:
    """As after ``kill -9`` between a stack's last row and the end of its work."""
    command = ["run", *smoke(tmp_path, "hallway", agents=["ab-cb"]), "--jobs", "1"]
    assert main(command, work=fakes.WORKING) == 0
    store = stored(tmp_path)
    checkpoint = store.checkpoint("hallway/ab-cb", store.read("runs")["key"][0], (0, 1))
    checkpoint.touch()
    assert main(command, work=fakes.BREAKING) == 0
    assert not checkpoint.exists()


def test_tables_are_not_written_into_a_store_that_another_process_writes(
    tmp_path: pathlib.Path, capsys: Capture
) -> None:
    selection = smoke(tmp_path, "hallway", agents=["ab-cb"])
    assert main(["run", *selection, "--jobs", "1"], work=fakes.WORKING) == 0
    tables = ["tables", "--results", str(tmp_path), "--budget", "smoke"]
    capsys.readouterr()
    with stored(tmp_path).lock():
        assert main(tables) == 0
        assert main([*tables, "--write"]) == 2
    printed = capsys.readouterr()
    assert "is writing to" in printed.err
    assert printed.out.count("What the paper claims") == 2


def test_seeds() -> None:
    assert parse_seeds("0-3") == (0, 1, 2, 3)
    assert parse_seeds("7,0,2-3,2") == (0, 2, 3, 7)
    for bad in ("", "a", "3-1", "1-", "-1", "1,,2"):
        with pytest.raises(argparse.ArgumentTypeError, match="write 0-9"):
            parse_seeds(bad)
    with pytest.raises(argparse.ArgumentTypeError, match="seeds go up to 999999, not 99999999999"):
        parse_seeds("0-99999999999")  # refused before it is counted out


@pytest.mark.parametrize("bad", [["--jobs", "0"], ["--seeds", "x"], ["--device", "tpu"]])
def test_bad_options(bad: list[str], capsys: Capture) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["run", *bad])
    assert bad[0] in capsys.readouterr().err


def test_real_runs_are_stored_with_their_provenance(tmp_path: pathlib.Path) -> None:
    command = [
        "run",
        "--results",
        str(tmp_path),
        "--budget",
        "smoke",
        "--domain",
        "hallway",
        "--agent",
        "ah-ch+bgn",
    ]
    assert main([*command, "--jobs", "1"]) == 0
    store = stored(tmp_path)
    runs, curves = store.read("runs"), store.read("curves")
    assert list(runs["run"]) == ["hallway/ah-ch+bgn/seed-0", "hallway/ah-ch+bgn/seed-1"]
    # Outside a repository there is no commit, and before installation no version of bgn.
    optional = ["error", "traceback", "missing", "git_commit", "git_dirty", "version_bgn"]
    assert runs.drop(columns=optional).notna().all(axis=None)
    assert (runs["device"] == "cpu").all()
    assert runs["started_at"].max() < runs["finished_at"].min()
    assert set(curves["key"]) == set(runs["key"])
    assert curves.groupby("run")["env_steps"].max().eq(3200).all()
    assert pd.Series([store.policy(run).stat().st_size for run in runs["run"]]).gt(100_000).all()
