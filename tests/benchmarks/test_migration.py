"""Re-keying stored results: every ground for doing so, and for not doing so."""

from __future__ import annotations

import dataclasses
import json
import pathlib
import re
import shutil
import subprocess
from collections.abc import Collection, Mapping, Sequence
from typing import cast

import pandas as pd
import pytest

from benchmarks import equivalence, migration, registry
from benchmarks.__main__ import main
from benchmarks.equivalence import SCOPES, Report, ReportError
from benchmarks.former import Answers, Former, FormerError, former
from benchmarks.migration import Decision, decide, rekey, rows, same_request
from benchmarks.rerun import Comparison
from benchmarks.retraining import Fingerprint, retrain_cells
from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.results import provenance
from bgn.results.code import Scope
from bgn.results.data import data_hash
from bgn.results.provenance import Origin
from bgn.results.store import Store
from bgn.training.cell import CellSpec
from tests.benchmarks import fakes

ROOT = pathlib.Path(__file__).parents[2]
PRESET = registry.load().defaults.preset
COMMIT = "0123456789abcdef"
SAME = Fingerprint("c", "m", "p")


@dataclasses.dataclass
class FakeFormer:
    """A revision that asked for everything under keys of its own."""

    results: pathlib.Path
    code: Mapping[str, str]
    tables: Mapping[str, str]
    commit: str = COMMIT

    def code_hash(self, scope: Scope) -> str:
        return next(self.code[name] for name, known in SCOPES.items() if known == scope)

    def ask(self, stores: Collection[tuple[str, str, Sequence[int]]], domains: Collection[str]) -> Answers:
        wanted: dict[str, dict[str, Origin]] = {}
        for row in rows(self.results):
            origin = Origin(*(str(row.values[part]) for part in ("spec_hash", "code_hash", "data_hash")))
            if origin.key == row.values["key"]:
                wanted.setdefault(row.store, {})[row.name] = origin
        return Answers(wanted, self.tables)


