"""Reports that two versions of the code compute the same: runs trained by both, compared bit for bit."""

from __future__ import annotations

import hashlib
import json
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from benchmarks.former import Former
from benchmarks.rerun import Comparison, rerun_and_compare
from benchmarks.retraining import Fingerprint, retrain_cells
from bgn.errors import BgnError
from bgn.results import provenance
from bgn.results.atomic import write_bytes
from bgn.results.environment import environment
from bgn.results.store import Store

#: What a run or row may execute, by the name that reports give it.
SCOPES = {
    "training": provenance.TRAINING,
    "training with physics": provenance.TRAINING_WITH_PHYSICS,
    "planning": provenance.PLANNING,
}


class ReportError(BgnError, ValueError):
    """A file that is no report of equivalence, or that reports a difference."""


@dataclass(frozen=True)
class Report:
    """What was compared, and the code on both sides."""

    commit: str
    """The former revision."""
    preset: str
    """The reading of the settings under which runs were compared."""
    how: str
    """What was computed on both sides."""
    then: Mapping[str, str]
    """Code hashes of the former revision by scope, as the present code is hashed."""
    now: Mapping[str, str]
    """Code hashes of the present code."""
    comparisons: Sequence[Comparison]

    @property
    def identical(self) -> bool:
        """Whether every comparison shows no difference."""
        return all(one.identical for one in self.comparisons)

    @property
    def name(self) -> str:
        """A name for the file that keeps it."""
        content = json.dumps(asdict(self), sort_keys=True)
        return f"{self.commit[:10]}-{self.preset}-{hashlib.sha256(content.encode()).hexdigest()[:8]}.json"

    def covers(self, scope: str, then: str, now: str, preset: str, work: str) -> bool:
        """Say whether it shows that two codes of a scope compute the same for a cell or reference row."""
        if preset != self.preset:
            return False
        compared = any(one.run == work or one.run.startswith(f"{work}/seed-") for one in self.comparisons)
        return compared and (self.then[scope], self.now[scope]) == (then, now)

    def to_json(self) -> str:
        """Write it down, with what it was computed with."""
        content = asdict(self) | {"identical": self.identical, "computed_with": dict(environment())}
        return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def compare_cells(
    former: Former, cells: Sequence[str], *, budget: str, preset: str, seeds: Sequence[int]
) -> Report:
    """Train cells with a revision's code and with the present one."""
    then = former.retrain(cells, budget, preset, seeds)
    now = retrain_cells(cells, budget, preset, seeds)
    how = f"trained by both, budget {budget}"
    return _report(former, preset, how, [Comparison(run, then[run], now[run]) for run in now])


def compare_stored(former: Former, store: Store, runs: Sequence[str]) -> Report:
    """Compute stored runs and reference rows of a revision again with the present code."""
    how = f"rows of {'/'.join(store.root.parts[-2:])} computed again"
    return _report(former, store.root.name, how, [rerun_and_compare(store, run) for run in runs])


def _report(former: Former, preset: str, how: str, comparisons: Sequence[Comparison]) -> Report:
    then = {name: former.code_hash(scope) for name, scope in SCOPES.items()}
    now = {name: provenance.code_hash(scope) for name, scope in SCOPES.items()}
    return Report(former.commit, preset, how, then, now, comparisons)


def write(report: Report, path: pathlib.Path) -> None:
    """Write a report."""
    write_bytes(path, report.to_json().encode())


def load(path: pathlib.Path) -> Report:
    """Read a report that shows no difference.

    Raises
    ------
    ReportError
        It is no report, or shows a difference.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        comparisons = [
            Comparison(one["run"], Fingerprint(**one["then"]), Fingerprint(**one["now"]))
            for one in content["comparisons"]
        ]
        report = Report(
            content["commit"], content["preset"], content["how"], content["then"], content["now"], comparisons
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ReportError(f"{path} is no report of equivalence: {error}") from error
    for one in report.comparisons:
        if not one.identical:
            raise ReportError(f"{path}: {one.run} comes out otherwise ({', '.join(one.differences)})")
    return report
