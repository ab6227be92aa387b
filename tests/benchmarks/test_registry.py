from __future__ import annotations

import dataclasses
import pathlib
import re

import pytest

from benchmarks import registry
from benchmarks.registry import DEFAULT_PATH, RegistryError
from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.analysis import paper

REGISTRY = registry.load()
TEXT = DEFAULT_PATH.read_text(encoding="utf-8")


def load_changed(tmp_path: pathlib.Path, old: str, new: str) -> None:
    assert old in TEXT
    path = tmp_path / "registry.toml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    registry.load(path)


def test_it_declares_every_domain_and_agent_there_is() -> None:
    assert set(REGISTRY.domains) == set(domains.ids())
    assert tuple(REGISTRY.agents) == tuple(AGENTS)


@pytest.mark.parametrize("domain", sorted({domain for domain, _ in [*paper.RETURNS, *paper.CELL_CLAIMS]}))
def test_domains_are_judged_by_a_fixed_evaluation(domain: str) -> None:
    entry, robot = REGISTRY.domains[domain], domains.get(domain).family == "robot"
    assert entry.physics == robot
    hallway = domain.startswith("hallway")
    assert entry.metric == ("sampled_success" if robot else "greedy_return" if hallway else "sampled_return")
    assert entry.authors_metric == ("first_100_return" if hallway else None)
    assert REGISTRY.horizon(domain) == REGISTRY.budgets["paper"].env_steps[domain]


def test_authors_code_is_what_the_code_defaults_to() -> None:
    settings = REGISTRY.presets["authors-code"].hyperparameters("hallway")
    assert dataclasses.replace(settings, belief_weight=1.0) == Hyperparameters()


@pytest.mark.parametrize(
    ("domain", "dimension"),
    [("hallway", 60), ("hallway-2", 92), ("rocksample-4-4", 257), ("rocksample-5-5", 801), ("top-plate", 10)],
)
def test_the_authors_belief_weight_is_sixteen_over_the_dimension(domain: str, dimension: int) -> None:
    weight = REGISTRY.presets["authors-code"].hyperparameters(domain).belief_weight
    assert weight == pytest.approx(16 / dimension, abs=6e-4)
    assert REGISTRY.presets["paper-text"].hyperparameters(domain).belief_weight == 1


def test_entropy_decays_in_rocksample_only() -> None:
    searched = {name for name in REGISTRY.presets if name.startswith("search-")}  # robot domains only
    ablation = REGISTRY.presets["ablate-entropy-decay"].hyperparameters("rocksample-4-4")
    assert ablation.entropy_weight_start == ablation.entropy_weight_end == 0.01
    for preset in (
        REGISTRY.presets[n] for n in REGISTRY.presets.keys() - searched - {"ablate-entropy-decay"}
    ):
        decaying = preset.hyperparameters("rocksample-4-4")
        assert (decaying.entropy_weight_start, decaying.entropy_weight_end) == (2.0, 2e-5)
        constant = preset.hyperparameters("hallway-2")
        assert constant.entropy_weight_start == constant.entropy_weight_end == 0.01


def test_the_printed_entropy_schedule_takes_fifteen_million_steps() -> None:
    steps = REGISTRY.budgets["paper"].env_steps["rocksample-5-5"]
    assert 2 * 0.1 ** (steps / 3_000_000) == pytest.approx(2e-5)


def test_a_preset_takes_over_what_it_does_not_say() -> None:
    calibrated, authors = (REGISTRY.presets[name] for name in ("calibrated", "authors-code"))
    assert calibrated.hyperparameters("hallway") == authors.hyperparameters("hallway")
    robot, theirs = (preset.hyperparameters("top-plate") for preset in (calibrated, authors))
    assert not robot.shared_recurrence
    assert theirs.shared_recurrence
    assert robot.learning_rate == theirs.learning_rate


def test_cell_joins_budget_and_preset() -> None:
    spec = REGISTRY.cell("top-plate", "ab-cb", budget="paper", preset="paper-text")
    assert (spec.env_steps, spec.evaluation_episodes, spec.physics_episodes) == (1_000_000, 1000, 200)
    assert not spec.hyperparameters.shared_recurrence
    assert REGISTRY.cell("hallway", "ab-cb", budget="paper", preset="paper-text").physics_episodes == 0


@pytest.mark.parametrize("kind", ["domain", "agent", "reference", "budget", "preset"])
def test_unknown_names_list_the_known(kind: str) -> None:
    first = next(iter(getattr(REGISTRY, kind + "s")))
    with pytest.raises(RegistryError, match=f"unknown {kind} 'nonesuch'; known: .*{re.escape(first)}"):
        REGISTRY.select(kind, ["nonesuch"])  # type: ignore[arg-type]


