"""The batch-system path on real Slurm daemons; ``nox -s slurm`` runs it."""

from __future__ import annotations

import os
import pathlib
import shutil
from collections.abc import Iterator

import pandas as pd
import pytest

pytest.importorskip("dask_jobqueue", reason="batch systems need dask-jobqueue: the extra `cluster`")

from benchmarks import registry
from benchmarks.__main__ import main
from benchmarks.plan import Selection
from benchmarks.tasks import CellTask
from bgn.results.store import Store
from bgn.training.trainer import train_cell
from tests.benchmarks import fakes
from tests.benchmarks.dask_processes import acting, checkpointed
from tests.benchmarks.slurm_daemons import Slurm, SlurmError, missing
from tests.waiting import await_

ASKED_FOR = "BGN_TEST_SLURM"

pytestmark = pytest.mark.skipif(ASKED_FOR not in os.environ, reason="starts daemons: nox -s slurm")


@pytest.fixture(scope="module")
def daemons(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    if programs := missing():
        pytest.skip(f"not installed: {', '.join(programs)} (Debian: apt-get install slurm-wlm munge)")
    slurm = Slurm(tmp_path_factory.mktemp("slurm"), cores=2)
    try:
        slurm.start()
    except SlurmError as error:
        slurm.stop()
        pytest.skip(f"Slurm cannot run here: {error}")
    yield slurm
    slurm.stop()


@pytest.fixture
def slurm(daemons: Slurm, monkeypatch: pytest.MonkeyPatch) -> Slurm:
    for name, value in daemons.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(pathlib.Path(__file__).parents[2])]))
    return daemons


def command(folder: pathlib.Path, *chosen: str, jobs: int, directives: str = "[]") -> list[str]:
    settings = folder / "cluster.toml"
    settings.write_text(
        f'jobs = {jobs}\ncells_per_job = 1\nmemory = "2 GB"\nwalltime = "00:10:00"\n'
        f'queue = "main"\ninterface = "lo"\ndirectives = {directives}\n'
        f'logs = "{folder}"\nscratch = "{folder}"\n'
    )
    where = ["--results", str(folder / "results"), "--executor", "slurm", "--cluster", str(settings)]
    return ["run", "--budget", "smoke", "--domain", "top-plate", "--agent", *chosen, *where]


def stored(folder: pathlib.Path) -> Store:
    return Store(folder / "results" / "smoke" / registry.load().defaults.preset)


def test_jobs_train_what_this_process_would(tmp_path: pathlib.Path, slurm: Slurm) -> None:
    assert main(command(tmp_path, "ah-ch+bgn", jobs=2)) == 0
    await_(lambda: not slurm.command("squeue", "-h"), "an end of the jobs")
    preset = registry.load().defaults.preset
    selection = Selection(registry.load(), "smoke", preset, ("top-plate",), ("ah-ch+bgn",), (), (0, 1))
    (cell,) = selection.tasks(selection.requests(), stored(tmp_path), "cpu")
    assert isinstance(cell, CellTask)
    runs, curves = stored(tmp_path).read("runs"), stored(tmp_path).read("curves")
    assert [list(stack) for stack in runs["stack_seeds"]] == [[0], [1]], "two jobs share the cell"
    for alone, run in zip(train_cell(cell.spec, cell.seeds), cell.runs, strict=True):
        ours = curves[curves["run"] == run].sort_values("env_steps").reset_index(drop=True)
        columns = [name for name in alone.curve if name != "seconds"]
        pd.testing.assert_frame_equal(
            ours[columns], alone.curve[columns], check_dtype=False, check_exact=True
        )


def test_a_cancelled_job_is_replaced(
    tmp_path: pathlib.Path, slurm: Slurm, capsys: pytest.CaptureFixture[str]
) -> None:
    lost: list[str] = []

    def cancel() -> None:
        lost.extend(slurm.jobs())
        slurm.command("scancel", "--signal=KILL", "--full", *lost)

    with acting(cancel, when=lambda: checkpointed(tmp_path)):
        assert main([*command(tmp_path, "ah-ch", jobs=1), "--seeds", "0"], work=fakes.HANGING) == 0
    assert "again  top-plate/ah-ch: its worker was lost" in capsys.readouterr().out
    assert len(lost) == 1
    assert set(stored(tmp_path).read("runs")["status"]) == {"ok"}


def test_jobs_that_cannot_be_submitted_are_said_before_anything_runs(
    tmp_path: pathlib.Path, slurm: Slurm, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = command(tmp_path, "ah-ch", jobs=1, directives='["--partition=nowhere"]')
    assert main(asked, work=fakes.BREAKING) == 2
    error = capsys.readouterr().err
    assert "cannot submit jobs to the batch system" in error
    assert "invalid partition" in error
    assert stored(tmp_path).read("runs").empty


def test_without_slurm_it_is_said(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", os.path.dirname(shutil.which("true") or ""))
    if shutil.which("sbatch"):
        monkeypatch.setenv("PATH", str(tmp_path))
    assert main(command(tmp_path, "ah-ch", jobs=1), work=fakes.BREAKING) == 2
    assert "cannot submit jobs to the batch system" in capsys.readouterr().err
