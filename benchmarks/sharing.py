"""The commands that pass results on: ``merge``, ``export`` and ``verify``."""

from __future__ import annotations

import argparse
import os
import pathlib
from collections import Counter
from typing import Any

from rich.console import Console

from benchmarks import archive, merging
from benchmarks.archive import verify_archive, verify_folder
from benchmarks.merging import Merged, Outcome
from benchmarks.registry import Registry
from benchmarks.rerun import rerun_and_compare
from benchmarks.tasks import Work
from bgn.results.environment import environment
from bgn.results.store import Kind, StorageError, Store, read_shard

COMMANDS = ("merge", "export", "verify")
_DONE, _FAILED = 0, 1


def add_commands(commands: Any, benchmark: Registry) -> None:
    """Add the commands to the command line; the registry says which budget and preset are meant by default."""
    merge = commands.add_parser("merge", help="put results of several machines into one folder")
    merge.add_argument("sources", nargs="+", type=pathlib.Path, metavar="RESULTS")
    merge.add_argument("--into", type=pathlib.Path, required=True, metavar="RESULTS")
    merge.set_defaults(share=_merge)
    export = commands.add_parser("export", help="write results to one archive with checksums")
    export.add_argument("archive", type=pathlib.Path, metavar="FILE.tar")
    export.add_argument("--results", type=pathlib.Path, default=pathlib.Path("results/local"))
    export.add_argument("--without-policies", action="store_true", help="leave the trained policies out")
    export.set_defaults(share=_export)
    verify = commands.add_parser(
        "verify", help="check an archive or a results folder, or rerun one of its runs"
    )
    verify.add_argument("path", type=pathlib.Path, metavar="FILE.tar|RESULTS")
    verify.add_argument("--rerun", metavar="RUN", help="compute this run again and compare, bit for bit")
    verify.add_argument("--budget", default=benchmark.defaults.budget, help="of the run to compute again")
    verify.add_argument("--preset", help="of the run to compute again (default: the budget's own)")
    verify.set_defaults(share=_verify, preset_of=benchmark.preset_of)


def run(options: argparse.Namespace, work: Work, console: Console) -> int:
    """Do one of these commands; return its exit status."""
    status: int = options.share(options, work, console)
    return status


def _merge(options: argparse.Namespace, work: Work, console: Console) -> int:
    merged = []
    for one in merging.merge(options.sources, options.into):
        merged.append(one)
        if one.outcome in (Outcome.CONFLICT, Outcome.DAMAGED):
            _say(console, _described(one))
    counts = Counter(one.outcome for one in merged)
    _say(console, ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in Outcome if counts[outcome]))
    return _FAILED if counts[Outcome.CONFLICT] or counts[Outcome.DAMAGED] else _DONE


def _described(one: Merged) -> str:
    return f"{one.outcome.value}: {one.store} {one.run} of {one.source}: {one.detail}"


def _export(options: argparse.Namespace, work: Work, console: Console) -> int:
    try:
        manifest = archive.export(options.results, options.archive, policies=not options.without_policies)
    except OSError as error:
        why = os.strerror(error.errno or 0)
        raise StorageError(f"cannot write {options.archive}: {why}; choose another place") from error
    size = options.archive.stat().st_size
    _say(console, f"{len(manifest['files'])} files in {options.archive} ({size / 1e6:.1f} MB)")
    return _DONE


def _verify(options: argparse.Namespace, work: Work, console: Console) -> int:
    if options.rerun:
        return _rerun(options, work, console)
    verify = verify_folder if options.path.is_dir() else verify_archive
    problems = verify(options.path)
    for problem in problems:
        _say(console, problem)
    _say(console, f"{options.path}: {len(problems) or 'no'} file(s) damaged")
    return _FAILED if problems else _DONE


def _rerun(options: argparse.Namespace, work: Work, console: Console) -> int:
    preset = options.preset or options.preset_of(options.budget)
    store = Store(options.path / options.budget / preset)
    comparison = rerun_and_compare(store, options.rerun, work)
    if comparison.identical:
        _say(console, f"{options.rerun} came out the same, bit for bit")
        return _DONE
    _say(console, f"{options.rerun} came out otherwise: {', '.join(comparison.differences)}")
    (row,) = _rows(store, options.rerun)
    here = environment()
    for name, now in here.items():
        if now != row.get(name):
            _say(console, f"{name}: then {row.get(name)}, now {now}")
    return _FAILED


def _rows(store: Store, run: str) -> list[dict[str, Any]]:
    kind: Kind = "runs" if store.shard("runs", run).exists() else "references"
    rows: list[dict[str, Any]] = read_shard(store.shard(kind, run)).to_pylist()
    return rows


def _say(console: Console, text: str) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)
