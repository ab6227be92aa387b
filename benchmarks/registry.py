"""Reads ``registry.toml`` and checks it; every name and number of the benchmark is looked up here."""

from __future__ import annotations

import dataclasses
import pathlib
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, model_validator

from bgn.agents.hyperparameters import Hyperparameters
from bgn.errors import BgnError
from bgn.training.cell import CellSpec

DEFAULT_PATH = pathlib.Path(__file__).with_name("registry.toml")

Metric = Literal["greedy_return", "sampled_return", "train_return", "train_success", "sampled_success"]

_HYPERPARAMETER_NAMES = tuple(field.name for field in dataclasses.fields(Hyperparameters))


class RegistryError(BgnError, ValueError):
    """The registry (or a name looked up in it) is wrong; the message says where and what is known."""


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


_FIELDS: dict[str, Any] = {name: (hint, ...) for name, hint in get_type_hints(Hyperparameters).items()}
_CheckedHyperparameters = create_model("_CheckedHyperparameters", __base__=_Entry, **_FIELDS)


class DomainEntry(_Entry):
    """How the benchmark treats one domain."""

    metric: Metric
    """Column of ``runs`` that is judged against the paper."""
    authors_metric: Literal["first_100_return"] | None = None
    """Column that measures as the authors did, where that is another one (see benchmarks.authors_evaluation)."""
    tolerance: float = Field(gt=0)
    """δ of the equivalence test, in the metric's own unit."""
    cost: float = Field(gt=0)
    """Seconds per environment step relative to the other domains."""
    physics: bool = False
    """Whether final policies are also run in MuJoCo physics."""


class AgentEntry(_Entry):
    """How the benchmark treats one agent."""

    cost: float = Field(gt=0)
    """Seconds per environment step relative to the other agents."""


class ReferenceEntry(_Entry):
    """A policy that is not trained, and the domains it is evaluated on."""

    title: str
    domains: tuple[str, ...] = Field(strict=False)


class Budget(_Entry):
    """How long to train, how many seeds, how thoroughly to evaluate."""

    description: str
    seeds: int = Field(ge=1)
    evaluation_episodes: int = Field(ge=2)
    physics_episodes: int = Field(ge=0)
    reference_episodes: int = Field(ge=2)
    planning_seconds: float = Field(gt=0)
    env_steps: dict[str, int]
    """Environment steps of a run, by domain id."""


class Preset(_Entry):
    """One reading of the paper's settings: hyperparameters for all domains, and each domain's own."""

    description: str
    extends: str | None = None
    """Another preset whose values hold where this one says nothing."""
    all: dict[str, Any]
    domains: dict[str, dict[str, Any]] = {}

    def hyperparameters(self, domain: str) -> Hyperparameters:
        """Return the settings of every agent on ``domain``."""
        checked = _CheckedHyperparameters.model_validate(self.all | self.domains.get(domain, {}))
        return Hyperparameters(**checked.model_dump())


class Defaults(_Entry):
    """What the command line runs when nothing is named."""

    budget: str
    preset: str
    judged_budget: str
    """The budget with the paper's horizons: shorter runs get no verdict."""


