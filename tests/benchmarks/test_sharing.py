"""Results of several machines: merged, put into an archive, checked, and computed again."""

from __future__ import annotations

import io
import json
import pathlib
import shutil
import tarfile
from collections.abc import Callable

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.__main__ import main
from benchmarks.archive import ArchiveError, export, verify_archive
from bgn.results.store import read_shard
from tests.benchmarks import fakes
from tests.benchmarks.test_command import smoke, stored
from tests.effort import effort
from tests.hostile.mutation import mutate, refusal

Capture = pytest.CaptureFixture[str]
RUN = "hallway/ab-cb/seed-{}"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Return results of one cell with two seeds, and the random policy."""
    results = tmp_path_factory.mktemp("original")
    command = [*smoke(results, "hallway", agents=["ab-cb"]), "--reference", "random"]
    assert main(["run", *command, "--jobs", "1"], work=fakes.WORKING) == 0
    return results


@pytest.fixture
def results(original: pathlib.Path, tmp_path: pathlib.Path) -> pathlib.Path:
    """Return a copy that a test may change."""
    return pathlib.Path(shutil.copytree(original, tmp_path / "results"))


def drop(results: pathlib.Path, seed: int) -> None:
    stored(results).shard("runs", RUN.format(seed)).unlink()


def change(results: pathlib.Path, seed: int, column: str, value: object) -> None:
    """Give a stored run another value in a column."""
    store, run = stored(results), RUN.format(seed)
    table = read_shard(store.shard("runs", run))
    at = table.column_names.index(column)
    store.write("runs", run, table.set_column(at, column, pa.array([value], table.schema.field(at).type)))


def test_stores_of_two_machines_are_merged(
    results: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture
) -> None:
    other = pathlib.Path(shutil.copytree(results, tmp_path / "other"))
    drop(results, 1)
    drop(other, 0)
    change(other, 1, "machine", "another one")
    into = tmp_path / "both"
    assert main(["merge", str(results), str(other), "--into", str(into)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "4 taken, 2 there already, the same"
    runs = stored(into).read("runs").set_index("seed")
    assert list(runs.index) == [0, 1]
    assert runs.loc[1, "machine"] == "another one"
    for seed in (0, 1):
        run = RUN.format(seed)
        assert (
            stored(into).policy(run).read_bytes()
            == stored(original_of(seed, results, other)).policy(run).read_bytes()
        )
    assert len(stored(into).read("curves")) == 2 * 3
    assert main(["status", *smoke(into, "hallway", agents=["ab-cb"])]) == 0
    assert "2/2" in capsys.readouterr().out
    assert main(["merge", str(other), "--into", str(into)]) == 0
    assert capsys.readouterr().out == "3 there already, the same\n"


@pytest.mark.parametrize("same", [True, False])
def test_what_is_taken_takes_the_place_of_attempts_with_the_same_key(
    same: bool, results: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    into, run = tmp_path / "into", RUN.format(0)
    row = read_shard(stored(results).shard("runs", run))
    key = row["key"].to_pylist()[0] if same else "another"
    at = row.column_names.index("key")
    stored(into).write_failure("runs", run, row.set_column(at, "key", pa.array([key])))
    checkpoint = stored(into).checkpoint("hallway/ab-cb", key, (0, 1))
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    assert main(["merge", str(results), "--into", str(into)]) == 0
    failed = stored(into).shard("runs", f"{run}.failed")
    assert (checkpoint.exists(), failed.exists()) == (not same, not same)


def original_of(seed: int, results: pathlib.Path, other: pathlib.Path) -> pathlib.Path:
    return (results, other)[seed]


def test_what_lies_beside_a_run_is_merged_too(results: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """Also where the run itself is there already, as when policies come later or were measured elsewhere."""
    run, into = RUN.format(0), tmp_path / "both"
    policy = stored(results).policy(run).read_bytes()
    stored(results).policy(run).unlink()
    assert main(["merge", str(results), "--into", str(into)]) == 0
    assert not stored(into).policy(run).exists()
    stored(results).policy(run).write_bytes(policy)
    stored(results).write("measures", run, pa.table({"run": [run], "key": ["k"], "first_100_return": [0.5]}))
    assert main(["merge", str(results), "--into", str(into)]) == 0
    assert stored(into).policy(run).read_bytes() == policy
    assert stored(into).read("measures").equals(stored(results).read("measures"))


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [("key", "another", "other code, settings or tables"), ("sampled_return", 0.25, "other sampled_return")],
)
def test_conflicts_are_reported_and_the_first_stays(
    results: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture, column: str, value: object, said: str
) -> None:
    other = pathlib.Path(shutil.copytree(results, tmp_path / "other"))
    change(other, 0, column, value)
    change(other, 0, "machine", "another one")
    kept = stored(results).shard("runs", RUN.format(0)).read_bytes()
    assert main(["merge", str(other), "--into", str(results)]) == 1
    printed = capsys.readouterr().out
    assert (
        f"conflict: smoke/{stored(results).root.name} {RUN.format(0)} of {other}: {said}; kept: " in printed
    )
    assert "not taken: " in printed
    assert "another one" in printed
    assert (
        "3 there already, the same, 1 conflict" in printed
        or "2 there already, the same, 1 conflict" in printed
    )
    assert stored(results).shard("runs", RUN.format(0)).read_bytes() == kept


def test_timings_and_provenance_are_no_conflict(results: pathlib.Path, tmp_path: pathlib.Path) -> None:
    other = pathlib.Path(shutil.copytree(results, tmp_path / "other"))
    change(other, 0, "wall_seconds", 99.0)
    change(other, 0, "git_commit", "f" * 40)
    assert main(["merge", str(other), "--into", str(results)]) == 0


def test_damaged_and_failed_rows(results: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture) -> None:
    store = stored(results)
    failed = read_shard(store.shard("runs", RUN.format(0)))
    store.write_failure("runs", RUN.format(0), failed)
    store.write_failure("runs", RUN.format(5), failed.set_column(0, "run", pa.array([RUN.format(5)])))
    store.policy(RUN.format(1)).write_bytes(b"torn")
    into = tmp_path / "into"
    assert main(["merge", str(results), "--into", str(into)]) == 1
    printed = capsys.readouterr().out
    assert (
        f"damaged: smoke/{store.root.name} {RUN.format(1)} of {results}: {store.policy(RUN.format(1))}"
        in printed
    )
    assert stored(into).shard("runs", RUN.format(5) + ".failed").exists()
    assert not stored(into).shard("runs", RUN.format(0) + ".failed").exists()  # it has succeeded since
    assert not stored(into).shard("runs", RUN.format(1)).exists()


def test_what_holds_no_results(tmp_path: pathlib.Path, capsys: Capture) -> None:
    assert main(["merge", str(tmp_path), "--into", str(tmp_path / "into")]) == 2
    assert main(["export", str(tmp_path / "a.tar"), "--results", str(tmp_path)]) == 2
    assert main(["verify", str(tmp_path / "a.tar")]) == 2
    error = capsys.readouterr().err
    assert error.count("holds no results; expected a folder such as results/local") == 2
    assert "a.tar is not a whole archive of results" in error
    assert "Traceback" not in error


def test_an_archive_is_written_checked_and_read_back(
    results: pathlib.Path, tmp_path: pathlib.Path, capsys: Capture
) -> None:
    path = tmp_path / "results.tar"
    assert main(["export", str(path), "--results", str(results)]) == 0
    assert f"files in {path}" in capsys.readouterr().out
    assert main(["verify", str(path)]) == 0
    assert main(["verify", str(results)]) == 0
    with tarfile.open(path) as tar:
        manifest = json.load(tar.extractfile("manifest.json"))
        tar.extraction_filter = getattr(tarfile, "data_filter", None)
        tar.extractall(tmp_path / "read")
    assert manifest["format"] == "bgn-results-1"
    assert {len(entry["sha256"]) for entry in manifest["files"].values()} == {64}
    copy = tmp_path / "read"
    assert sorted(stored(copy).read("runs")["seed"]) == [0, 1]
    assert stored(copy).policy(RUN.format(0)).exists()
    assert not list(copy.rglob("lock"))
    export(results, tmp_path / "again.tar")
    assert (tmp_path / "again.tar").read_bytes() == path.read_bytes()
    assert main(["export", str(path), "--results", str(results), "--without-policies"]) == 0
    with tarfile.open(path) as tar:
        assert not [name for name in tar.getnames() if "policies" in name]


def rewritten(path: pathlib.Path, edit: Callable[[str, bytes], tuple[str, bytes] | None]) -> None:
    """Write an archive anew with its members edited, or left out."""
    with tarfile.open(path) as tar:
        members = [(member.name, tar.extractfile(member).read()) for member in tar]
    with tarfile.open(path, "w") as tar:
        for name, content in filter(None, (edit(*member) for member in members)):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))


def test_an_archive_that_cannot_be_written_says_so(results: pathlib.Path, capsys: Capture) -> None:
    assert main(["export", "/proc/results.tar", "--results", str(results)]) == 3
    assert "cannot write /proc/results.tar" in capsys.readouterr().err


def test_what_was_measured_is_archived_too(results: pathlib.Path, tmp_path: pathlib.Path) -> None:
    run = RUN.format(0)
    stored(results).write("measures", run, pa.table({"run": [run], "key": ["k"], "first_100_return": [0.5]}))
    manifest = export(results, tmp_path / "results.tar")
    assert any(f"/measures/{run}.parquet" in name for name in manifest["files"])
    assert main(["verify", str(tmp_path / "results.tar")]) == 0
    assert main(["verify", str(results)]) == 0


def test_a_changed_archive_is_found_out(results: pathlib.Path, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "results.tar"
    store = f"smoke/{stored(results).root.name}"
    row = f"{store}/runs/{RUN.format(0)}.parquet"
    edits: list[tuple[Callable[[str, bytes], tuple[str, bytes] | None], str]] = [
        (lambda name, content: None if name == row else (name, content), f"{row}: missing"),
        (
            lambda name, content: (name, content[::-1] if name == row else content),
            f"{row}: changed, its checksum",
        ),
        (
            lambda name, content: (name, content + b"x" if name == row else content),
            f"{row}: not as the manifest",
        ),
        (
            lambda name, content: (name + "x" if name == row else name, content),
            f"{row}x: not as the manifest",
        ),
    ]
    for edit, problem in edits:
        export(results, path)
        rewritten(path, edit)
        assert any(found.startswith(problem) for found in verify_archive(path))


def test_an_archive_cannot_write_outside(results: pathlib.Path, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "results.tar"
    for outside in ("../evil.parquet", "/tmp/evil.parquet"):
        export(results, path)
        rewritten(
            path,
            lambda name, content, outside=outside: (
                name,
                content.replace(b"smoke/", f"{outside}/".encode(), 1) if name == "manifest.json" else content,
            ),
        )
        with pytest.raises(ArchiveError, match="which lies outside the results"):
            verify_archive(path)


@settings(max_examples=effort(100, 5_000))
@given(seed=st.integers(0, 2**63))
def test_damaged_archives(
    original: pathlib.Path, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.tar"
    export(original, path)
    path.write_bytes(mutate(path.read_bytes(), seed, [b"ustar", b"\0" * 512, b'"bytes": -1', b"sha256"]))
    refusal(lambda: verify_archive(path), ArchiveError)


def test_a_run_is_computed_again(results: pathlib.Path, capsys: Capture) -> None:
    verify = ["verify", str(results), "--budget", "smoke", "--rerun"]
    for run in (RUN.format(1), "hallway/random/clean"):
        assert main([*verify, run], work=fakes.WORKING) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"{run} came out the same, bit for bit"
    change(results, 1, "greedy_length", 0.125)
    change(results, 1, "version_torch", "1.0.0")
    assert main([*verify, RUN.format(1)], work=fakes.WORKING) == 1
    printed = capsys.readouterr().out
    assert f"{RUN.format(1)} came out otherwise: metrics\n" in printed
    assert "version_torch: then 1.0.0, now " in printed  # what may explain it
    assert main([*verify, RUN.format(7)], work=fakes.WORKING) == 2
    assert "holds no finished 'hallway/ab-cb/seed-7'" in capsys.readouterr().err
    assert main([*verify, "hallway/ah-cs/seed-0"], work=fakes.WORKING) == 2


def test_a_rerun_in_earnest(tmp_path: pathlib.Path, capsys: Capture) -> None:
    """Of one seed alone, where it was trained in a stack of two."""
    assert main(["run", *smoke(tmp_path, "hallway", agents=["ab-cb"]), "--jobs", "1"]) == 0
    assert main(["verify", str(tmp_path), "--budget", "smoke", "--rerun", RUN.format(1)]) == 0
    assert f"{RUN.format(1)} came out the same, bit for bit" in capsys.readouterr().out
