"""Gives stored results the key of newer code where that is shown to compute the same: a recorded migration.

A content key changes with the code, the settings or the domain's tables. A row is re-keyed only where

- it was computed by clean code, and is just what a given revision asks for (its own code says so);
- the settings are equal but for fields that are new and have their default, and the tables are equal;
- and the code is equal: the definitions that a run executes, as :mod:`bgn.results.code` hashes them, are the
  same in that revision and now; or a report (:mod:`benchmarks.equivalence`) shows that the cell, trained by both
  under the same preset, is the same bit for bit.

The row then tells its first key and code hash, and why it has another; a report is kept beside the results.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import fnmatch
import json
import pathlib
import shutil
import sys
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks import equivalence, registry
from benchmarks.equivalence import SCOPES, Report
from benchmarks.former import Answers, Former, former
from benchmarks.plan import Request, Selection
from benchmarks.registry import Registry
from benchmarks.rerun import RerunError
from benchmarks.tasks import ReferenceSpec
from bgn.errors import BgnError
from bgn.results import schema
from bgn.results.provenance import Origin
from bgn.results.run_ids import RunId
from bgn.results.store import Kind, Store, write_parquet

_KINDS: tuple[Kind, ...] = ("runs", "references")
_FAILED, _USAGE = 1, 2


@dataclass(frozen=True)
class Row:
    """A stored result."""

    budget: str
    preset: str
    kind: Kind
    path: pathlib.Path
    values: Mapping[str, Any]

    @property
    def store(self) -> str:
        """Its folder, such as ``laptop/calibrated``."""
        return f"{self.budget}/{self.preset}"

    @property
    def computed_under(self) -> str:
        """The store it was computed for: its own, unless it was taken from another."""
        return str(self.values.get("taken_from") or self.store)

    @property
    def run(self) -> str:
        """Its id, such as ``hallway/ah-ch/seed-0``."""
        return str(self.values["run"])

    @property
    def name(self) -> str:
        """Its name among all rows of a store."""
        return f"{self.kind} {self.run}"

    @property
    def work(self) -> str:
        """The cell, or the reference row."""
        return str(RunId.parse(self.run).cell) if self.kind == "runs" else self.run


@dataclass(frozen=True)
class Decision:
    """What becomes of a row."""

    row: Row
    verdict: str
    """``current``, ``re-keyed``, or ``older``."""
    reason: str
    origin: Origin | None = None
    """The new one of a row to be re-keyed."""


@dataclass(frozen=True)
class Asked:
    """What a revision says about the stored rows."""

    commit: str
    answers: Answers
    code: Mapping[str, str]
    """Its code hashes by scope, as the present code is hashed."""

    def wants(self, row: Row) -> bool:
        """Say whether a row is just what the revision asks for."""
        origin = self.answers.wanted.get(row.computed_under, {}).get(row.name)
        return origin is not None and origin.key == row.values["key"]


def rows(results: pathlib.Path) -> Iterator[Row]:
    """Yield the finished rows of all stores under a folder."""
    for kind in _KINDS:
        for path in sorted(results.glob(f"*/*/{kind}/**/[!.]*.parquet")):
            values = pq.read_table(path).to_pylist()[0]
            if values["status"] == "ok":
                budget, preset, *_ = path.relative_to(results).parts
                yield Row(budget, preset, kind, path, values)


def decide(
    stored: Sequence[Row], revisions: Sequence[Former], reports: Sequence[Report] = ()
) -> list[Decision]:
    """Say of each row whether it is current, can be re-keyed, or stays older, and why."""
    known = registry.load()
    domains = {str(row.values["domain"]) for row in stored}
    present = {
        (budget, preset): _requests(known, budget, preset, domains, seeds)
        for budget, preset, seeds in _stores((row.store, row) for row in stored)
    }
    asked = [
        Asked(
            one.commit,
            one.ask(_stores((row.computed_under, row) for row in stored), domains),
            {name: one.code_hash(scope) for name, scope in SCOPES.items()},
        )
        for one in revisions
    ]
    return [_decide(row, present[row.budget, row.preset].get(row.name), asked, reports) for row in stored]


def rekey(decision: Decision) -> None:
    """Write a row, and its curve, under the new key; a migration that was cut off is done again by the same command."""
    assert decision.origin is not None
    row, origin = decision.row, decision.origin
    curve = Store(row.path.parents[len(row.run.split("/"))]).shard("curves", row.run)
    if row.kind == "runs":
        write_parquet(curve, _with(pq.read_table(curve), {"key": origin.key}))
    former_values = {name: row.values.get(name) for name in schema.REKEYING}
    reasons = filter(None, (former_values["rekeyed_because"], decision.reason))
    new = {
        "key": origin.key,
        "spec_hash": origin.spec,
        "code_hash": origin.code,
        "data_hash": origin.data,
        "former_key": former_values["former_key"] or row.values["key"],
        "former_code_hash": former_values["former_code_hash"] or row.values["code_hash"],
        "rekeyed_because": "; then ".join(reasons),
    }
    write_parquet(row.path, _with(pq.read_table(row.path), new))


def _decide(row: Row, request: Request | None, asked: Sequence[Asked], reports: Sequence[Report]) -> Decision:
    if request is None:
        return Decision(row, "older", "the registry does not ask for it")
    if row.values["key"] == request.origin.key:
        return Decision(row, "current", "")
    if row.values["git_dirty"] is not False:
        return Decision(row, "older", "it was not computed by the clean code of a commit")
    revision = next((one for one in asked if one.wants(row)), None)
    if revision is None:
        return Decision(row, "older", "none of the revisions asks for it as it is")
    return _judge(row, request, revision, reports)


def _judge(row: Row, request: Request, revision: Asked, reports: Sequence[Report]) -> Decision:
    """Say whether what a revision computed is what is computed now."""
    at = f"at {revision.commit[:10]}"
    if not same_request(json.loads(row.values["spec"]), request.spec):
        return Decision(row, "older", f"it was asked for in other words {at}")
    if revision.answers.tables.get(request.spec.domain) != request.origin.data:
        return Decision(row, "older", f"the domain's tables were others {at}")
    scope = _scope(request)
    then, now = revision.code[scope], request.origin.code
    if then == now:
        why = f"the definitions that it executes are the same {at} and now; only where they stand is new"
        return Decision(row, "re-keyed", why, request.origin)
    for report in reports:
        if report.covers(scope, then, now, row.preset, row.work):
            why = f"what it computes is the same {at} and now, bit for bit: equivalence/{report.name}"
            return Decision(row, "re-keyed", why, request.origin)
    return Decision(row, "older", f"the code for {scope} was other {at}, and no report covers {row.work}")


def same_request(stored: Any, present: Any) -> bool:
    """Say whether a specification read from JSON asks for the same as a present one, but for new fields' defaults."""
    if not dataclasses.is_dataclass(present):
        plain = dict(present) if isinstance(present, Mapping) else present
        return bool(stored == plain)
    fields = {field.name: field for field in dataclasses.fields(present)}
    return stored.keys() <= fields.keys() and all(
        same_request(stored[name], getattr(present, name))
        if name in stored
        else getattr(present, name) == _default(field)
        for name, field in fields.items()
    )


