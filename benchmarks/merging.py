"""Puts results of several machines into one folder: every row with the provenance it came with."""

from __future__ import annotations

import enum
import pathlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from benchmarks.superfluous import discard_attempts
from bgn.results.atomic import write_bytes
from bgn.results.comparison import differing_columns
from bgn.results.quarantine import damage_of_run
from bgn.results.store import Kind, Store, StoreError, read_shard, writing_to

_ROWS: tuple[Kind, ...] = ("runs", "references")
_SAID = ("git_commit", "machine", "finished_at")


class Outcome(enum.Enum):
    """What became of a row."""

    TAKEN = "taken"
    SAME = "there already, the same"
    CONFLICT = "conflict"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class Merged:
    """One row of a source, and what became of it."""

    store: str
    """Budget and preset, such as ``laptop/calibrated``."""
    run: str
    source: pathlib.Path
    outcome: Outcome
    detail: str = ""


def stores(results: pathlib.Path) -> list[pathlib.Path]:
    """Return the stores of a results folder, relative to it.

    Raises
    ------
    StoreError
        There is none.
    """
    found = sorted(
        {path.parent.relative_to(results) for kind in _ROWS for path in results.glob(f"*/*/{kind}/")}
    )
    if not found:
        raise StoreError(f"{results} holds no results; expected a folder such as results/local")
    return found


def merge(sources: Sequence[pathlib.Path], into: pathlib.Path) -> Iterator[Merged]:
    """Copy what is not in ``into`` yet from the sources, in order; yield what becomes of every row.

    Of two different results of one run the first stays: that of ``into``, or of the source named first. Of the same
    result what ``into`` lacks is taken too: its policy, or what was measured of that. Files are copied as they are.

    Raises
    ------
    StoreError
        A source holds no results, another process writes to ``into``, or nothing can be written there.
    """
    for source, names in [(source, stores(source)) for source in sources]:
        for name in names:
            target = Store(into / name)
            with target.lock(), writing_to(target.root):
                yield from _merge_store(Store(source / name), target, name.as_posix(), source)


def _merge_store(store: Store, target: Store, name: str, source: pathlib.Path) -> Iterator[Merged]:
    for kind in _ROWS:
        paths = (store.root / kind).rglob("[!.]*.parquet")
        runs = (path.relative_to(store.root / kind).with_suffix("").as_posix() for path in paths)
        for run in sorted(runs, key=lambda run: (run.endswith(".failed"), run)):  # what succeeded comes first
            outcome, detail = _merge_row(store, target, kind, run)
            yield Merged(name, run, source, outcome, detail)


def _merge_row(store: Store, target: Store, kind: Kind, run: str) -> tuple[Outcome, str]:
    files = _files(store, kind, run)
    damage = damage_of_run(store, kind, run)
    if damage:
        return Outcome.DAMAGED, damage
    present, failed = target.shard(kind, run), run.endswith(".failed")
    if present.exists():
        outcome, detail = (Outcome.SAME, "") if failed else _compare(store, target, kind, run)
        if outcome is Outcome.SAME:
            _copy([path for path in files if not _target(path, store, target).exists()], store, target)
        return outcome, detail
    if failed and target.shard(kind, run.removesuffix(".failed")).exists():
        return Outcome.SAME, "it has succeeded since"
    _copy(files, store, target)
    if not failed:
        (row,) = read_shard(present).to_pylist()
        discard_attempts(target, kind, run, row["key"])
    return Outcome.TAKEN, ""


def _copy(files: Sequence[pathlib.Path], store: Store, target: Store) -> None:
    for path in files:
        write_bytes(_target(path, store, target), path.read_bytes())


def _target(path: pathlib.Path, store: Store, target: Store) -> pathlib.Path:
    return target.root / path.relative_to(store.root)


def _files(store: Store, kind: Kind, run: str) -> list[pathlib.Path]:
    """Return the files of a run, its row last, which stands for the others."""
    others = store.companions(run) if kind == "runs" else []
    return [*(path for path in others if path.exists()), store.shard(kind, run)]


def _compare(store: Store, target: Store, kind: Kind, run: str) -> tuple[Outcome, str]:
    mine, theirs = (read_shard(one.shard(kind, run)) for one in (target, store))
    (kept,), (other,) = mine.to_pylist(), theirs.to_pylist()
    reasons = [] if kept["key"] == other["key"] else ["other code, settings or tables"]
    differing = differing_columns(mine, theirs)
    if differing:
        reasons.append(f"other {', '.join(differing[:4])}" + (", …" if len(differing) > 4 else ""))
    if not reasons:
        return Outcome.SAME, ""
    said = [", ".join(str(row.get(name)) for name in _SAID) for row in (kept, other)]
    return Outcome.CONFLICT, f"{' and '.join(reasons)}; kept: {said[0]}; not taken: {said[1]}"
