"""An agent and two domains that the paper does not have, as a newcomer would add them (who will not call them this)."""

from __future__ import annotations

import pathlib
from types import MappingProxyType

import pytest

import bgn.domains
from bgn.agents import specs
from bgn.agents.specs import AgentSpec
from bgn.domains import from_file
from bgn.domains import registry as domain_registry

#: An agent that sees the state.
AS_CS = AgentSpec(id="example-as-cs", title="As-Cs", actor="state", critic="state")

#: Tiger (Kaelbling et al. 1998), ended by opening a door.
TIGER = """
discount: 0.95
values: reward
states: tiger-left tiger-right
actions: listen open-left open-right
observations: hear-left hear-right
T: listen identity
T: open-left : * reset
T: open-right : * reset
O: listen
0.85 0.15
0.15 0.85
O: open-left uniform
O: open-right uniform
R: listen : * : * : * -1
R: open-left : tiger-left : * : * -100
R: open-left : tiger-right : * : * 10
R: open-right : tiger-left : * : * 10
R: open-right : tiger-right : * : * -100
"""

#: A module of bgn/domains: guess a coin that shows its side, after which the episode ends.
COIN = '''
"""Coin: say which side is up; it is seen after the first word."""

import numpy as np

from bgn.domains.domain import Domain
from bgn.domains.registry import register
from bgn.pomdp.model import MOMDP, POMDP, sparse_rows


@register("example-coin")
def coin() -> Domain:
    """Build Coin."""
    same = sparse_rows([{0: 1.0}, {1: 1.0}], 2)
    return Domain(
        id="example-coin",
        title="Coin",
        family="classic",
        model=MOMDP(
            POMDP(
                transitions=(same, same, same),
                observations=(same, same, same),
                rewards=np.array([[0, 0], [1, -1], [-1, 1]], dtype=float)[:, :, None, None],
                start=np.array([0.5, 0.5]),
                reset=np.array([[False, False], [True, True], [True, True]]),
                discount=0.9,
                state_names=("heads", "tails"),
                action_names=("look", "say-heads", "say-tails"),
                observation_names=("heads", "tails"),
            )
        ),
        episode_limit=5,
        training_discount=0.9,
        report_discount=0.9,
        hidden_first_action=True,
    )
'''

REGISTRY = """
extends = "shipped"

[defaults]
budget = "tiny"

[domains.example-tiger]
file = "tiger.pomdp"
title = "Tiger"
episode_limit = 20
metric = "greedy_return"
tolerance = 1.0
references = ["random", "sarsop"]

[domains.example-coin]
metric = "train_return"
tolerance = 0.1
references = ["random", "sarsop"]

[agents.example-as-cs]

[budgets.tiny]
description = "a few hundred steps"
seeds = 2
evaluation_episodes = 20
physics_episodes = 0
reference_episodes = 50
planning_backups = 500
planning_seconds = 60
env_steps = { example-tiger = 480, example-coin = 480 }
"""


def add(folder: pathlib.Path, patch: pytest.MonkeyPatch) -> pathlib.Path:
    """Add them all until the test is over; return the registry that names them."""
    patch.setattr(specs, "AGENTS", MappingProxyType({**specs.AGENTS, AS_CS.id: AS_CS}))
    modules = folder / "modules"
    modules.mkdir()
    (modules / "newcomers_coin.py").write_text(COIN, encoding="utf-8")
    forget_domains(patch)
    patch.setattr(bgn.domains, "__path__", [*bgn.domains.__path__, str(modules)])
    domain_registry._discover.cache_clear()
    return write_registry(folder)


def forget_domains(patch: pytest.MonkeyPatch) -> None:
    """Let domains that become known from now on be forgotten when the test is over."""
    domain_registry.ids()
    patch.setattr(domain_registry, "_BUILDERS", dict(domain_registry._BUILDERS))
    patch.setattr(from_file, "_DECLARED", dict(from_file._DECLARED))
    domain_registry.get.cache_clear()


def write_registry(folder: pathlib.Path) -> pathlib.Path:
    """Write the registry and the file beside it."""
    (folder / "tiger.pomdp").write_text(TIGER, encoding="utf-8")
    path = folder / "my.toml"
    path.write_text(REGISTRY, encoding="utf-8")
    return path