@pytest.fixture
def results(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """Two runs and two reference rows that were stored under another code hash."""
    clean = {**provenance.environment(), "git_commit": COMMIT, "git_dirty": False}
    monkeypatch.setattr(provenance, "environment", lambda device="cpu": clean)
    with monkeypatch.context() as patch:
        patch.setattr("bgn.results.provenance.code_hash", lambda *_, **__: "former")
        fakes.fill(tmp_path, fakes.WORKING, domain="hallway", agent="ah-ch", reference="random")
    return tmp_path


def present_code() -> dict[str, str]:
    return {name: provenance.code_hash(scope) for name, scope in SCOPES.items()}


def revision(results: pathlib.Path, code: Mapping[str, str] | None = None, tables: str = "") -> Former:
    """Return a stand-in for a revision, by default one of equal code and tables."""
    known = {"hallway": tables or data_hash(domains.get("hallway"))}
    return cast(Former, FakeFormer(results, code or present_code(), known))


def decisions(results: pathlib.Path, one: Former, *reports: Report) -> list[Decision]:
    return decide(list(rows(results)), [one], reports)


def verdicts(found: Sequence[Decision]) -> set[str]:
    return {one.verdict for one in found}


def test_equal_code_is_rekeyed_and_the_row_says_so(results: pathlib.Path) -> None:
    found = decisions(results, revision(results))
    assert len(found) == 4
    assert verdicts(found) == {"re-keyed"}
    before = {row.name: row.values for row in rows(results)}
    for one in found:
        rekey(one)
    for row in rows(results):
        old = before[row.name]
        assert row.values["key"] != old["key"]
        assert (row.values["former_key"], row.values["former_code_hash"]) == (old["key"], "former")
        assert "the definitions that it executes are the same at 0123456789" in row.values["rekeyed_because"]
        changed = {name for name in old if row.values[name] != old[name]}
        assert changed == {"key", "code_hash"}
    assert verdicts(decisions(results, revision(results))) == {"current"}


def test_the_command_line_then_takes_the_rows_for_current(
    results: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = ["--results", str(results), "--budget", "smoke", "--domain", "hallway"]
    command = ["run", *chosen, "--agent", "ah-ch", "--reference", "random"]
    for one in decisions(results, revision(results)):
        rekey(one)
    capsys.readouterr()
    assert main(command, work=fakes.BREAKING) == 0
    assert "4 of 4 runs and reference rows are done" in capsys.readouterr().out
    store = Store(results / "smoke" / PRESET)
    curves, runs = store.read("curves"), store.read("runs")
    assert set(curves["key"]) == set(runs["key"])


def test_a_migration_that_was_cut_off_is_done_again(
    results: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (first, *_) = decisions(results, revision(results))
    written: list[pathlib.Path] = []

    def fail(path: pathlib.Path, table: object) -> None:
        if written:
            raise KeyboardInterrupt
        migration_write(path, table)
        written.append(path)

    migration_write = migration.write_parquet  # type: ignore[attr-defined]
    with monkeypatch.context() as patch:
        patch.setattr(migration, "write_parquet", fail)
        with pytest.raises(KeyboardInterrupt):
            rekey(first)
    assert "curves" in written[0].parts
    for one in decisions(results, revision(results)):
        rekey(one)
    assert verdicts(decisions(results, revision(results))) == {"current"}


def test_other_code_stays_older_unless_a_report_shows_equal_results(results: pathlib.Path) -> None:
    others = {name: f"other {name}" for name in SCOPES}
    older = decisions(results, revision(results, others))
    assert verdicts(older) == {"older"}
    assert {one.reason.partition(" at ")[0] for one in older} == {
        "the code for training was other",
        "the code for planning was other",
    }
    shown = report(others, "hallway/ah-ch/seed-0")
    found = {one.row.kind: one for one in decisions(results, revision(results, others), shown)}
    assert found["runs"].verdict == "re-keyed"
    assert shown.name in found["runs"].reason
    assert found["references"].verdict == "older"
    for useless in (
        report(others, "hallway/ah-cs/seed-0"),
        report({**others, "training": "yet another"}, "hallway/ah-ch/seed-0"),
        dataclasses.replace(shown, preset="another"),
        dataclasses.replace(shown, now={**shown.now, "training": "not the present one"}),
    ):
        assert verdicts(decisions(results, revision(results, others), useless)) == {"older"}


def report(then: Mapping[str, str], *runs: str) -> Report:
    same = [Comparison(run, SAME, SAME) for run in runs]
    return Report(COMMIT, PRESET, "trained by both", then, present_code(), same)


def test_what_else_keeps_a_row_older(results: pathlib.Path) -> None:
    assert verdicts(decisions(results, revision(results, tables="others"))) == {"older"}
    stored = list(rows(results))
    dirty = [dataclasses.replace(row, values={**row.values, "git_dirty": True}) for row in stored]
    unknown = [dataclasses.replace(row, values={**row.values, "key": "of no revision"}) for row in stored]
    elsewhere = [dataclasses.replace(row, preset="gone") for row in stored]
    asked = [
        ('"env_steps": 3200', '"env_steps": 3201'),
        ('"episodes": 200', '"episodes": 201'),
    ]
    reworded = stored
    for old, new in asked:
        reworded = [
            dataclasses.replace(row, values={**row.values, "spec": row.values["spec"].replace(old, new)})
            for row in reworded
        ]
    for changed, why in (
        (dirty, "clean"),
        (unknown, "none of"),
        (elsewhere, "registry"),
        (reworded, "words"),
    ):
        found = decide(changed, [revision(results)])
        assert verdicts(found) == {"older"}
        assert all(why in one.reason for one in found)


def test_a_request_may_have_gained_fields_with_their_defaults() -> None:
    spec = CellSpec(domain="hallway", agent="ah-ch", hyperparameters=Hyperparameters(), env_steps=100)
    stored = json.loads(provenance.spec_json(spec))
    assert same_request(stored, spec)
    del stored["variant"], stored["hyperparameters"]["learning_rate"]
    assert same_request(stored, spec)
    tuned = dataclasses.replace(spec, hyperparameters=Hyperparameters(learning_rate=1.0))
    assert not same_request(stored, tuned)
    assert not same_request({**stored, "gone": 1}, spec)
    assert not same_request({**stored, "env_steps": 101}, spec)


def test_reports_are_read_back_and_differences_refused(tmp_path: pathlib.Path) -> None:
    shown = report(present_code(), "hallway/ah-ch/seed-0")
    equivalence.write(shown, tmp_path / "report.json")
    assert equivalence.load(tmp_path / "report.json") == shown
    other = Comparison("hallway/ah-ch/seed-1", SAME, dataclasses.replace(SAME, curve="other"))
    differing = dataclasses.replace(shown, comparisons=[*shown.comparisons, other])
    equivalence.write(differing, tmp_path / "differing.json")
    with pytest.raises(ReportError, match=r"seed-1 comes out otherwise \(curve\)"):
        equivalence.load(tmp_path / "differing.json")
    (tmp_path / "broken.json").write_text("{}")
    with pytest.raises(ReportError, match="no report"):
        equivalence.load(tmp_path / "broken.json")


# -- a real revision ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A repository with this project before two modules were moved, the registry cut to one domain."""
    root = tmp_path_factory.mktemp("repository")
    for name in ("bgn", "benchmarks"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    (root / "bgn" / "domains" / "layout.py").rename(root / "bgn" / "domains" / "_layout.py")
    (root / "bgn" / "training" / "evaluation.py").rename(root / "bgn" / "training" / "judging.py")
    for path in root.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"\bbgn\.domains\.layout\b", "bgn.domains._layout", text)
        path.write_text(text.replace("bgn.training.evaluation", "bgn.training.judging"), encoding="utf-8")
    identity = ("-c", "user.name=t", "-c", "user.email=t@example.org")
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-qm", "then"]):
        subprocess.run(["git", "-C", str(root), *identity, *arguments], check=True, capture_output=True)
    return root


def test_a_revision_answers_with_its_own_code(repository: pathlib.Path) -> None:
    cells = {"cells": ["hallway/ab-cb"], "budget": "smoke", "preset": PRESET, "seeds": [0]}
    with former("HEAD", repository) as then:
        assert {name: then.code_hash(scope) for name, scope in SCOPES.items()} == present_code()
        answers = then.ask([("smoke", PRESET, [0]), ("no such", PRESET, [0])], ["hallway"])
        retrained = then.retrain(**cells)  # type: ignore[arg-type]
        with pytest.raises(FormerError, match=r"has no bgn\.none; say in FORMER_PATHS"):
            then.code_hash(dataclasses.replace(SCOPES["training"], entries=("bgn.none",)))
        later = dataclasses.replace(SCOPES["training"], without=(*SCOPES["training"].without, "bgn.none"))
        assert then.code_hash(later) == then.code_hash(
            SCOPES["training"]
        )  # what was not there leaves out nothing
    assert list(answers.wanted) == [f"smoke/{PRESET}"]
    asked = answers.wanted[f"smoke/{PRESET}"]
    assert asked["runs hallway/ah-ch/seed-0"].code == provenance.code_hash(SCOPES["training"])
    assert (
        asked["runs hallway/ah-ch/seed-0"].data
        == answers.tables["hallway"]
        == data_hash(domains.get("hallway"))
    )
    assert retrained == retrain_cells(**cells)  # type: ignore[arg-type]


def test_the_command_says_what_it_would_do_and_does_it(
    results: pathlib.Path,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(migration, "former", lambda _: _Given(revision(results, others)))  # type: ignore[has-type]
    others = {name: f"other {name}" for name in SCOPES}
    shown = report(
        others, "hallway/ah-ch/seed-0", "hallway/random/clean", "hallway/random/hidden-first-action"
    )
    equivalence.write(shown, tmp_path / "given.json")
    command = ["rekey", "--results", str(results), "--revision", "abc"]
    assert migration.main(command) == 1
    assert "2 rows older: the code for training was other" in capsys.readouterr().out
    assert migration.main([*command, "--equivalent", str(tmp_path / "given.json"), "--dry-run"]) == 0
    assert not (results / "equivalence").exists()
    assert migration.main([*command, "--equivalent", str(tmp_path / "given.json")]) == 0
    kept = json.loads((results / "equivalence" / shown.name).read_text(encoding="utf-8"))
    assert kept["identical"]
    frame = pd.concat([pd.read_parquet(row.path) for row in rows(results)])
    assert frame["rekeyed_because"].str.endswith(f"equivalence/{shown.name}").all()
    assert migration.main(["rekey", "--results", str(results), "--revision", "abc"]) == 0
    assert "current" in capsys.readouterr().out
    assert migration.main([*command, "--equivalent", str(tmp_path / "none.json")]) == 2
    assert "is no report" in capsys.readouterr().err


def test_stored_rows_are_computed_again_for_a_report(
    results: pathlib.Path,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(migration, "former", lambda _: _Given(revision(results)))
    monkeypatch.setattr(
        "benchmarks.equivalence.rerun_and_compare", lambda store, run: Comparison(run, SAME, SAME)
    )
    place = ["--results", str(results), "--revision", "abc", "--out", str(tmp_path / "report.json")]
    assert migration.main(["compare", *place, "--stored", "hallway/random/*", "*/seed-1"]) == 0
    compared = {one.run for one in equivalence.load(tmp_path / "report.json").comparisons}
    assert compared == {"hallway/ah-ch/seed-1", "hallway/random/clean", "hallway/random/hidden-first-action"}
    assert "hallway/ah-ch/seed-1: identical" in capsys.readouterr().out
    assert migration.main(["compare", *place, "--stored", "tiger/*"]) == 2
    assert "holds no row like tiger/*" in capsys.readouterr().err


@dataclasses.dataclass
class _Given:
    """Gives a revision that is there already."""

    one: Former

    def __enter__(self) -> Former:
        return self.one

    def __exit__(self, *_: object) -> None:
        pass