def _default(field: dataclasses.Field[Any]) -> Any:
    factory = field.default_factory
    return field.default if factory is dataclasses.MISSING else factory()


def _scope(request: Request) -> str:
    if isinstance(request.spec, ReferenceSpec):
        return "planning"
    return "training with physics" if request.spec.physics_episodes else "training"


def _stores(stored: Iterable[tuple[str, Row]]) -> list[tuple[str, str, list[int]]]:
    """Return the stores of some rows: budget, preset and seeds."""
    seeds: dict[str, set[int]] = {}
    for store, row in stored:
        seeds.setdefault(store, set()).add(int(row.values["seed"]))
    return [(*_parts(store), sorted(found)) for store, found in seeds.items()]


def _parts(store: str) -> tuple[str, str]:
    budget, _, preset = store.partition("/")
    return budget, preset


def _requests(
    known: Registry, budget: str, preset: str, domains: Collection[str], seeds: Sequence[int]
) -> dict[str, Request]:
    """Return what the present code asks for in a store, by name; nothing for one that the registry does not know."""
    if budget not in known.budgets or preset not in known.presets:
        return {}
    everything = Selection(
        registry=known,
        budget=budget,
        preset=preset,
        domains=tuple(name for name in known.budgets[budget].env_steps if name in domains),
        agents=tuple(known.agents),
        references=tuple(known.references),
        seeds=tuple(seeds),
    )
    return {f"{one.kind} {one.id}": one for one in everything.requests()}


