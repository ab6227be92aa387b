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
import errno
import fcntl
import os
import pathlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bgn.errors import BgnError
from bgn.results import schema
from bgn.results.atomic import TORN, write_bytes

Kind = Literal["runs", "curves", "references", "measures"]
_FAILED = ".failed"
_ADVICE = "; `python -m benchmarks run` sets aside what is damaged and computes it anew"
#: Above every shard: what asks for more is damaged, or meant to fill the memory.
MAX_ROWS = 1_000_000
MAX_SHARD_BYTES = 1 << 28


#: What an operating system says when nothing more can be written, whatever it is.
_STORAGE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}


class StoreError(BgnError, RuntimeError):
    """The store cannot be read or written; the message names the file and what to do."""


class StorageError(StoreError):
    """Nothing more can be written: the disk is full, read-only or broken."""


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

    def companions(self, run: str) -> list[pathlib.Path]:
        """Return what may lie beside a run's row: its curve, its policy and what was measured of that afterwards."""
        return [self.shard("curves", run), self.policy(run), self.shard("measures", run)]

    def checkpoint(self, cell: str, key: str, seeds: Sequence[int]) -> pathlib.Path:
        """Return where unfinished seeds of a cell such as ``hallway/ah-ch``, stacked, are kept."""
        stack = "-".join(map(str, seeds))
        return self.root / ".work" / cell / f"{key}-{stack}.checkpoint"

    def unfinished(self, cell: str, key: str) -> list[tuple[int, ...]]:
        """Return the stacks of seeds of a cell that have a checkpoint under ``key``."""
        paths = sorted((self.root / ".work" / cell).glob(f"{key}-*.checkpoint"))
        return [_stack(path) for path in paths]

    def discard_checkpoints(self, cell: str, seeds: Iterable[int]) -> None:
        """Remove all unfinished work on these seeds of a cell, under whatever key."""
        for path in (self.root / ".work" / cell).glob("*.checkpoint"):
            if not set(seeds).isdisjoint(_stack(path)):
                path.unlink(missing_ok=True)

    def adopt(self, kind: Kind, runs: Iterable[str], files: Mapping[str, bytes]) -> None:
        """Take over what was stored for some runs elsewhere, by path below that store's root.

        As always, a run's row comes last, and a failed attempt recorded before is forgotten.
        """
        rows = {self.shard(kind, run): run for run in runs}
        paths = {self.root / name: content for name, content in files.items()}
        for path in sorted(paths, key=lambda path: path in rows):
            write_bytes(path, paths[path])
            if path in rows:
                _failed(path).unlink(missing_ok=True)

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
        tables = []
        for path in paths:
            with contextlib.suppress(FileNotFoundError):  # a failure forgotten since by a run that goes on
                tables.append(_with_one_kind_of_text(read_shard(path)))
        try:
            frame: pd.DataFrame = pa.concat_tables(tables, promote_options="default").to_pandas()
        except pa.ArrowException as error:
            raise StoreError(
                f"the shards in {self.root / kind} do not fit together: {error}{_ADVICE}"
            ) from error
        lacking = () if kind in ("curves", "measures") else {*schema.OUTCOME, *schema.PROVENANCE} - set(frame)
        return frame.assign(**dict.fromkeys(lacking))  # all of an older version, which knew fewer columns

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes from running into the same folder; also sweeps up torn writes.

        Raises
        ------
        StoreError
            Another process holds the lock.
        """
        work = self.root / ".work"
        try:
            work.mkdir(parents=True, exist_ok=True)
            handle = (work / "lock").open("a+", encoding="utf-8")
        except OSError as error:
            raise _unwritable(error, work) from error
        with handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                handle.seek(0)
                holder = handle.read().strip() or "?"
                message = f"another process ({holder}) is writing to {self.root}; wait for it or stop it"
                raise StoreError(message) from error
            with writing_to(self.root):
                handle.truncate(0)
                handle.write(f"{os.getpid()}\n")
                handle.flush()
                self._sweep()
            yield

    def _sweep(self) -> None:
        """Remove what killed processes left half written."""
        for torn in self.root.rglob(TORN):
            torn.unlink(missing_ok=True)


@contextlib.contextmanager
def writing_to(root: pathlib.Path) -> Iterator[None]:
    """Say in the store's words that nothing can be written.

    Raises
    ------
    StorageError
        In place of an ``OSError`` that speaks of the disk, not of what is written.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in _STORAGE:
            raise
        raise _unwritable(error, root) from error


def _unwritable(error: OSError, root: pathlib.Path) -> StorageError:
    where, why = error.filename or root, os.strerror(error.errno or 0)
    advice = "make room there, or choose another folder with --results, and run again"
    return StorageError(f"cannot write {where}: {why}; {advice}")


def write_parquet(path: pathlib.Path, table: pa.Table) -> None:
    """Write a parquet file in one atomic step."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    write_bytes(path, sink.getvalue().to_pybytes())


def _with_one_kind_of_text(table: pa.Table) -> pa.Table:
    """Return a table whose texts are all of one type; which a curve has depends on the version of pandas."""
    fields = [
        field.with_type(pa.string()) if pa.types.is_large_string(field.type) else field
        for field in table.schema
    ]
    return table.cast(pa.schema(fields))


def _stack(checkpoint: pathlib.Path) -> tuple[int, ...]:
    return tuple(int(seed) for seed in checkpoint.stem.split("-")[1:])


def _failed(path: pathlib.Path) -> pathlib.Path:
    return path.with_name(f"{path.stem}{_FAILED}{path.suffix}")


def read_shard(path: pathlib.Path) -> pa.Table:
    """Read one shard, whose pages must match their checksums.

    Raises
    ------
    StoreError
        It is not a whole parquet file, or holds more than any run leaves behind.
    """
    try:
        with path.open("rb") as handle:
            file = pq.ParquetFile(handle, page_checksum_verification=True)
            _check_size(path, file.metadata)
            return file.read()
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        reason = str(error).partition("\n")[0][:200]
        raise StoreError(f"cannot read {path}: {reason}{_ADVICE}") from error


def _check_size(path: pathlib.Path, metadata: pq.FileMetaData) -> None:
    groups = range(metadata.num_row_groups)
    size = sum(metadata.row_group(group).total_byte_size for group in groups)
    if not (0 <= metadata.num_rows <= MAX_ROWS and 0 <= size <= MAX_SHARD_BYTES):
        raise ValueError(f"it says it holds {metadata.num_rows} rows in {size} bytes, which no shard does")
