"""A damaged shard is named and set aside; what other versions wrote is read where it can be."""

from __future__ import annotations

import datetime
import pathlib
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.results import quarantine, schema
from bgn.results.atomic import write_bytes
from bgn.results.store import Store, StoreError, read_shard
from tests.effort import effort
from tests.hostile.mutation import mutate, refusal

RUN = "hallway/ah-ch/seed-0"
NOW = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
EMPTY: dict[pa.DataType, Any] = {pa.string(): "x", pa.int64(): 1, pa.bool_(): True, pa.list_(pa.int64()): [1]}


def row(**changes: object) -> pa.Table:
    columns = {**schema.RUN_IDENTITY, **schema.OUTCOME, **schema.PROVENANCE}
    values = {name: EMPTY.get(kind, NOW) for name, kind in columns.items()}
    values |= {"run": RUN, "domain": "hallway", "agent": "ah-ch", "seed": 0, "status": "ok", **changes}
    return schema.row(schema.RUN_IDENTITY, values, dict.fromkeys(schema.RUN_METRICS, 0.5))


def retyped(table: pa.Table, name: str, value: object) -> pa.Table:
    """Return the table with another value, of another type, in a column."""
    return table.set_column(table.column_names.index(name), name, pa.array([value]))


def curve() -> pa.Table:
    frame = pd.DataFrame({name: np.linspace(0.0, 1.0, 50) for name in schema.CURVE_COLUMNS})
    return schema.curve_table(RUN, "x", frame)


@pytest.fixture
def store(tmp_path: pathlib.Path) -> Store:
    """Return a store of one run."""
    store = Store(tmp_path)
    policy = safetensors.numpy.save({"actor": np.ones(300, dtype=np.float32)})
    write_bytes(store.policy(RUN), policy)
    store.write("curves", RUN, curve())
    store.write("runs", RUN, row())
    assert quarantine.sweep(store) == []
    return store


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store(tmp_path_factory.mktemp("store"))


@settings(max_examples=effort(500, 20_000))
@given(seed=st.integers(0, 2**63))
def test_damaged_shards(damaged: Store, seed: int) -> None:
    path = damaged.shard("curves", RUN)
    damaged.write("curves", RUN, curve())
    path.write_bytes(mutate(path.read_bytes(), seed, [b"PAR1", b"\x15\x02", b"env_steps"]))
    refused = refusal(lambda: read_shard(path), StoreError)
    assert refused is None or str(path) in refused
    assert isinstance(quarantine.damage_of_shard(damaged, "curves", path), str)


@settings(max_examples=effort(300, 20_000))
@given(seed=st.integers(0, 2**63))
def test_damaged_policies(damaged: Store, seed: int) -> None:
    path = damaged.policy(RUN)
    content = safetensors.numpy.save({"actor": np.ones(300, dtype=np.float32)})
    write_bytes(path, mutate(content, seed, [b"{", b'"', b"data_offsets"]))
    reason = quarantine.damage_of_policy(path)
    if path.stat().st_size != len(content):
        assert reason or path.stat().st_size > 8


def test_no_flipped_bit_changes_a_number_unnoticed(store: Store) -> None:
    path = store.shard("curves", RUN)
    content, whole = bytearray(path.read_bytes()), curve()
    found = 0
    for at in range(4, len(content) - 1000, 97):  # in the pages, before the footer
        content[at] ^= 4
        path.write_bytes(content)
        if quarantine.damage_of_shard(store, "curves", path):
            found += 1
        else:  # in what nobody reads
            assert read_shard(path).to_pylist() == whole.to_pylist()
        content[at] ^= 4
    assert found > 10


@pytest.mark.parametrize("kind", ["runs", "curves", "policies"])
def test_a_run_with_a_truncated_file_is_set_aside_as_a_whole(store: Store, kind: str) -> None:
    paths = {
        "runs": store.shard("runs", RUN),
        "curves": store.shard("curves", RUN),
        "policies": store.policy(RUN),
    }
    path = paths[kind]
    path.write_bytes(path.read_bytes()[:-100])
    found = quarantine.sweep(store)
    assert [damage.path for damage in found] == list(paths.values())
    assert all(damage.aside.exists() and not damage.path.exists() for damage in found)
    assert f"{path} is damaged (" in "\n".join(map(str, found))
    assert store.read("runs").empty
    assert quarantine.sweep(store) == []


def test_what_is_set_aside_twice_is_kept_twice(store: Store) -> None:
    for _ in range(2):
        store.shard("runs", RUN).write_bytes(b"PAR1")
        store.policy(RUN).unlink(missing_ok=True)
        quarantine.sweep(store)
    aside = store.root / "quarantine" / "runs" / "hallway" / "ah-ch"
    assert sorted(path.name for path in aside.iterdir()) == ["seed-0.parquet", "seed-0.parquet.1"]


def test_shards_of_a_newer_and_of_an_older_version_are_read(store: Store) -> None:
    newer = row().append_column("colour", pa.array(["green"])).append_column("speed", pa.array([1.0]))
    older = row(run="hallway/ah-ch/seed-1", seed=1).drop_columns(["version_numba", "machine"])
    store.write("runs", RUN, newer)
    store.write("runs", "hallway/ah-ch/seed-1", older)
    assert quarantine.sweep(store) == []
    frame = store.read("runs").set_index("seed")
    assert frame["speed"].to_dict() == {0: 1.0, 1: pytest.approx(float("nan"), nan_ok=True)}
    assert pd.isna(frame.loc[1, "machine"])
    store.shard("runs", RUN).unlink()
    assert store.read("runs")["version_numba"].isna().all()


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        (lambda: row().drop_columns(["key"]), "no column key: another version wrote it"),
        (lambda: retyped(row(), "seed", "0"), "column seed holds string, not int64"),
        (lambda: retyped(row(), "train_return", "high"), "column train_return holds string, not double"),
        (
            lambda: row(run="hallway/ah-ch/seed-7"),
            "does not hold hallway/ah-ch/seed-0, which its name promises",
        ),
        (lambda: row().slice(0, 0), "does not hold hallway/ah-ch/seed-0"),
    ],
)
def test_what_cannot_be_used_is_set_aside(store: Store, table: Any, reason: str) -> None:
    store.write("runs", RUN, table())
    found = quarantine.sweep(store)
    assert reason in str(found[0])
    assert store.read("runs").empty


def test_a_shard_that_asks_for_all_memory_is_refused(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"x": pa.array(np.zeros(2_000_000))}), path, compression="zstd")
    assert path.stat().st_size < 20_000
    with pytest.raises(StoreError, match=r"bomb\.parquet: it says it holds 2000000 rows"):
        read_shard(path)


def test_shards_that_do_not_fit_together_are_named(store: Store) -> None:
    other = row(run="hallway/ah-ch/seed-1", seed=1).append_column("train_hue", pa.array(["red"]))
    store.write("runs", RUN, row().append_column("train_hue", pa.array([1.0])))
    store.write("runs", "hallway/ah-ch/seed-1", other)
    with pytest.raises(StoreError, match=r"runs do not fit together: .*run` sets aside"):
        store.read("runs")
