"""Reads a registry and checks it; every name and number of the benchmark is looked up here.

The one that is shipped is ``registry.toml``. Another either stands alone or begins with ``extends = "shipped"``:
then it holds only what it adds or changes, key by key.
"""

from __future__ import annotations

import dataclasses
import pathlib
import tomllib
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    create_model,
    model_validator,
)

from bgn import domains
from bgn.agents import specs
from bgn.agents.hyperparameters import Hyperparameters
from bgn.domains import from_file
from bgn.domains.from_file import FileDomain
from bgn.errors import BgnError
from bgn.results.run_ids import check_name
from bgn.training.cell import CellSpec

DEFAULT_PATH = pathlib.Path(__file__).with_name("registry.toml")
SHIPPED = "shipped"
"""What another registry extends."""

Metric = Literal["greedy_return", "sampled_return", "train_return", "train_success", "sampled_success"]

_HYPERPARAMETER_NAMES = tuple(field.name for field in dataclasses.fields(Hyperparameters))


class RegistryError(BgnError, ValueError):
    """The registry (or a name looked up in it) is wrong; the message says where and what is known."""


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


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
    cost: float = Field(default=1.0, gt=0)
    """Seconds per environment step relative to the other domains."""
    physics: bool = False
    """Whether final policies are also run in MuJoCo physics."""
    references: tuple[str, ...] = Field(default=(), strict=False)
    """The policies that are not trained, to be evaluated on it."""


class FileDomainEntry(DomainEntry):
    """A domain that a .pomdp file defines, instead of a module of :mod:`bgn.domains`."""

    file: str
    """The .pomdp file, relative to the registry's."""
    title: str | None = None
    """What tables call it; None: its id."""
    episode_limit: int = Field(ge=1)
    """Steps after which an episode is cut."""
    training_discount: float | None = Field(default=None, gt=0, le=1)
    """γ of the returns that agents are trained on; None: the file's."""
    report_discount: float | None = Field(default=None, gt=0, le=1)
    """γ of the returns that tables report; None: the file's."""
    hidden_first_action: bool = False
    """Whether episodes of agents open with an unseen, uniformly random action."""


def _kind_of_domain(entry: object) -> str:
    from_file = "file" in entry if isinstance(entry, dict) else isinstance(entry, FileDomainEntry)
    return _FILE if from_file else _MODULE


_FILE, _MODULE = "<file>", "<module>"  # in angle brackets: pydantic puts them into an error's place
_AnyDomainEntry = Annotated[
    Annotated[FileDomainEntry, Tag(_FILE)] | Annotated[DomainEntry, Tag(_MODULE)],
    Discriminator(_kind_of_domain),
]


class AgentEntry(_Entry):
    """How the benchmark treats one agent of :mod:`bgn.agents.specs`."""

    cost: float = Field(default=1.0, gt=0)
    """Seconds per environment step relative to the other agents."""


class ReferenceEntry(_Entry):
    """A policy that is not trained (:mod:`bgn.planning.reference_rows`)."""

    title: str


class Budget(_Entry):
    """How long to train, how many seeds, how thoroughly to evaluate."""

    description: str
    preset: str | None = None
    """What it is run under where no preset is named; None: the registry's default."""
    seeds: int = Field(ge=1, le=10_000)
    evaluation_episodes: int = Field(ge=2)
    physics_episodes: int = Field(ge=0)
    reference_episodes: int = Field(ge=2)
    planning_backups: int = Field(ge=1)
    """Work of one solve."""
    planning_seconds: float = Field(gt=0)
    """CPU time after which a solve is cut off all the same."""
    env_steps: dict[str, int]
    """Environment steps of a run, by domain id; a domain that is left out is not part of the budget."""


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
    judged_budget: str | None = None
    """The budget with the paper's horizons: shorter runs get no verdict."""


