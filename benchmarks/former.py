"""What a former revision of the project says about stored results: which it asks for, and by what code they came."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from benchmarks import retraining
from benchmarks.retraining import Fingerprint
from benchmarks.revisions import ROOT, checked_out, resolve
from bgn.domains.domain import Domain
from bgn.errors import BgnError
from bgn.results import data
from bgn.results.code import CodeTree, Scope
from bgn.results.data import unseen_fields
from bgn.results.provenance import Origin
from bgn.results.sources import CodeError

#: Where parts of a scope stood before they were moved.
FORMER_PATHS: Mapping[str, Sequence[str]] = {
    "bgn.domains.layout": ["bgn.domains._layout"],
    "bgn.policies.saved:describe": ["bgn.agents.policy:describe"],
    "bgn.training.physics_evaluation:evaluate_policy": ["bgn.training.trainer:_Stack._in_physics"],
}
#: What is gone and, like what a scope leaves out, no part of a result.
FORMER_STRANGERS = ("bgn._gymnasium",)  # named the domains to Gymnasium whenever `bgn` was imported

_ASK = """
import importlib.util, json, sys
from benchmarks import registry
from benchmarks.plan import Selection
from bgn import domains

question = json.load(sys.stdin)
loaded = importlib.util.spec_from_file_location("present_data", question["data"])
present = importlib.util.module_from_spec(loaded)
loaded.loader.exec_module(present)
known = registry.load()
chosen = [name for name in known.domains if name in question["domains"]]
wanted = {}
for budget, preset, seeds in question["stores"]:
    if budget in known.budgets and preset in known.presets:
        everything = Selection(
            registry=known, budget=budget, preset=preset, domains=tuple(chosen),
            agents=tuple(known.agents), references=tuple(known.references), seeds=tuple(seeds),
        )
        requests = (getattr(everything, "wanted", None) or everything.requests)()
        rows = {f"{one.kind} {getattr(one, 'id', None) or one.run}": one.origin for one in requests}
        wanted[f"{budget}/{preset}"] = {row: [one.spec, one.code, one.data] for row, one in rows.items()}
tables = {name: present.data_hash(domains.get(name), unseen=question["unseen"]) for name in chosen}
print(json.dumps({"wanted": wanted, "tables": tables}))
"""


class FormerError(BgnError, RuntimeError):
    """A former revision cannot be asked; the message says why."""


@dataclass(frozen=True)
class Answers:
    """What a revision says about some stores."""

    wanted: Mapping[str, Mapping[str, Origin]]
    """By store (``laptop/calibrated``) and then by row (``runs hallway/ah-ch/seed-0``): what it asks for."""
    tables: Mapping[str, str]
    """The present data hash of its domains."""


@dataclass(frozen=True)
class Former:
    """The files of a revision."""

    commit: str
    root: pathlib.Path

    def code_hash(self, scope: Scope) -> str:
        """Hash the revision's code as the present one is hashed."""
        tree = CodeTree(self.root)
        there = {path: self._path(tree, path) for path in (*scope.entries, *scope.data)}
        strangers = tuple(path for path in FORMER_STRANGERS if tree.sources.module(path))
        without = (
            self._stood(tree, path) for path in scope.without
        )  # what was not there yet leaves out nothing
        return tree.hash(
            replace(
                scope,
                entries=tuple(there[path] for path in scope.entries),
                without=(*filter(None, without), *strangers),
                data=tuple(there[path] for path in scope.data),
            )
        )

    def ask(self, stores: Collection[tuple[str, str, Sequence[int]]], domains: Collection[str]) -> Answers:
        """Ask the revision's own code which rows of some domains it wants in stores: (budget, preset, seeds)."""
        question = {"data": data.__file__, "unseen": unseen_fields(Domain), "stores": list(stores)}
        question["domains"] = list(domains)
        answer = self._run(["-c", _ASK], question)
        wanted = {
            store: {row: Origin(*parts) for row, parts in rows.items()}
            for store, rows in answer["wanted"].items()
        }
        return Answers(wanted, answer["tables"])

    def retrain(
        self, cells: Sequence[str], budget: str, preset: str, seeds: Sequence[int]
    ) -> dict[str, Fingerprint]:
        """Train cells with the revision's code; returns the fingerprints by run."""
        question = {"cells": list(cells), "budget": budget, "preset": preset, "seeds": list(seeds)}
        return {run: Fingerprint(**one) for run, one in self._run([retraining.__file__], question).items()}

    def _path(self, tree: CodeTree, path: str) -> str:
        """Return where a part of a scope stands in the revision."""
        found = self._stood(tree, path)
        if found is None:
            raise FormerError(
                f"{self.commit[:10]} has no {path}; say in FORMER_PATHS ({__name__}) where it stood"
            )
        return found

    @staticmethod
    def _stood(tree: CodeTree, path: str) -> str | None:
        for candidate in (path, *FORMER_PATHS.get(path, ())):
            with contextlib.suppress(CodeError):
                tree.sources.find(candidate)
                return candidate
        return None

    def _run(self, arguments: Sequence[str], question: Mapping[str, Any]) -> Any:
        environment = {**os.environ, "PYTHONPATH": str(self.root), "PYTHONSAFEPATH": "1"}
        done = subprocess.run(
            [sys.executable, *arguments],
            input=json.dumps(question),
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            cwd=self.root,
        )
        if done.returncode:
            raise FormerError(f"the code of {self.commit[:10]} fails: {done.stderr.strip().splitlines()[-1]}")
        return json.loads(done.stdout.strip().splitlines()[-1])


@contextlib.contextmanager
def former(revision: str, root: pathlib.Path = ROOT) -> Iterator[Former]:
    """Give a revision's files for a while.

    Raises
    ------
    benchmarks.revisions.RevisionError
        There is no such revision.
    """
    commit = resolve(revision, root)
    with checked_out(commit, root) as folder:
        yield Former(commit, folder)
