"""All tensors of an update live on one device.

Shown without a GPU on torch's meta device, which has shapes but no data: an operator that mixes devices raises there,
and so does whatever would read a value on the host.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest
import torch

from bgn import domains
from bgn.agents import layers
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.simulation import table_world
from bgn.training.learners.a2c import VARIATES, A2CLearner
from tests.training._stacks import CPU

META = torch.device("meta")


def moved(value: Any) -> Any:
    """Move all tensors of nested dataclasses to the meta device."""
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: moved(getattr(value, field.name)) for field in fields(value)})
    return value.to(META) if isinstance(value, torch.Tensor) else value


@pytest.fixture
def without_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile tables on the host, where their data are, and move them; move the layers' one constant."""
    compile_tables = table_world.compile_tables  # type: ignore[attr-defined]
    monkeypatch.setattr(
        table_world,
        "compile_tables",
        lambda domain, device, hidden: moved(compile_tables(domain, CPU, hidden)),
    )
    monkeypatch.setattr(layers, "_MINUS_ONE", torch.empty((), device=META))


@pytest.mark.usefixtures("without_data")
@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", ["hallway", "rocksample-4-4", "two-bumps-2d"])
@pytest.mark.parametrize(
    "settings",
    [
        Hyperparameters(),
        Hyperparameters(
            shared_recurrence=False,
            reward_scaling=False,
            feature_steepness=10.0,
            time_limit="bootstrap",
            stale_reset_info=True,
        ),
    ],
)
def test_an_update_stays_on_its_device(agent_id: str, domain_id: str, settings: Hyperparameters) -> None:
    stack = A2CLearner(AGENTS[agent_id], domains.get(domain_id), settings, (1, 2), META)
    for _ in range(2):
        variates = torch.empty(settings.rollout, 2 * settings.lanes, VARIATES, device=META)
        stack.update(variates, torch.empty((), device=META))
    assert {tensor.device for tensor in stack.state().values()} == {META}


def test_the_check_can_fail() -> None:
    with pytest.raises(RuntimeError):
        torch.empty(3, device=META) + torch.ones(3)
    with pytest.raises(RuntimeError):
        torch.empty(3, device=META).sum().item()
