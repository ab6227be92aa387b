"""Several stores of one preset read as one: for each domain the longest budget under which most agents were trained.

A domain's cells always come from one budget, so that agents are compared at equal horizons; which budget is a matter of
agents and length alone, never of what came out. A remark names longer runs of fewer agents.
"""

from __future__ import annotations

import json
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import pandas as pd

from benchmarks import evidence
from benchmarks import registry as registries
from benchmarks.evidence import EvidenceError, StoredEvidence
from benchmarks.registry import Registry
from bgn.agents.specs import agent
from bgn.analysis import cells
from bgn.results.run_ids import RunId
from bgn.results.schema import RowKind
from bgn.results.store import Store

if TYPE_CHECKING:
    from bgn.policies.saved import NetworkPolicy

LONGEST = "longest"


@dataclass(frozen=True, eq=False, kw_only=True)
class PooledEvidence(StoredEvidence):
    """Evidence whose domains come from several budgets of one preset."""

    parts: Mapping[str, StoredEvidence]
    """The evidence that each domain was taken from, by domain id."""

    @cached_property
    def curves(self) -> pd.DataFrame:
        """The learning curves of all runs (see :attr:`StoredEvidence.curves`)."""
        frames = [
            part.curves[part.curves["domain"] == domain]
            for domain, part in self.parts.items()
            if len(part.runs)
        ]
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()

    def policy(self, run: str | RunId, *, greedy: bool = True) -> NetworkPolicy:
        """Return the trained policy of a run (see :meth:`StoredEvidence.policy`)."""
        domain = (RunId.parse(run) if isinstance(run, str) else run).cell.domain
        if domain not in self.parts:
            raise EvidenceError(f"no results of {domain}; there are some of {', '.join(self.parts)}")
        return self.parts[domain].policy(run, greedy=greedy)

    def policies(self) -> tuple[str, ...]:
        """Return the ids of the finished runs whose policies are stored."""
        return tuple(
            run
            for domain, part in self.parts.items()
            for run in part.policies()
            if RunId.parse(run).cell.domain == domain
        )

    @property
    def budgets(self) -> Mapping[str, str]:
        """The budget that each domain was taken from."""
        return {domain: part.budget for domain, part in self.parts.items()}


@dataclass(frozen=True, eq=False)
class ResultsFolder:
    """A folder of stores, such as ``results/published``; what all of them hold is read once."""

    path: pathlib.Path
    registry: Registry

    @cached_property
    def overview(self) -> pd.DataFrame:
        """What is stored: columns budget, preset, domain, agents, runs, env_steps.

        One row per budget, preset and domain, in the registry's order; names that it does not know are left out.
        """
        rows = [
            row
            for budget, preset, store in self._stores("runs")
            for row in _described(store.read("runs"), budget, preset)
        ]
        columns = ["budget", "preset", "domain", "agents", "runs", "env_steps"]
        frame = pd.DataFrame(rows, columns=columns)
        order = {domain: i for i, domain in enumerate(self.registry.domains)}
        return frame[frame["domain"].isin(order)].sort_values(
            ["budget", "preset", "domain"],
            key=lambda c: c.map(order) if c.name == "domain" else c,
            kind="stable",
            ignore_index=True,
        )

    @cached_property
    def references(self) -> pd.DataFrame:
        """All stored reference rows: of the present code first, then of the most episodes, then the latest."""
        frames = [
            evidence.reference_rows(self.registry, budget, preset, store)
            for budget, preset, store in self._stores("references")
        ]
        if not frames:
            return pd.DataFrame(columns=["run", "domain"])
        rows = pd.concat(frames, ignore_index=True)
        rows["episodes"] = [int(json.loads(spec)["episodes"]) for spec in rows["spec"]]
        order = {"older": True, "episodes": False, "finished_at": False}
        return rows.sort_values(list(order), ascending=list(order.values()), kind="stable")

    def load(self, *, preset: str | None = None, budget: str | None = None) -> PooledEvidence:
        """Read evidence, as :func:`load` does."""
        if preset is None:
            known = self.registry
            preset = known.defaults.preset if budget in (None, LONGEST) else known.preset_of(budget)
        of_preset = self.overview[self.overview["preset"] == preset]
        chosen = of_preset if budget in (None, LONGEST) else of_preset[of_preset["budget"] == budget]
        if chosen.empty:
            have = sorted({f"{row.budget}/{row.preset}" for row in self.overview.itertuples()})
            raise EvidenceError(
                f"{self.path} holds no runs of {budget or 'any budget'}/{preset}; "
                f"stored: {', '.join(have) or 'nothing'}"
            )
        judged = chosen["budget"] == self.registry.defaults.judged_budget
        ranked = chosen.assign(judged=judged).sort_values(["agents", "env_steps", "runs", "judged"])
        longest = ranked.groupby("domain").last()["budget"]
        parts = {
            b: evidence.load(self.path, budget=b, preset=preset, registry=self.registry)
            for b in dict.fromkeys(longest)
        }
        of_domain = {d: parts[longest[d]] for d in self.registry.domains if d in longest.index}
        return _pool(self.registry, preset, of_domain, self.references, _not_shown(chosen, longest))

    def _stores(self, kind: RowKind) -> Iterator[tuple[str, str, Store]]:
        for budget in self.registry.budgets:
            for preset in self.registry.presets:
                store = Store(self.path / budget / preset)
                if (store.root / kind).is_dir():
                    yield budget, preset, store


