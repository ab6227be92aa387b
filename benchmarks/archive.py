"""One file that holds results and says what they must be: a tar archive with a manifest of checksums."""

from __future__ import annotations

import hashlib
import io
import json
import pathlib
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO

from benchmarks import merging
from bgn.errors import BgnError
from bgn.results.atomic import write_atomically
from bgn.results.environment import environment
from bgn.results.quarantine import damage_of_policy, damage_of_shard
from bgn.results.store import Kind, Store

MANIFEST = "manifest.json"
FORMAT = "bgn-results-1"
_KINDS: tuple[Kind, ...] = ("runs", "curves", "references")
_MAX_MANIFEST = 64 << 20


class ArchiveError(BgnError, ValueError):
    """A file that is not an archive of results; the message says why."""


def export(results: pathlib.Path, archive: pathlib.Path, *, policies: bool = True) -> Mapping[str, Any]:
    """Write all finished results of a folder, and what is printed of them, to an archive; return its manifest.

    Equal results give an equal archive, byte for byte: no times, no owners, names in order.

    Raises
    ------
    StoreError
        The folder holds no results.
    """
    folders = [*_KINDS, "measures", "tables", *(["policies"] if policies else [])]
    paths = {
        path.relative_to(results).as_posix(): path
        for store in merging.stores(results)
        for folder in folders
        for path in sorted((results / store / folder).rglob("[!.]*"))
        if path.is_file() and not path.name.endswith(".failed.parquet")
    }
    manifest = {
        "format": FORMAT,
        "written_by": environment()["version_bgn"],
        "files": {name: _entry(path.read_bytes()) for name, path in sorted(paths.items())},
    }

    def write(partial: pathlib.Path) -> None:
        with tarfile.open(partial, "w") as tar:
            _add(tar, MANIFEST, json.dumps(manifest, indent=1).encode())
            for name, path in sorted(paths.items()):
                _add(tar, name, path.read_bytes())

    write_atomically(archive, write)
    return manifest


def verify_archive(archive: pathlib.Path) -> list[str]:
    """Return what is wrong with an archive: files that are missing, too many, changed, or no results.

    Raises
    ------
    ArchiveError
        It is no archive of results at all.
    """
    with tempfile.TemporaryDirectory() as folder:
        problems: list[str] = []
        here = pathlib.Path(folder)
        try:
            with tarfile.open(archive, "r:") as tar:
                expected = _read_manifest(archive, tar)
                for name, content in _members(tar, expected, problems):
                    (here / name).parent.mkdir(parents=True, exist_ok=True)
                    (here / name).write_bytes(content)
        except (tarfile.TarError, OSError, EOFError) as error:
            raise ArchiveError(f"{archive} is not a whole archive of results: {error}") from error
        problems += [f"{name}: missing" for name in sorted(expected) if not (here / name).exists()]
        return problems + ([] if problems else verify_folder(here))


def verify_folder(results: pathlib.Path) -> list[str]:
    """Return what is wrong with the files of a results folder, which are named from there; nothing is changed."""
    problems = []
    for name in merging.stores(results):
        store = Store(results / name)
        for kind in _KINDS:
            for path in sorted((store.root / kind).rglob("[!.]*.parquet")):
                problems += _problem(path.relative_to(results), damage_of_shard(store, kind, path))
        for path in sorted((store.root / "policies").rglob("[!.]*.safetensors")):
            problems += _problem(path.relative_to(results), damage_of_policy(path))
    return problems


def _members(
    tar: tarfile.TarFile, expected: Mapping[str, Any], problems: list[str]
) -> Iterator[tuple[str, bytes]]:
    """Yield the files that the manifest names, as it describes them; note all others."""
    seen = {MANIFEST}
    for member in tar:
        if member.name == MANIFEST:
            continue
        known = expected.get(member.name)
        if known is None or member.name in seen or not member.isfile() or member.size != known["bytes"]:
            problems.append(f"{member.name}: not as the manifest lists it")
            continue
        seen.add(member.name)
        content = _content(tar, member)
        if _entry(content) != known:
            problems.append(f"{member.name}: changed, its checksum differs")
        yield member.name, content


def _read_manifest(archive: pathlib.Path, tar: tarfile.TarFile) -> dict[str, Any]:
    first = tar.next()
    if first is None or first.name != MANIFEST or not first.isfile() or first.size > _MAX_MANIFEST:
        raise ArchiveError(f"{archive} does not begin with {MANIFEST}; expected what `export` writes")
    try:
        manifest = json.loads(_content(tar, first))
        files: dict[str, Any] = dict(manifest["files"]) if manifest["format"] == FORMAT else {}
        well_formed = all(
            isinstance(entry["bytes"], int) and isinstance(entry["sha256"], str) for entry in files.values()
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        files, well_formed = {}, False
    if not files or not well_formed:
        raise ArchiveError(f"{archive}: {MANIFEST} is not of format {FORMAT!r}")
    for name in files:
        if pathlib.PurePosixPath(name).is_absolute() or ".." in pathlib.PurePosixPath(name).parts:
            raise ArchiveError(f"{archive}: {MANIFEST} names {name!r}, which lies outside the results")
    return files


def _content(tar: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = tar.extractfile(member)
    assert file is not None  # it is a file
    return file.read()


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    file: BinaryIO = io.BytesIO(content)
    tar.addfile(member, file)


def _entry(content: bytes) -> dict[str, Any]:
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def _problem(path: pathlib.Path, damage: str) -> list[str]:
    return [f"{path}: {damage}"] if damage else []
