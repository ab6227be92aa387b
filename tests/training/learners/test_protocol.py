"""Another algorithm is a class and hyperparameters of its own: nothing else knows about it."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from bgn import domains
from bgn.agents.hyperparameters import CommonHyperparameters, Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import AGENTS
from bgn.errors import InputError
from bgn.training import learners
from bgn.training.cell import CellSpec
from bgn.training.learners import make_learner
from bgn.training.learners.plain_a2c import PlainA2CLearner
from bgn.training.learners.protocol import Learner, UpdateShape
from bgn.training.recorder import Recorder
from bgn.training.trainer import train_cell

CPU = torch.device("cpu")


@dataclass(frozen=True, kw_only=True)
class Guessing(CommonHyperparameters):
    """An algorithm that draws new weights and earns what it draws."""

    spread: float = 0.1


class GuessingLearner:
    def __init__(self, spec, domain, hyperparameters, seeds, device) -> None:
        self.spec, self.domain, self.settings = spec, domain, hyperparameters
        self.seeds, self.device, self.shape = seeds, device, UpdateShape(3, 2, 1)
        self.networks = AgentNetworks(spec, domain, hyperparameters, seeds, device)
        self.recorder = Recorder(len(seeds), 2, 1.0, ("surprise",), device)

    def schedule(self, total_updates: int) -> Tensor:
        return torch.linspace(1.0, 0.0, total_updates)[:, None].expand(-1, 2)

    def update(self, variates: Tensor, scheduled: Tensor) -> None:
        assert scheduled.shape == (2,)
        earned = variates.view(3, len(self.seeds), 2).transpose(0, 1)
        self.networks.parameters.values.add_(variates.mean(), alpha=self.settings.spread)
        self.recorder.record(earned, torch.ones_like(earned, dtype=torch.bool), scheduled[:1].expand(2, 1))

    def state(self) -> dict[str, Tensor]:
        return {"values": self.networks.parameters.values, **self.recorder.state()}

    def load_state(self, state) -> None:
        for name, tensor in self.state().items():
            tensor.copy_(state[name])

    def networks_of(self, row: int) -> AgentNetworks:
        networks = AgentNetworks(self.spec, self.domain, self.settings, (self.seeds[row],), self.device)
        networks.parameters.load(0, self.networks.parameters.of_seed(row))
        return networks


def test_the_trainer_knows_only_the_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(learners.LEARNERS, Guessing, GuessingLearner)
    spec = CellSpec(
        domain="top-plate",
        agent="ah-ch",
        hyperparameters=Guessing(),
        env_steps=5 * 6,
        evaluation_episodes=4,
    )
    results = train_cell(spec, (7, 1))
    for result in results:
        assert result.curve["surprise"].tolist() == pytest.approx([1.0, 0.75, 0.5, 0.25, 0.0])
        assert result.curve["env_steps"].tolist() == [6, 12, 18, 24, 30]
        assert result.curve["episodes"].tolist() == [6, 12, 18, 24, 30]
        assert "entropy" not in result.curve
        assert set(result.metrics) >= {"train_return", "greedy_return"}
    assert results[0].curve["return_100"].iloc[0] != results[1].curve["return_100"].iloc[0]


def test_unknown_hyperparameters_are_named() -> None:
    with pytest.raises(InputError, match="no learner takes Guessing; known hyperparameters: Hyperparameters"):
        make_learner(AGENTS["ah-ch"], domains.get("top-plate"), Guessing(), (0,), CPU)


def test_the_plain_learner_trains_a_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind the protocol, it yields the fast learner's curve."""
    spec = CellSpec(
        domain="hallway",
        agent="ab-cb",
        hyperparameters=Hyperparameters(lanes=4),
        env_steps=160,
        evaluation_episodes=5,
    )
    (fast,) = train_cell(spec, (3,))
    monkeypatch.setitem(learners.LEARNERS, Hyperparameters, PlainA2CLearner)
    (plain,) = train_cell(spec, (3,))
    assert list(plain.curve) == list(fast.curve)
    for name in ("return_100", "episodes", "entropy", "critic_loss"):
        assert plain.curve[name].tolist() == pytest.approx(fast.curve[name].tolist(), nan_ok=True, rel=1e-4)


def test_learners_follow_the_protocol() -> None:
    made: list[Learner] = [
        make_learner(AGENTS["ab-cb"], domains.get("hallway"), Hyperparameters(lanes=2), (0,), CPU)
    ]
    made.append(PlainA2CLearner(AGENTS["ab-cb"], domains.get("hallway"), Hyperparameters(lanes=2), (0,), CPU))
    one, other = made
    assert one.shape == other.shape == UpdateShape(5, 2, 7)
    assert one.recorder.names == other.recorder.names
    assert torch.equal(one.schedule(4), other.schedule(4))
