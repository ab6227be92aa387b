"""What is asked for, what of it is stored, and what is left to do."""

from __future__ import annotations

import enum
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from benchmarks.registry import Registry
from benchmarks.tasks import CellTask, PhysicsTask, ReferenceSpec, ReferenceTask, Task
from bgn import domains
from bgn.domains import Domain, from_file
from bgn.domains.episode_opening import CLEAN, HIDDEN, EpisodeOpening
from bgn.results import provenance
from bgn.results.provenance import Origin
from bgn.results.run_ids import CellId, ReferenceId, RunId
from bgn.results.schema import OUTCOME
from bgn.results.store import Kind, Store
from bgn.training.cell import CellSpec

_REFERENCE_SEED = 0
_STEPS_PER_BACKUP = 3.0  # to compare a planner's work with training, roughly


class State(enum.Enum):
    """How far a request is."""

    CURRENT = "done"
    INCOMPLETE = "incomplete"
    """There is a result, which lacks what this machine may be able to add."""
    STALE = "older"
    """There is a result, but of other code, settings or domain tables."""
    FAILED = "failed"
    MISSING = "missing"


@dataclass(frozen=True)
class Request:
    """One run or reference row that was asked for."""

    kind: Kind
    id: RunId | ReferenceId
    spec: CellSpec | ReferenceSpec
    seed: int
    origin: Origin

    @property
    def run(self) -> str:
        """The id as the store's rows have it."""
        return str(self.id)


@dataclass(frozen=True)
class Status:
    """The state of a request, and why it is not current."""

    request: Request
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

    def env_steps(self) -> int:
        """Return how many steps one run of every cell takes together."""
        steps = self.registry.budget(self.budget).env_steps
        return len(self.agents) * sum(steps.get(domain, 0) for domain in self.domains)

    def requests(self) -> list[Request]:
        """Return every run and reference row of the selection, but for domains that the budget leaves out.

        Raises
        ------
        bgn.domains.UnknownDomainError
            No module builds a domain that the registry names.
        """
        return [
            request for domain in self.domains for request in (*self._runs(domain), *self._references(domain))
        ]

    def tasks(self, requests: Sequence[Request], store: Store, device: str) -> list[Task]:
        """Return the tasks that answer the requests, a cell's seeds stacked, the longest tasks first."""
        stacks: dict[CellId | ReferenceId, list[Request]] = {}
        for request in requests:
            stacks.setdefault(request.id.cell if isinstance(request.id, RunId) else request.id, []).append(
                request
            )
        tasks = [self._task(members, store, device) for members in stacks.values()]
        return sorted(tasks, key=lambda task: -task.cost)

    def physics_tasks(self, requests: Sequence[Request], store: Store) -> list[Task]:
        """Return the tasks that fill in the physics of incomplete rows, the seeds of a cell in one."""
        stacked = self.tasks(requests, store, "cpu")
        return [
            PhysicsTask(
                origin=task.origin,
                budget=task.budget,
                preset=task.preset,
                store=task.store,
                cost=float(task.spec.physics_episodes * len(task.seeds)),
                declared=task.declared,
                spec=task.spec,
                seeds=task.seeds,
            )
            for task in stacked
            if isinstance(task, CellTask)
        ]

    def _runs(self, domain: str) -> Iterator[Request]:
        data = provenance.data_hash(domains.get(domain))
        for agent in self.agents:
            spec = self.registry.cell(domain, agent, budget=self.budget, preset=self.preset)
            in_physics = spec.physics_episodes > 0
            code = provenance.code_hash(
                provenance.TRAINING_WITH_PHYSICS if in_physics else provenance.TRAINING
            )
            origin = Origin(provenance.spec_hash(spec), code, data)
            for seed in self.seeds:
                yield Request("runs", RunId.of(domain, agent, seed), spec, seed, origin)

    def _references(self, domain: str) -> Iterator[Request]:
        data = provenance.data_hash(domains.get(domain))
        code = provenance.code_hash(provenance.PLANNING)
        budget = self.registry.budget(self.budget)
        for reference in self.references:
            for convention in (
                conventions(domains.get(domain)) if self.registry.applies(reference, domain) else ()
            ):
                spec = ReferenceSpec(
                    domain=domain,
                    reference=reference,
                    convention=convention,
                    episodes=budget.reference_episodes,
                    planning_backups=budget.planning_backups,
                    planning_seconds=budget.planning_seconds,
                    seed=_REFERENCE_SEED,
                )
                origin = Origin(provenance.spec_hash(spec), code, data)
                yield Request("references", spec.id, spec, spec.seed, origin)

    def _task(self, members: Sequence[Request], store: Store, device: str) -> Task:
        spec = members[0].spec
        origin = members[0].origin
        if isinstance(spec, ReferenceSpec):
            cost = spec.planning_backups * _STEPS_PER_BACKUP
            return ReferenceTask(
                origin=origin,
                budget=self.budget,
                preset=self.preset,
                store=store.root,
                cost=cost,
                declared=from_file.declaration(spec.domain),
                spec=spec,
            )
        weight = self.registry.domains[spec.domain].cost * self.registry.agents[spec.agent].cost
        return CellTask(
            origin=origin,
            budget=self.budget,
            preset=self.preset,
            store=store.root,
            cost=spec.env_steps * len(members) * weight,
            declared=from_file.declaration(spec.domain),
            spec=spec,
            seeds=tuple(request.seed for request in members),
            device=device,
        )