class Registry(_Entry):
    """The whole of ``registry.toml``."""

    defaults: Defaults
    domains: dict[str, DomainEntry]
    agents: dict[str, AgentEntry]
    references: dict[str, ReferenceEntry]
    budgets: dict[str, Budget]
    presets: dict[str, Preset]

    @model_validator(mode="before")
    @classmethod
    def _inherit(cls, data: dict[str, Any]) -> dict[str, Any]:
        presets = data.get("presets", {})
        return {**data, "presets": {name: _inherited(name, presets) for name in presets}}

    @model_validator(mode="after")
    def _names_agree(self) -> Registry:
        _known("defaults.budget", [self.defaults.budget], self.budgets)
        _known("defaults.preset", [self.defaults.preset], self.presets)
        _known("defaults.judged_budget", [self.defaults.judged_budget], self.budgets)
        for name, reference in self.references.items():
            _known(f"references.{name}.domains", reference.domains, self.domains)
            _unique(f"references.{name}.domains", reference.domains)
        for name, budget in self.budgets.items():
            where = f"budgets.{name}.env_steps"
            _known(where, budget.env_steps, self.domains)
            _complete(where, budget.env_steps, self.domains)
            for domain, steps in budget.env_steps.items():
                _require(steps >= 1, f"{where}.{domain} is {steps}; a run needs at least 1 step")
        for name, preset in self.presets.items():
            _check_preset(f"presets.{name}", preset, self.domains)
        return self

    def cell(self, domain: str, agent: str, *, budget: str, preset: str) -> CellSpec:
        """Return the specification of one cell.

        Raises
        ------
        RegistryError
            A name is not in the registry; the message lists the known ones.
        """
        self.select("domain", [domain])
        self.select("agent", [agent])
        chosen = self.budget(budget)
        self.select("preset", [preset])
        return CellSpec(
            domain=domain,
            agent=agent,
            hyperparameters=self.presets[preset].hyperparameters(domain),
            env_steps=chosen.env_steps[domain],
            evaluation_episodes=chosen.evaluation_episodes,
            physics_episodes=chosen.physics_episodes if self.domains[domain].physics else 0,
        )

    def applies(self, reference: str, domain: str) -> bool:
        """Say whether a reference policy is evaluated on a domain."""
        return domain in self.references[reference].domains

    def budget(self, name: str) -> Budget:
        """Return the budget of that name, or raise :class:`RegistryError`."""
        self.select("budget", [name])
        return self.budgets[name]

    def select(
        self, kind: Literal["domain", "agent", "reference", "budget", "preset"], names: Iterable[str] | None
    ) -> tuple[str, ...]:
        """Return ``names`` in registry order (``None``: all of that kind); unknown ones raise."""
        known: Mapping[str, object] = getattr(self, kind + "s")
        if names is None:
            return tuple(known)
        wanted = set(names)
        for name in sorted(wanted - set(known)):
            raise RegistryError(f"unknown {kind} {name!r}; known: {', '.join(known)}")
        return tuple(name for name in known if name in wanted)


def load(path: pathlib.Path = DEFAULT_PATH) -> Registry:
    """Read and check a registry file.

    Raises
    ------
    RegistryError
        The file is missing, is not TOML (duplicate ids included), or a key or value is wrong; the message
        names the file, the key and what would be right.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RegistryError(f"{path}: cannot read the registry: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise RegistryError(f"{path}: not valid TOML: {error}") from error
    try:
        return Registry.model_validate(data)
    except ValidationError as error:
        raise RegistryError(f"{path}: {_explain(error)}") from error


def _explain(error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        key = ".".join(str(part) for part in problem["loc"])
        message = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            message = "unknown key"
        lines.append(f"{key}: {message}" if key else message)
    return "; ".join(lines)


def _check_preset(where: str, preset: Preset, domains: Mapping[str, object]) -> None:
    _known(f"{where}.domains", preset.domains, domains)
    _known(f"{where}.all", preset.all, _HYPERPARAMETER_NAMES)
    _complete(f"{where}.all", preset.all, _HYPERPARAMETER_NAMES)
    for domain, overrides in preset.domains.items():
        _known(f"{where}.domains.{domain}", overrides, _HYPERPARAMETER_NAMES)
    for domain in domains:
        try:
            preset.hyperparameters(domain)
        except ValidationError as error:
            raise ValueError(f"{where} for {domain}: {_explain(error)}") from error


def _inherited(name: str, presets: Mapping[str, Any], heirs: tuple[str, ...] = ()) -> Any:
    """Fill a preset's table up from the one it extends."""
    preset = presets[name]
    base_name = preset.get("extends") if isinstance(preset, dict) else None
    if base_name is None:
        return preset
    _known(f"presets.{name}.extends", [base_name], presets)
    _require(base_name not in (*heirs, name), f"presets.{name}.extends: {base_name!r} extends it in turn")
    base = _inherited(base_name, presets, (*heirs, name))
    ours, theirs = preset.get("domains", {}), base.get("domains", {})
    domains = {d: {**theirs.get(d, {}), **ours.get(d, {})} for d in (*theirs, *ours)}
    return {**preset, "all": {**base.get("all", {}), **preset.get("all", {})}, "domains": domains}


def _known(where: str, names: Iterable[str], known: Iterable[str]) -> None:
    known = tuple(known)
    for name in names:
        _require(name in known, f"{where}: unknown {name!r}; known: {', '.join(known)}")


def _unique(where: str, names: Iterable[str]) -> None:
    names = tuple(names)
    for name in names:
        _require(names.count(name) == 1, f"{where}: {name!r} is listed more than once")


def _complete(where: str, names: Iterable[str], needed: Iterable[str]) -> None:
    missing = [name for name in needed if name not in names]
    _require(not missing, f"{where}: missing {', '.join(missing)}")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)
