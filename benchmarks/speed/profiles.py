"""Where an update's time goes, and what a GPU would be asked to do for it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor
from torch.profiler import ProfilerActivity, profile
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.speed.workloads import Workload

#: Operators by what they are for; an operator that is in no group counts as ``OTHER``.
GROUPS: Mapping[str, Sequence[str]] = {
    "products": ("bmm", "baddbmm", "mm", "addmm", "matmul"),
    "gates and activations": ("tanh", "sigmoid", "lerp", "softmax", "exp", "log"),
    "optimiser": ("adam", "rmsprop", "norm"),
    "look-ups": ("index", "gather", "scatter", "embedding", "one_hot", "searchsorted"),
    "copies": ("copy", "cat", "stack", "clone", "contiguous", "fill", "zero"),
    "arithmetic": ("mul", "add", "sub", "div", "where", "mask", "sum", "clamp", "mean"),
}
OTHER = "views, allocation, the rest"


@dataclass(frozen=True)
class Share:
    """One row of a profile."""

    what: str
    fraction: float  # of the CPU time in operators
    calls: float  # an update


def shares(update: Workload, updates: int = 20) -> list[Share]:
    """Profile ``updates`` calls; return each group's share of the time, the largest first."""
    with profile(activities=[ProfilerActivity.CPU]) as recorded:
        for _ in range(updates):
            update()
    seconds: dict[str, float] = defaultdict(float)
    calls: dict[str, float] = defaultdict(float)
    for event in recorded.key_averages():
        group = _group(event.key)
        seconds[group] += event.self_cpu_time_total
        calls[group] += event.count / updates
    total = sum(seconds.values())
    rows = [Share(group, seconds[group] / total, calls[group]) for group in seconds]
    return sorted(rows, key=lambda row: -row.fraction)


def _group(operator: str) -> str:
    name = operator.removeprefix("aten::").strip("_")
    for group, parts in GROUPS.items():
        if any(part in name for part in parts):
            return group
    return OTHER


@dataclass(frozen=True)
class Launches:
    """What one update asks of the device."""

    kernels: int
    """Operators that compute or copy: on a GPU, about one kernel each."""
    megabytes: float
    """Memory that they read and write, each counting its arguments and results once."""
    multiply_adds: float
    """Multiply-adds in products, as executed."""


class _Counter(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Counts operators and the bytes they touch, leaving out views and pure allocations."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.kernels, self.bytes = 0, 0

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        if not func.is_view and not str(func).startswith("aten.empty"):
            self.kernels += 1
            leaves = tree_leaves((args, kwargs, result))
            tensors = {(x.data_ptr(), x.numel()): x for x in leaves if isinstance(x, Tensor)}
            self.bytes += sum(x.numel() * x.element_size() for x in tensors.values())
        return result


def launches(update: Workload) -> Launches:
    """Count what one call dispatches."""
    with _Counter() as counter:
        update()
    with FlopCounterMode(display=False) as flops:
        update()
    return Launches(counter.kernels, counter.bytes / 1e6, flops.get_total_flops() / 2)