def conventions(domain: Domain) -> tuple[EpisodeOpening, ...]:
    """Return how episodes of a domain may open."""
    return (CLEAN, HIDDEN) if domain.hidden_first_action else (CLEAN,)


def opening(domain: Domain) -> EpisodeOpening:
    """Return how the episodes of agents open."""
    return conventions(domain)[-1]


def statuses(requests: Sequence[Request], store: Store) -> list[Status]:
    """Compare what is asked for with what is stored."""
    found = {kind: _by_run(store.read(kind)) for kind in ("runs", "references")}
    return [_status(request, found[request.kind].get(request.run, [])) for request in requests]


def to_compute(found: Sequence[Status]) -> list[Request]:
    """Return the requests that nothing stored answers, not even in part."""
    return [status.request for status in found if status.state not in (State.CURRENT, State.INCOMPLETE)]


def _by_run(rows: pd.DataFrame) -> dict[str, list[Mapping[str, str]]]:
    if rows.empty:
        return {}
    columns = ["run", *OUTCOME, "key", "spec_hash", "code_hash", "data_hash"]
    rows = rows.assign(**{name: None for name in OUTCOME if name not in rows})  # rows of older versions
    grouped: dict[str, list[Mapping[str, str]]] = {}
    for row in rows[columns].to_dict("records"):
        grouped.setdefault(row["run"], []).append({str(name): value for name, value in row.items()})
    return grouped


def _status(request: Request, rows: Sequence[Mapping[str, str]]) -> Status:
    current = [row for row in rows if row["key"] == request.origin.key]
    for row in current:
        if row["status"] == "ok":
            missing = row["missing"]
            incomplete = isinstance(missing, str)  # pandas knows several kinds of nothing
            return (
                Status(request, State.INCOMPLETE, missing) if incomplete else Status(request, State.CURRENT)
            )
    if current:
        return Status(request, State.FAILED, current[0]["error"], current[0]["traceback"])
    for row in rows:
        if row["status"] == "ok":
            return Status(request, State.STALE, _difference(request.origin, row))
    return Status(request, State.MISSING)


def _difference(origin: Origin, row: Mapping[str, str]) -> str:
    reasons = {
        "other settings": origin.spec != row["spec_hash"],
        "older code": origin.code != row["code_hash"],
        "other domain tables": origin.data != row["data_hash"],
    }
    return ", ".join(reason for reason, differs in reasons.items() if differs)