def _with(table: pa.Table, values: Mapping[str, str]) -> pa.Table:
    """Return a table with the same text in all rows of some columns, new ones at the end."""
    for name, value in values.items():
        column = pa.array([value] * len(table), pa.string())
        place = table.schema.get_field_index(name)
        table = table.append_column(name, column) if place < 0 else table.set_column(place, name, column)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    options = _parser().parse_args(arguments)
    try:
        status: int = options.command(options)
    except BgnError as error:
        print(f"error: {error}", file=sys.stderr)
        return _USAGE
    return status


def _rekey(options: argparse.Namespace) -> int:
    reports = [equivalence.load(path) for path in options.equivalent]
    stored = list(rows(options.results))
    decisions: list[Decision] = []
    with contextlib.ExitStack() as stack:
        revisions = [stack.enter_context(former(one)) for one in options.revision]
        decisions = decide(stored, revisions, reports)
    changed = [one for one in decisions if one.origin is not None]
    if not options.dry_run:
        for path, report in zip(options.equivalent, reports, strict=True):
            kept = options.results / "equivalence" / report.name
            kept.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, kept)
        for decision in changed:
            rekey(decision)
    counted = Counter((one.row.store, one.verdict, one.reason) for one in decisions)
    for (store, verdict, reason), number in sorted(counted.items()):
        print(f"{store}: {number} rows {verdict}{f': {reason}' if reason else ''}")
    return _FAILED if any(one.verdict == "older" for one in decisions) else 0


def _compare(options: argparse.Namespace) -> int:
    known = registry.load()
    with former(options.revision) as revision:
        if options.stored is None:
            cells = options.cell or [
                f"{domain}/{agent}" for domain in known.domains for agent in known.agents
            ]
            report = equivalence.compare_cells(
                revision, cells, budget=options.budget, preset=options.preset, seeds=(0,)
            )
        else:
            store = Store(options.results / options.budget / options.preset)
            report = equivalence.compare_stored(revision, store, _matching(options))
    equivalence.write(report, options.out)
    for one in report.comparisons:
        print(f"{one.run}: {'identical' if one.identical else 'other ' + ', '.join(one.differences)}")
    return 0 if report.identical else _FAILED


def _matching(options: argparse.Namespace) -> list[str]:
    """Return the stored rows that were asked for by name or pattern."""
    stored = [row.run for row in rows(options.results) if row.store == f"{options.budget}/{options.preset}"]
    found = [run for run in stored if any(fnmatch.fnmatchcase(run, one) for one in options.stored)]
    if not found:
        place = options.results / options.budget / options.preset
        raise RerunError(f"{place} holds no row like {' or '.join(options.stored)}")
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.migration",
        description="Give results that newer code would compute too its key.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    move = commands.add_parser(
        "rekey", help="re-key the rows whose code is equal, say why the others are not"
    )
    move.add_argument("--results", type=pathlib.Path, required=True, help="folder of the stores")
    move.add_argument(
        "--revision", nargs="+", required=True, help="revisions whose results may be kept, such as a commit"
    )
    move.add_argument(
        "--equivalent",
        nargs="+",
        type=pathlib.Path,
        default=[],
        metavar="REPORT",
        help="what `compare` wrote: also re-key rows whose code differs where these show equal results",
    )
    move.add_argument("--dry-run", action="store_true", help="only say what would be done")
    move.set_defaults(command=_rekey)
    known = registry.load().defaults
    compare = commands.add_parser("compare", help="train by a revision and by the present code, bit for bit")
    compare.add_argument("--revision", required=True)
    compare.add_argument("--out", type=pathlib.Path, required=True, metavar="REPORT")
    compare.add_argument("--budget", default="smoke", help="default: %(default)s")
    compare.add_argument("--preset", default=known.preset, help="default: %(default)s")
    compare.add_argument("--cell", nargs="+", help="such as hallway/ah-ch (default: all)")
    compare.add_argument(
        "--stored",
        nargs="+",
        metavar="RUN",
        help="instead compute these stored rows of the revision again, such as hallway/*/seed-0",
    )
    compare.add_argument("--results", type=pathlib.Path, default=pathlib.Path("results/published"))
    compare.set_defaults(command=_compare)
    return parser


if __name__ == "__main__":
    sys.exit(main())
