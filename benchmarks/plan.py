"""What is asked for, what of it is stored, and what is left to do."""

from __future__ import annotations

import enum
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from benchmarks.registry import Registry
from benchmarks.tasks import CellTask, ReferenceSpec, ReferenceTask, Task
from bgn import domains
from bgn.results import provenance
from bgn.results.provenance import Origin
from bgn.results.schema import CLEAN, HIDDEN, Convention
from bgn.results.store import Kind, Store
from bgn.training.cell import CellSpec

_REFERENCE_SEED = 0
_STEPS_PER_PLANNING_SECOND = 3000.0  # to compare a planner's time with training, roughly


class State(enum.Enum):
    """How far a wanted run is."""

    CURRENT = "done"
    STALE = "older"
    """There is a result, but of other code, settings or domain tables."""
    FAILED = "failed"
    MISSING = "missing"


@dataclass(frozen=True)
class Wanted:
    """One run or reference row that was asked for."""

    kind: Kind
    run: str
    spec: CellSpec | ReferenceSpec
    seed: int
    origin: Origin


@dataclass(frozen=True)
class Status:
    """The state of a wanted run, and why it is not current."""

    wanted: Wanted
    state: State
    detail: str = ""
    traceback: str = ""


@dataclass(frozen=True)
class Selection:
    """What the command line asks for, checked against the registry."""

    registry: Registry
    budget: str
    preset: str
    domains: tuple[str, ...]
    agents: tuple[str, ...]
    references: tuple[str, ...]
    seeds: tuple[int, ...]

    def store(self, results: pathlib.Path) -> Store:
        """Return the store of this budget and preset under a results folder."""
        return Store(results / self.budget / self.preset)

    def current_keys(self) -> set[str]:
        """Return the content keys of everything the registry holds for this budget and preset."""
        registry = self.registry
        everything = replace(
            self,
            domains=tuple(registry.domains),
            agents=tuple(registry.agents),
            references=tuple(registry.references),
            seeds=(0,),
        )
        return {one.origin.key for one in everything.wanted()}

    def wanted(self) -> list[Wanted]:
        """Return every run and reference row of the selection, in registry order.

        Raises
        ------
        bgn.domains.UnknownDomainError
            No module builds a domain that the registry names.
        """
        return [one for domain in self.domains for one in (*self._runs(domain), *self._references(domain))]

    def tasks(self, wanted: Sequence[Wanted], store: Store, device: str) -> list[Task]:
        """Return the tasks that yield the wanted runs, a cell's seeds stacked, the longest tasks first."""
        cells: dict[str, list[Wanted]] = {}
        for one in wanted:
            cells.setdefault(one.run.rpartition("/")[0] if one.kind == "runs" else one.run, []).append(one)
        tasks = [self._task(members, store, device) for members in cells.values()]
        return sorted(tasks, key=lambda task: -task.cost)

    def _runs(self, domain: str) -> Iterator[Wanted]:
        data = provenance.data_hash(domains.get(domain))
        for agent in self.agents:
            spec = self.registry.cell(domain, agent, budget=self.budget, preset=self.preset)
            in_physics = spec.physics_episodes > 0
            code = provenance.code_hash(
                provenance.TRAINING_WITH_PHYSICS if in_physics else provenance.TRAINING
            )
            origin = Origin(provenance.spec_hash(spec), code, data)
            for seed in self.seeds:
                yield Wanted("runs", f"{domain}/{agent}/seed-{seed}", spec, seed, origin)

    def _references(self, domain: str) -> Iterator[Wanted]:
        data = provenance.data_hash(domains.get(domain))
        code = provenance.code_hash(provenance.PLANNING)
        budget = self.registry.budget(self.budget)
        for reference in self.references:
            for convention in conventions(domain) if self.registry.applies(reference, domain) else ():
                spec = ReferenceSpec(
                    domain=domain,
                    reference=reference,
                    convention=convention,
                    episodes=budget.reference_episodes,
                    planning_seconds=budget.planning_seconds,
                    seed=_REFERENCE_SEED,
                )
                run = f"{domain}/{reference}/{convention}"
                yield Wanted(
                    "references", run, spec, spec.seed, Origin(provenance.spec_hash(spec), code, data)
                )

    def _task(self, members: Sequence[Wanted], store: Store, device: str) -> Task:
        spec = members[0].spec
        origin = members[0].origin
        if isinstance(spec, ReferenceSpec):
            cost = spec.planning_seconds * _STEPS_PER_PLANNING_SECOND
            return ReferenceTask(
                origin=origin,
                budget=self.budget,
                preset=self.preset,
                store=store.root,
                cost=cost,
                spec=spec,
            )
        weight = self.registry.domains[spec.domain].cost * self.registry.agents[spec.agent].cost
        return CellTask(
            origin=origin,
            budget=self.budget,
            preset=self.preset,
            store=store.root,
            cost=spec.env_steps * len(members) * weight,
            spec=spec,
            seeds=tuple(one.seed for one in members),
            device=device,
        )


def conventions(domain: str) -> tuple[Convention, ...]:
    """Return how episodes of a domain may open."""
    return (CLEAN, HIDDEN) if domains.get(domain).hidden_first_action else (CLEAN,)


def statuses(wanted: Sequence[Wanted], store: Store) -> list[Status]:
    """Compare what is wanted with what is stored."""
    found = {kind: _by_run(store.read(kind)) for kind in ("runs", "references")}
    return [_status(one, found[one.kind].get(one.run, [])) for one in wanted]


def _by_run(rows: pd.DataFrame) -> dict[str, list[Mapping[str, str]]]:
    if rows.empty:
        return {}
    columns = ["run", "status", "error", "traceback", "key", "spec_hash", "code_hash", "data_hash"]
    grouped: dict[str, list[Mapping[str, str]]] = {}
    for row in rows[columns].to_dict("records"):
        grouped.setdefault(row["run"], []).append({str(name): value for name, value in row.items()})
    return grouped


def _status(wanted: Wanted, rows: Sequence[Mapping[str, str]]) -> Status:
    current = [row for row in rows if row["key"] == wanted.origin.key]
    if any(row["status"] == "ok" for row in current):
        return Status(wanted, State.CURRENT)
    if current:
        return Status(wanted, State.FAILED, current[0]["error"], current[0]["traceback"])
    for row in rows:
        if row["status"] == "ok":
            return Status(wanted, State.STALE, _difference(wanted.origin, row))
    return Status(wanted, State.MISSING)


def _difference(origin: Origin, row: Mapping[str, str]) -> str:
    reasons = {
        "other settings": origin.spec != row["spec_hash"],
        "older code": origin.code != row["code_hash"],
        "other domain tables": origin.data != row["data_hash"],
    }
    return ", ".join(reason for reason, differs in reasons.items() if differs)