def test_selection_keeps_registry_order() -> None:
    assert REGISTRY.select("agent", ["ab-cb", "ah-ch"]) == ("ah-ch", "ab-cb")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'budget = "laptop"',
            'budget = "lapdog"',
            r"defaults\.budget: unknown 'lapdog'; known: smoke",
        ),
        ("[domains.hallway-2]", "[domains.hallway]", "not valid TOML"),
        ("tolerance = 0.05", "tolerance = -1", r"domains\.hallway\.tolerance: .*greater than 0"),
        ("tolerance = 0.05", 'tolerance = "5"', r"domains\.hallway\.tolerance: .*number"),
        ("tolerance = 0.05", "tolerence = 0.05", r"domains\.hallway\.tolerence: unknown key"),
        ('metric = "greedy_return"', 'metric = "greedy"', r"domains\.hallway\.metric: .*'greedy_return'"),
        (
            "hallway = 3200",
            "corridor = 3200",
            r"budgets\.smoke\.env_steps: unknown 'corridor'; known: hall",
        ),
        ("hallway = 3200", "hallway = 0", r"budgets\.smoke\.env_steps\.hallway is 0"),
        ("seeds = 2", "seeds = 0", r"budgets\.smoke\.seeds"),
        ("lanes = 16\n", "", r"presets\.authors-code\.all: missing lanes"),
        (
            "lanes = 16",
            "lames = 16",
            r"presets\.authors-code\.all: unknown 'lames'; known: shared",
        ),
        ("lanes = 16", 'lanes = "many"', r"presets\.authors-code for hallway: lanes: .*integer"),
        ("belief_weight = 0.267", "belief_wait = 1", r"domains\.hallway: unknown 'belief_wait'"),
        (
            'extends = "authors-code"',
            'extends = "nobody"',
            r"presets\.reproduction\.extends: unknown 'nobody'",
        ),
        (
            'extends = "authors-code"',
            'extends = "ridge-start"',
            r"extends: 'reproduction' extends it in turn",
        ),
        (
            'preset = "ridge-start"',
            'preset = "bridge"',
            r"budgets\.laptop\.preset: unknown 'bridge'; known: auth",
        ),
        ('"fib"]', '"fob"]', r"domains\.hallway\.references: unknown 'fob'; known: random, sarsop"),
        ('"fib"]', '"qmdp"]', r"domains\.hallway\.references: 'qmdp' is listed more"),
        (
            "[domains.hallway]",
            "[domains.corridor]",
            r"unknown 'corridor'; known: .*\(give a new one its `file`",
        ),
        ("[domains.hallway]", '[domains."Hall/way"]', r"'Hall/way' cannot be part of an id"),
        (
            "[agents.ah-cs]",
            "[agents.nobody]",
            r"agents: unknown 'nobody'; known: ah-ch, .*bgn/agents/specs\.py",
        ),
        (
            "cost = 1.1",
            "episode_limit = 5",
            r"domains\.hallway-2\.episode_limit: only for a domain with a `file`",
        ),
        ("cost = 1.1", 'file = "x.pomdp"', r"domains\.hallway-2\.episode_limit: Field required"),
        ("[defaults]", 'extends = "mine"\n[defaults]', r"extends: 'mine' is unknown; known: \"shipped\""),
    ],
)
def test_bad_registries_name_file_key_and_what_is_known(
    tmp_path: pathlib.Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(RegistryError, match=message) as caught:
        load_changed(tmp_path, old, new)
    assert str(tmp_path / "registry.toml") in str(caught.value)


def test_a_budget_names_its_preset_or_leaves_it_to_the_default() -> None:
    shipped = registry.load()
    assert shipped.preset_of("laptop") == "ridge-start"
    assert shipped.preset_of("paper") == shipped.defaults.preset == "reproduction"
    with pytest.raises(RegistryError, match="unknown budget 'dinner'"):
        shipped.preset_of("dinner")


def test_one_setting_for_all_agents_is_what_claims_are_judged_under() -> None:
    """The authors' in the classic domains, what the equal search chose (and the paper prints) in the robot domains."""
    shipped = registry.load()
    of = {name: shipped.presets[name].hyperparameters for name in shipped.presets}
    for domain, entry in shipped.domains.items():
        origin = "search-plain" if entry.physics else "authors-code"
        assert of["reproduction"](domain) == of[origin](domain)
        steepness = 10.0 if entry.physics else 0.0
        assert of["ridge-start"](domain) == dataclasses.replace(
            of[origin](domain), feature_steepness=steepness
        )


def test_missing_file(tmp_path: pathlib.Path) -> None:
    with pytest.raises(RegistryError, match="cannot read the registry"):
        registry.load(tmp_path / "none.toml")
