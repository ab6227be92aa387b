"""On a GPU a stack's parameters lie seed by seed, and one launch optimises them: the same runs but for rounding."""

from __future__ import annotations

import pytest
import torch

from bgn.agents import parameters as parameters_module
from bgn.agents.a2c import RMSProp
from bgn.agents.parameters import Parameters
from bgn.agents.specs import AGENTS
from tests.training._stacks import CPU, learner, trained


@pytest.fixture
def as_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameters_module, "by_seed_on", lambda device: True)


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", ["hallway", "two-bumps-2d"])
def test_runs_are_the_same_in_both_layouts(
    agent_id: str, domain_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stacks = []
    for by_seed in (False, True):
        monkeypatch.setattr(parameters_module, "by_seed_on", lambda device, by_seed=by_seed: by_seed)
        stacks.append(trained(agent_id, domain_id, (1, 2, 5), 3, lanes=4, rollout=3))
    one, other = (stack.state() for stack in stacks)
    # A step of RMSProp moves a parameter by up to .007, whatever the size of its gradient, rounding included.
    assert one.keys() == other.keys()
    for name, tensor in one.items():
        ours, theirs = (t[..., :100] if "window" in name else t for t in (tensor, other[name]))
        torch.testing.assert_close(theirs, ours, rtol=1e-3, atol=1e-4, equal_nan=True)
    assert one["values.actor.head.weight"].is_contiguous()
    assert not other["values.actor.head.weight"].is_contiguous()


@pytest.mark.usefixtures("as_on_a_gpu")
def test_the_optimiser_is_one_launch(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    adam = torch._fused_adam_

    def counting(values, *rest, **options):
        calls.append([tensor.numel() for tensor in values])
        adam(values, *rest, **options)

    monkeypatch.setattr(torch, "_fused_adam_", counting)
    stack = trained("ah-ch", "hallway", (1, 2), 2, lanes=2, rollout=2)
    assert calls == [[stack.networks.parameters.values.numel()]] * 2


def test_clipping_by_seed_divides_each_seeds_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Norms 5 and .3: the first is scaled down to .5, the second is left alone."""
    steps = {}
    for by_seed in (False, True):
        monkeypatch.setattr(parameters_module, "by_seed_on", lambda device, by_seed=by_seed: by_seed)
        parameters = Parameters((0, 1), CPU)
        parameters.declare("a", (2,), torch.zeros)
        parameters.declare("b", (3,), torch.zeros)
        parameters.allocate()
        parameters.gradient("a")[0] = torch.tensor([3.0, 0.0])
        parameters.gradient("b")[0] = torch.tensor([0.0, 4.0, 0.0])
        parameters.gradient("a")[1] = torch.tensor([0.3, 0.0])
        norms = RMSProp(parameters, rate=0.1, decay=0.75, epsilon=1e-9).step(0.5)
        assert norms.tolist() == pytest.approx([5.0, 0.3])
        # v = .25 g², so that a step is -.1 g / (.5 |g|) = -.2 sign(g).
        squares = parameters.views(parameters.mean_squares)
        assert squares["b"][0].tolist() == pytest.approx([0.0, 0.25 * 0.4**2, 0.0])
        assert squares["a"][1].tolist() == pytest.approx([0.25 * 0.3**2, 0.0])
        steps[by_seed] = [*parameters["a"][:, 0].tolist(), *parameters["b"][:, 1].tolist()]
    assert steps[True] == pytest.approx(steps[False])
    assert steps[True] == pytest.approx([-0.2, -0.2, -0.2, 0.0])


@pytest.mark.usefixtures("as_on_a_gpu")
def test_a_checkpoint_of_one_layout_continues_in_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    stack = trained("ah-ch+bgn", "hallway", (1, 2), 3, lanes=2, rollout=2)
    monkeypatch.undo()
    other = learner("ah-ch+bgn", "hallway", (1, 2), lanes=2, rollout=2)
    other.load_state(stack.state())
    for name, tensor in stack.state().items():
        torch.testing.assert_close(other.state()[name], tensor, rtol=0, atol=0, equal_nan=True)
    assert not other.networks.parameters.goes_by_seed
