from __future__ import annotations

import pathlib

import pandas as pd
import pyarrow as pa
import pytest

from bgn.results import store as store_module
from bgn.results.atomic import write_atomically, write_bytes
from bgn.results.store import Store, StoreError

RUN = "hallway/ah-ch+bgn/seed-3"


def table(**columns: object) -> pa.Table:
    return pa.Table.from_pylist([columns])


def test_what_is_written_is_read(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    store.write("runs", RUN, table(run=RUN, train_return=0.5))
    store.write("runs", "top-plate/ah-ch/seed-0", table(run="top-plate/ah-ch/seed-0", physics_success=1.0))
    frame = store.read("runs").set_index("run")
    assert frame.loc[RUN, "train_return"] == 0.5
    assert pd.isna(frame.loc[RUN, "physics_success"])
    assert store.read("curves").empty


def test_texts_of_two_versions_of_pandas_are_read_together(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    for seed, kind in enumerate((pa.string(), pa.large_string())):
        run = f"hallway/ah-ch/seed-{seed}"
        store.write("curves", run, pa.table({"run": pa.array([run], kind), "env_steps": [80]}))
    assert store.read("curves")["run"].tolist() == ["hallway/ah-ch/seed-0", "hallway/ah-ch/seed-1"]


def test_failure_stands_beside_an_older_result_until_success(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    store.write("runs", RUN, table(run=RUN, status="ok", key="old"))
    store.write_failure("runs", RUN, table(run=RUN, status="failed", key="new"))
    assert sorted(store.read("runs")["status"]) == ["failed", "ok"]
    store.write("runs", RUN, table(run=RUN, status="ok", key="new"))
    assert store.read("runs")["key"].tolist() == ["new"]


def test_interrupted_write_leaves_the_old_file(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "file"
    write_bytes(path, b"old")

    def torn(partial: pathlib.Path) -> None:
        partial.write_text("ne")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, torn)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_torn_writes_are_not_read_and_swept_up(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    store.write("runs", RUN, table(run=RUN))
    torn = store.shard("runs", RUN).with_name(".seed-4.parquet.123.partial")
    torn.write_bytes(b"PAR1")
    assert len(store.read("runs")) == 1
    with store.lock():
        assert not torn.exists()


def test_unreadable_shard_is_named(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    path = store.shard("runs", RUN)
    path.parent.mkdir(parents=True)
    path.write_bytes(b"not parquet")
    with pytest.raises(StoreError, match=r"seed-3\.parquet.*run` sets aside what is damaged"):
        store.read("runs")


def test_only_one_process_may_write(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    with store.lock(), pytest.raises(StoreError, match="another process"), store.lock():
        pass
    with store.lock():
        pass


def test_checkpoints_are_discarded_by_seed(tmp_path: pathlib.Path) -> None:
    store = Store(tmp_path)
    discarded = [
        store.checkpoint("hallway/ah-ch", "key", (0, 1)),
        store.checkpoint("hallway/ah-ch", "older", (1, 5)),
    ]
    kept = [
        store.checkpoint("hallway/ah-ch", "key", (2, 10)),
        store.checkpoint("hallway/ah-cs", "key", (0, 1)),
    ]
    for path in (*discarded, *kept):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert store.unfinished("hallway/ah-ch", "key") == [(0, 1), (2, 10)]
    store.discard_checkpoints("hallway/ah-ch", (0, 1))
    assert sorted(tmp_path.rglob("*.checkpoint")) == sorted(kept)
    assert store.unfinished("hallway/ah-ch", "key") == [(2, 10)]


def test_what_another_store_holds_is_adopted(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    theirs, ours = Store(tmp_path / "theirs"), Store(tmp_path / "ours")
    theirs.write("runs", RUN, table(run=RUN, status="ok"))
    theirs.write("curves", RUN, table(run=RUN, return_100=0.5))
    write_bytes(theirs.policy(RUN), b"weights")
    files = {
        str(path.relative_to(theirs.root)): path.read_bytes()
        for path in sorted(theirs.root.rglob("*.*"), reverse=True)
    }
    ours.write_failure("runs", RUN, table(run=RUN, status="failed"))
    written: list[pathlib.Path] = []
    write = store_module.write_bytes  # type: ignore[attr-defined]
    monkeypatch.setattr(
        store_module,
        "write_bytes",
        lambda path, content: (written.append(path), write(path, content)),  # type: ignore[func-returns-value]
    )
    ours.adopt("runs", [RUN], files)
    assert len(written) == 3
    assert written[-1] == ours.shard("runs", RUN)
    assert ours.read("runs")["status"].tolist() == ["ok"]
    assert ours.read("curves")["return_100"].tolist() == [0.5]
    assert ours.policy(RUN).read_bytes() == b"weights"