def folder(results: str | pathlib.Path, registry: Registry | None = None) -> ResultsFolder:
    """Return a folder of stores; ``registry`` None: the one that is shipped."""
    return ResultsFolder(pathlib.Path(results), registries.load() if registry is None else registry)


def load(
    results: str | pathlib.Path,
    *,
    preset: str | None = None,
    budget: str | None = None,
    registry: Registry | None = None,
) -> PooledEvidence:
    """Read, for each domain, the longest runs of most agents of a preset (or those of one budget).

    Of budgets that are equal in both, as `overnight` and `paper` are in two robot domains, the one with more runs, and
    of equals in that too the one that is judged.

    Raises
    ------
    EvidenceError
        Nothing of the kind is stored; the message names what is.
    """
    return folder(results, registry).load(preset=preset, budget=budget)


def _not_shown(stored: pd.DataFrame, chosen: pd.Series[str]) -> list[str]:
    """Say which runs are longer than a domain's chosen ones, but of fewer agents."""
    remarks = []
    for domain, group in stored.groupby("domain", sort=False):
        steps = group.set_index("budget")["env_steps"]
        for row in group[group["env_steps"] > steps[chosen[domain]]].itertuples():
            agents = f"{row.agents} agent" + ("s" if row.agents > 1 else "")
            remarks.append(
                f"Not shown: {row.runs} longer runs of {agents} in {domain}, {row.env_steps / 1e6:g} M steps: "
                f"`--budget {row.budget}`."
            )
    return remarks


def _pool(
    registry: Registry,
    preset: str,
    parts: Mapping[str, StoredEvidence],
    references: pd.DataFrame,
    not_shown: Sequence[str],
) -> PooledEvidence:
    runs = pd.concat([_of_domain(part.runs, domain) for domain, part in parts.items()], ignore_index=True)
    chosen = [_references(domain, part, references) for domain, part in parts.items()]
    rows = [evidence.domain_row(registry, domain) for domain in parts]
    names = sorted({part.budget for part in parts.values()}, key=list(registry.budgets).index)
    remarks = [remark for part in {id(p): p for p in parts.values()}.values() for remark in part.remarks]
    first = next(iter(parts.values()))
    return PooledEvidence(
        cells=cells.summarise(runs, rows, registry.agents),
        runs=runs,
        references=pd.concat(chosen, ignore_index=True),
        domains=rows,
        agent_titles={name: agent(name).title for name in registry.agents},
        reference_titles={name: entry.title for name, entry in registry.references.items()},
        remarks=[*remarks, *not_shown],
        budget=" and ".join(names),
        preset=preset,
        store=first.store,
        parts=parts,
    )


def _of_domain(frame: pd.DataFrame, domain: str) -> pd.DataFrame:
    return frame[frame["domain"] == domain]


def _references(domain: str, own: StoredEvidence, stored: pd.DataFrame) -> pd.DataFrame:
    """Return a domain's reference rows: its own budget's, and for what that lacks the best of all that are stored.

    They are not trained and know no preset, so that what a budget decides of them is only how exactly they are known.
    """
    rows = pd.concat([_of_domain(own.references, domain), _of_domain(stored, domain)])
    return rows.drop_duplicates("run").drop(columns="episodes", errors="ignore")


def _described(runs: pd.DataFrame, budget: str, preset: str) -> list[list[object]]:
    if runs.empty:
        return []
    finished = runs[runs["status"] == "ok"]
    rows: list[list[object]] = []
    for domain, group in finished.groupby("domain"):
        steps = max(int(json.loads(spec)["env_steps"]) for spec in group["spec"])
        rows.append([budget, preset, domain, group["agent"].nunique(), len(group), steps])
    return rows
