"""The store: a folder of small parquet shards, one per run, each written in one atomic step.

Under ``results/local/<budget>/<preset>/``, for the run ``hallway/ah-ch/seed-3``:

- ``runs/hallway/ah-ch/seed-3.parquet``: the run's row, written last, so that it stands for all the others;
- ``runs/hallway/ah-ch/seed-3.failed.parquet``: the last failed attempt, gone once the run succeeds;
- ``curves/hallway/ah-ch/seed-3.parquet``: its learning curve;
- ``policies/hallway/ah-ch/seed-3.safetensors``: its policy;
- ``measures/hallway/ah-ch/seed-3.parquet``: what was measured of that policy afterwards, if anything.

``references/hallway/sarsop/clean.parquet`` is the row of a policy that is not trained, ``tables/`` holds what
is printed, and ``.work/`` unfinished stacks of runs, which are no results.
"""

from __future__ import annotations

import contextlib
import fcntl
import pathlib
from collections.abc import Iterator
from typing import Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bgn.errors import BgnError
from bgn.results.atomic import TORN, write_atomically

Kind = Literal["runs", "curves", "references", "measures"]
_FAILED = ".failed"


class StoreError(BgnError, RuntimeError):
    """The store cannot be read or written; the message names the file and what to do."""


class Store:
    """Results under one folder."""

    def __init__(self, root: pathlib.Path) -> None:
        """Use ``root``, which need not exist yet."""
        self.root = root

    def shard(self, kind: Kind, run: str) -> pathlib.Path:
        """Return where the shard of a run id such as ``hallway/ah-ch/seed-0`` lies."""
        return self.root / kind / f"{run}.parquet"

    def policy(self, run: str) -> pathlib.Path:
        """Return where the policy of a run lies."""
        return self.root / "policies" / f"{run}.safetensors"

    def checkpoint(self, cell: str, key: str) -> pathlib.Path:
        """Return where the unfinished stack ``key`` of a cell such as ``hallway/ah-ch`` is kept."""
        return self.root / ".work" / cell / f"{key}.checkpoint"

    def discard_checkpoints(self, cell: str) -> None:
        """Remove all unfinished work of a cell."""
        for path in (self.root / ".work" / cell).glob("*.checkpoint"):
            path.unlink(missing_ok=True)

    def write(self, kind: Kind, run: str, table: pa.Table) -> None:
        """Store a finished shard; a failed attempt recorded before is forgotten."""
        path = self.shard(kind, run)
        write_parquet(path, table)
        _failed(path).unlink(missing_ok=True)

    def write_failure(self, kind: Kind, run: str, table: pa.Table) -> None:
        """Record a failed attempt beside whatever result the run has from before."""
        write_parquet(_failed(self.shard(kind, run)), table)

    def read(self, kind: Kind) -> pd.DataFrame:
        """Return all rows of a kind in one frame (no columns where there are no rows).

        Raises
        ------
        StoreError
            A shard cannot be read.
        """
        paths = sorted((self.root / kind).rglob("[!.]*.parquet"))
        if not paths:
            return pd.DataFrame()
        tables = [_read_shard(path) for path in paths]
        frame: pd.DataFrame = pa.concat_tables(tables, promote_options="default").to_pandas()
        return frame

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes from running into the same folder; also sweeps up torn writes.

        Raises
        ------
        StoreError
            Another process holds the lock.
        """
        work = self.root / ".work"
        work.mkdir(parents=True, exist_ok=True)
        with (work / "lock").open("w") as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                message = f"another process is writing to {self.root}; wait for it or stop it"
                raise StoreError(message) from error
            for torn in self.root.rglob(TORN):
                torn.unlink(missing_ok=True)
            yield


def write_parquet(path: pathlib.Path, table: pa.Table) -> None:
    """Write a parquet file in one atomic step."""
    write_atomically(path, lambda partial: pq.write_table(table, partial, compression="zstd"))


def _failed(path: pathlib.Path) -> pathlib.Path:
    return path.with_name(f"{path.stem}{_FAILED}{path.suffix}")


def _read_shard(path: pathlib.Path) -> pa.Table:
    try:
        with path.open("rb") as handle:
            return pq.read_table(handle)
    except (pa.ArrowInvalid, OSError) as error:
        raise StoreError(f"cannot read {path}: {error}; delete the file and run again") from error
