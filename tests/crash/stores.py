"""What a store holds: finished results, which nothing may touch; and what nobody needs any more."""

from __future__ import annotations

import fcntl
import hashlib
import pathlib
from collections.abc import Iterator, Set

import pandas as pd

from bgn.results import schema
from bgn.results.comparison import TIMINGS
from bgn.results.store import Kind, Store

#: What says how a result came about, not what it is: all but the hashes of what determines it.
PROVENANCE = {*schema.PROVENANCE} - {"key", "spec_hash", "code_hash", "data_hash", "spec"}
ROWS: tuple[Kind, ...] = ("runs", "references")
_FAILED = ".failed.parquet"

#: Files: inode, time of writing and checksum.
Files = dict[pathlib.Path, tuple[int, int, bytes]]


def done(store: Store) -> set[str]:
    """Return the ids of all finished runs and rows."""
    paths = {path.relative_to(store.root / kind) for kind in ROWS for path in _rows(store, kind)}
    return {path.with_suffix("").as_posix() for path in paths}


def finished(store: Store) -> Files:
    """Return the files of all finished runs and rows."""
    files = {path for run in done(store) for path in files_of(store, run)}
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns, _checksum(path)) for path in files}


def files_of(store: Store, run: str) -> list[pathlib.Path]:
    """Return the files of a finished run or row: the row first, which stands for the others."""
    paths = [store.shard(kind, run) for kind in (*ROWS, "curves")] + [store.policy(run)]
    return [path for path in paths if path.exists()]


def names(store: Store) -> set[str]:
    """Return the paths of all files below the store."""
    return {path.relative_to(store.root).as_posix() for path in store.root.rglob("*") if path.is_file()}


def strays(store: Store) -> set[str]:
    """Return the paths of files that are neither results nor tables nor work that is left to do."""
    known = done(store)
    return {name for name in names(store) if not _belongs(pathlib.PurePosixPath(name), known)}


def is_torn(name: str) -> bool:
    """Say whether a file was not written to its end."""
    return name.endswith(".partial")


def assert_untouched(before: Files, after: Files) -> None:
    """Fail if a file that was finished before is gone or was written again."""
    assert {path: after.get(path) for path in before} == before


def assert_unlocked(store: Store) -> None:
    """Fail if a process still keeps others from writing."""
    lock = store.root / ".work" / "lock"
    if lock.exists():
        with lock.open() as handle:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def assert_same_results(store: Store, other: Store) -> None:
    """Compare all rows, curves and policies, bit for bit."""
    for kind, key in (("runs", ["run"]), ("references", ["run"]), ("curves", ["run", "env_steps"])):
        frames = []
        for one in (store, other):
            frame = one.read(kind)
            frame = frame if kind == "curves" else frame[frame["status"] == "ok"]
            dropped = [*PROVENANCE, *TIMINGS]
            frames.append(frame.drop(columns=dropped, errors="ignore").sort_values(key, ignore_index=True))
        pd.testing.assert_frame_equal(*frames, check_exact=True)
    for run in set(store.read("runs")["run"]):
        assert store.policy(run).read_bytes() == other.policy(run).read_bytes()


def _rows(store: Store, kind: Kind) -> Iterator[pathlib.Path]:
    return (path for path in (store.root / kind).rglob("[!.]*.parquet") if not path.name.endswith(_FAILED))


def _checksum(path: pathlib.Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


def _belongs(path: pathlib.PurePosixPath, known: Set[str]) -> bool:
    folder, *rest = path.parts
    if path.name.startswith("."):
        return False
    if folder in ROWS:
        return not path.name.endswith(_FAILED) or "/".join(rest).removesuffix(_FAILED) not in known
    if folder == ".work":
        return rest == ["lock"] or (path.suffix == ".checkpoint" and known.isdisjoint(_stack(rest)))
    return folder in ("curves", "policies", "tables")


def _stack(checkpoint: list[str]) -> set[str]:
    """Return the runs that a checkpoint in the work folder is of."""
    domain, agent, name = checkpoint
    return {f"{domain}/{agent}/seed-{seed}" for seed in name.removesuffix(".checkpoint").split("-")[1:]}