class Registry(_Entry):
    """A whole registry."""

    defaults: Defaults
    domains: dict[str, _AnyDomainEntry]
    agents: dict[str, AgentEntry]
    references: dict[str, ReferenceEntry]
    budgets: dict[str, Budget]
    presets: dict[str, Preset]

    @model_validator(mode="before")
    @classmethod
    def _inherit(cls, data: dict[str, Any]) -> dict[str, Any]:
        presets = data.get("presets", {})
        _require(isinstance(presets, dict), "presets: expected a table of presets")
        return {**data, "presets": {name: _inherited(name, presets) for name in presets}}

    @model_validator(mode="after")
    def _names_agree(self) -> Registry:
        _known("defaults.budget", [self.defaults.budget], self.budgets)
        _known("defaults.preset", [self.defaults.preset], self.presets)
        if self.defaults.judged_budget is not None:
            _known("defaults.judged_budget", [self.defaults.judged_budget], self.budgets)
        for kind in ("domains", "agents", "references"):
            for name in getattr(self, kind):
                check_name(name)
        built = [name for name, entry in self.domains.items() if not isinstance(entry, FileDomainEntry)]
        _known("domains", built, domains.ids(), "give a new one its `file`, or a module in bgn/domains")
        _known("agents", self.agents, specs.AGENTS, "a new one is declared in bgn/agents/specs.py")
        for name, entry in self.domains.items():
            _known(f"domains.{name}.references", entry.references, self.references)
            _unique(f"domains.{name}.references", entry.references)
        for name, budget in self.budgets.items():
            if budget.preset is not None:
                _known(f"budgets.{name}.preset", [budget.preset], self.presets)
            where = f"budgets.{name}.env_steps"
            _known(where, budget.env_steps, self.domains)
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
            A name is not in the registry, or the domain not in the budget; the message lists the known ones.
        """
        self.select_domains([domain], budget=budget)
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

    def horizon(self, domain: str) -> int:
        """Return the environment steps that a run needs to be judged against the paper (0: any run is)."""
        judged = self.defaults.judged_budget
        return 0 if judged is None else self.budgets[judged].env_steps.get(domain, 0)

    def applies(self, reference: str, domain: str) -> bool:
        """Say whether a reference policy is evaluated on a domain."""
        return reference in self.domains[domain].references

    def budget(self, name: str) -> Budget:
        """Return the budget of that name, or raise :class:`RegistryError`."""
        self.select("budget", [name])
        return self.budgets[name]

    def preset_of(self, budget: str) -> str:
        """Return the preset that a budget is run under where none is named; unknown budgets raise."""
        return self.budget(budget).preset or self.defaults.preset

    def select_domains(self, names: Iterable[str] | None, *, budget: str) -> tuple[str, ...]:
        """Return ``names`` in registry order (``None``: all that are part of the budget).

        Raises
        ------
        RegistryError
            A name is not in the registry, or not part of the budget.
        """
        steps = self.budget(budget).env_steps
        if names is None:
            return tuple(name for name in self.domains if name in steps)
        chosen = self.select("domain", names)
        for name in chosen:
            if name not in steps:
                raise RegistryError(
                    f"budget {budget!r} does not include domain {name!r}; give it steps, "
                    f"budgets.{budget}.env_steps.{name}, or choose of {', '.join(steps)}"
                )
        return chosen

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


def load(path: str | pathlib.Path = DEFAULT_PATH) -> Registry:
    """Read and check a registry file; domains from files become known to :func:`bgn.domains.get`.

    Raises
    ------
    RegistryError
        The file is missing, is not TOML (duplicate ids included), or a key or value is wrong, a domain's file
        too; the message names the file, the key and what would be right.
    """
    path = pathlib.Path(path)
    data = _read(path)
    try:
        registry = Registry.model_validate(data)
    except ValidationError as error:
        raise RegistryError(f"{path}: {explain(error)}") from error
    for name, entry in registry.domains.items():
        if isinstance(entry, FileDomainEntry):
            _declare(path, name, entry)
    return registry


def _read(path: pathlib.Path) -> dict[str, Any]:
    """Return a registry's tables, what it extends included."""
    try:
        data = tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise RegistryError(f"{path}: cannot read the registry: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # no UTF-8, no TOML, a number or nesting beyond all measure
        raise RegistryError(f"{path}: not valid TOML: {error}") from error
    if "extends" not in data:
        return data
    base = data.pop("extends")
    if base != SHIPPED:
        raise RegistryError(f'{path}: extends: {base!r} is unknown; known: "{SHIPPED}"')
    return _merged(_read(DEFAULT_PATH), data)


def _merged(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables with others laid over them, key by key."""
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        merged[key] = _merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def _declare(path: pathlib.Path, name: str, entry: FileDomainEntry) -> None:
    """Read a domain's file and make it known."""
    where, file = f"{path}: domains.{name}.file", path.parent / entry.file
    try:
        text = file.read_bytes().decode("utf-8-sig", errors="replace")
        domain = FileDomain(
            id=name,
            title=entry.title or name,
            source=str(file),
            text=text,
            episode_limit=entry.episode_limit,
            training_discount=entry.training_discount,
            report_discount=entry.report_discount,
            hidden_first_action=entry.hidden_first_action,
        )
        from_file.declare(domain)
    except BgnError as error:
        raise RegistryError(f"{where}: {error}") from error
    except (OSError, ValueError) as error:  # ValueError: a path that holds a null character
        raise RegistryError(f"{where}: cannot read {str(file)!r}: {error}") from error


def explain(error: ValidationError) -> str:
    """Say in one line which keys of a file are wrong, and why."""
    lines = []
    for problem in error.errors():
        key = ".".join(str(part) for part in problem["loc"] if part not in (_FILE, _MODULE))
        message = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            name = problem["loc"][-1]
            of_files = name in FileDomainEntry.model_fields and _MODULE in problem["loc"]
            message = "only for a domain with a `file`" if of_files else "unknown key"
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
            raise ValueError(f"{where} for {domain}: {explain(error)}") from error


def _inherited(name: str, presets: Mapping[str, Any], heirs: tuple[str, ...] = ()) -> Any:
    """Fill a preset's table up from the one it extends."""
    preset = presets[name]
    base_name = preset.get("extends") if isinstance(preset, dict) else None
    if base_name is None:
        return preset
    _require(isinstance(base_name, str), f"presets.{name}.extends: expected the name of a preset")
    _known(f"presets.{name}.extends", [base_name], presets)
    _require(base_name not in (*heirs, name), f"presets.{name}.extends: {base_name!r} extends it in turn")
    base = _inherited(base_name, presets, (*heirs, name))
    for where, table in ((name, preset), (base_name, base)):
        _require(isinstance(table, dict), f"presets.{where}: expected a table")
        for key in ("all", "domains"):
            _require(isinstance(table.get(key, {}), dict), f"presets.{where}.{key}: expected a table")
        for domain, settings in table.get("domains", {}).items():
            _require(isinstance(settings, dict), f"presets.{where}.domains.{domain}: expected a table")
    ours, theirs = preset.get("domains", {}), base.get("domains", {})
    domains = {d: {**theirs.get(d, {}), **ours.get(d, {})} for d in (*theirs, *ours)}
    return {**preset, "all": {**base.get("all", {}), **preset.get("all", {})}, "domains": domains}


def _known(where: str, names: Iterable[str], known: Iterable[str], advice: str = "") -> None:
    known = tuple(known)
    for name in names:
        hint = f" ({advice})" if advice else ""
        _require(name in known, f"{where}: unknown {name!r}; known: {', '.join(known)}{hint}")


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
