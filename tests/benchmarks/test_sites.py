from __future__ import annotations

import pathlib
import sys

import pytest

from benchmarks.__main__ import main
from benchmarks.executors import sites
from benchmarks.executors.sites import ClusterError, Jobs
from tests.benchmarks import fakes

MINIMAL = 'jobs = 3\ncells_per_job = 4\nmemory = "8 GB"\nwalltime = "10:00"\n'
Capture = pytest.CaptureFixture[str]


def settings(folder: pathlib.Path, text: str) -> pathlib.Path:
    path = folder / "cluster.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_settings_are_read(tmp_path: pathlib.Path) -> None:
    jobs = sites.load(settings(tmp_path, MINIMAL + 'prologue = ["module load python"]\n'))
    assert (jobs.jobs, jobs.cells_per_job, jobs.memory, jobs.queue) == (3, 4, "8 GB", None)
    assert jobs.prologue == ["module load python"]
    assert jobs.python == sys.executable


def test_the_example_in_the_documentation_is_valid(tmp_path: pathlib.Path) -> None:
    page = pathlib.Path(__file__).parents[2] / "docs" / "cluster.md"
    example = page.read_text(encoding="utf-8").partition("```toml\n")[2].partition("```")[0]
    assert set(sites.load(settings(tmp_path, example)).model_dump()) == set(Jobs.model_fields)
    assert all(f"{name} =" in example for name in Jobs.model_fields)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("jobs = ", "not valid TOML"),
        (MINIMAL + "nodes = 2\n", "nodes: unknown key"),
        (MINIMAL.replace("jobs = 3", "jobs = 0"), "jobs: Input should be greater than or equal to 1"),
        (MINIMAL.replace('walltime = "10:00"', ""), "walltime: Field required"),
        (MINIMAL.replace('"8 GB"', "8"), "memory: Input should be a valid string"),
    ],
)
def test_wrong_settings_are_named(tmp_path: pathlib.Path, text: str, message: str) -> None:
    path = settings(tmp_path, text)
    with pytest.raises(ClusterError, match=message) as raised:
        sites.load(path)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--executor", "ssh"], "--executor ssh: not one of local, dask://HOST:PORT, slurm, pbs, lsf"),
        (["--executor", "dask://host"], "not one of local, dask://HOST:PORT"),
        (["--executor", "slurm", "--device", "cuda"], "--executor slurm trains on cores"),
        (
            ["--executor", "slurm", "--cluster", "nowhere.toml"],
            "nowhere.toml: cannot read the cluster's settings",
        ),
    ],
)
def test_wrong_options_are_said(
    tmp_path: pathlib.Path, capsys: Capture, options: list[str], message: str
) -> None:
    command = ["run", "--budget", "smoke", "--domain", "hallway", "--agent", "ah-ch"]
    assert main([*command, "--results", str(tmp_path), *options], work=fakes.WORKING) == 2
    assert message in capsys.readouterr().err


def test_a_scheduler_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="clusters need Dask: the extra `cluster`")
    monkeypatch.setattr(sites, "_SECONDS_TO_CONNECT", 0.3)
    nobody = "127.0.0.1:9"  # the discard port, where nobody has listened for decades
    with pytest.raises(ClusterError, match=f"no Dask scheduler answers at {nobody}"):
        sites.connect(f"dask://{nobody}", pathlib.Path("unused")).__enter__()


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"distributed is not installed; .* -e \.\[cluster\]"):
        sites.connect("dask://127.0.0.1:9", pathlib.Path("unused")).__enter__()


@pytest.mark.parametrize(
    ("system", "lines"),
    [
        (
            "slurm",
            ["#SBATCH -p long", "#SBATCH -A robots", "#SBATCH --cpus-per-task=4", "#SBATCH --exclusive"],
        ),
        ("pbs", ["#PBS -q long", "#PBS -A robots", "select=1:ncpus=4", "#PBS --exclusive"]),
        ("lsf", ["#BSUB -q long", '#BSUB -P "robots"', "#BSUB -n 4", "#BSUB --exclusive"]),
    ],
)
def test_job_scripts(tmp_path: pathlib.Path, system: str, lines: list[str]) -> None:
    pytest.importorskip("dask_jobqueue", reason="batch systems need dask-jobqueue: the extra `cluster`")
    jobs = Jobs(
        jobs=2,
        cells_per_job=4,
        memory="8 GB",
        walltime="10:00",
        queue="long",
        account="robots",
        interface="lo",
        prologue=["module load python"],
        directives=["--exclusive"],
    )
    with sites.start(system, jobs) as cluster:
        script = cluster.job_script()
    assert all(line in script for line in [*lines, "10:00", "\nmodule load python\n", "--nthreads 4"])
    assert f"{sys.executable} -m distributed.cli.dask_worker tcp://127.0.0.1:" in script
