"""An update must be capturable as one CUDA graph: nothing in it may wait for data or shape itself by data."""

from __future__ import annotations

from collections import Counter

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from bgn.agents.specs import AGENTS
from bgn.training.learners.a2c import VARIATES
from bgn.training.random_streams import Purpose, RandomStreams
from tests.training._stacks import CPU, learner

#: Operations that read values on the host, take a host value, or have shapes that depend on data.
FORBIDDEN = {
    "_local_scalar_dense",
    "is_nonzero",
    "equal",
    "nonzero",
    "nonzero_static",
    "masked_select",
    "_unique2",
    "unique_dim",
    "unique_consecutive",
    "bincount",
    "repeat_interleave",
    "lift_fresh",
}


class NoWaiting(TorchDispatchMode):
    """Raises on what a CUDA graph cannot hold; counts what ran."""

    def __init__(self) -> None:
        super().__init__()
        self.ran: Counter[str] = Counter()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.overloadpacket.__name__
        if name in FORBIDDEN:
            raise AssertionError(f"{name} waits for the device or shapes itself by data")
        if name.startswith("index") and len(args) > 1 and isinstance(args[1], list | tuple):
            masks = [i for i in args[1] if i is not None and i.dtype in (torch.bool, torch.uint8)]
            assert not masks, "indexing with a mask shapes itself by data"
        self.ran[name] += 1
        return function(*args, **(kwargs or {}))


@pytest.mark.parametrize("agent_id", AGENTS)
@pytest.mark.parametrize("domain_id", ["hallway", "two-bumps-2d"])
@pytest.mark.parametrize("variant", [{}, {"time_limit": "bootstrap", "stale_reset_info": True}])
def test_an_update_neither_waits_nor_shapes_itself_by_data(agent_id, domain_id, variant):
    stack = learner(agent_id, domain_id, (1, 2), lanes=3, rollout=2, **variant)
    streams, weight = RandomStreams((1, 2), Purpose.TRAINING, CPU), torch.tensor(0.01)
    stack.update(streams.block(0, 2, 3, VARIATES), weight)
    places = {name: tensor.data_ptr() for name, tensor in stack.state().items()}
    before = {name: tensor.clone() for name, tensor in stack.state().items()}
    variates = streams.block(1, 2, 3, VARIATES)
    with NoWaiting() as mode:
        stack.update(variates, weight)
    assert mode.ran.total() > 100
    after = stack.state()
    assert {name: tensor.data_ptr() for name, tensor in after.items()} == places
    assert not torch.equal(after["values.actor.head.weight"], before["values.actor.head.weight"])


@pytest.mark.parametrize(
    "wait",
    [
        lambda x: x.sum().item(),
        lambda x: bool(x.any()),
        lambda x: x[x > 0],
        lambda x: x.nonzero(),
        lambda x: x.masked_select(x > 0),
        lambda x: x.unique(),
        lambda x: torch.tensor([1.0]) + x,
        lambda x: x.index_put_((x > 0,), torch.ones(())),
        lambda x: torch.equal(x, x),
    ],
)
def test_the_check_can_fail(wait):
    x = torch.ones(3)
    with pytest.raises(AssertionError, match="data"), NoWaiting():
        wait(x)
