"""A short check of training on a GPU: ``python -m benchmarks.gpu_check``, or ``nox -s gpu``.

Four questions, a few minutes: does the device compute what the CPU computes; does a captured update do what the same
operators do one by one, and do so again; do cells in threads end where they end alone; and how fast is it, with one
cell and with many at once. Needs torch, numpy and scipy only. With ``--device cpu`` it checks itself.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import torch
from torch import Tensor

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.training.cuda import MAX_CELLS, own_stream
from bgn.training.learners.a2c import A2CLearner
from bgn.training.recorder import WINDOW
from bgn.training.update_runner import UpdateRunner

#: Cells that stand for the rest: every input, embedded and given features, lists and products in the belief.
CELLS = (
    ("hallway", "ah-ch+bgn"),
    ("rocksample-4-4", "ab-cb"),
    ("two-bumps-2d", "ah-cs"),
    ("top-plate", "ah-cb"),
)
FASTEST_SEEDS = tuple(range(10))
#: Parameters may differ by this much after one update, relative to all of them; gradients by more.
PARAMETERS, GRADIENTS = 1e-5, 1e-3
_SECONDS = 5.0


@dataclass(frozen=True)
class Finding:
    """One line of the report; ``ok`` is None for what is only measured."""

    check: str
    subject: str
    ok: bool | None
    detail: str

    def __str__(self) -> str:
        verdict = {True: "ok", False: "WRONG", None: ""}[self.ok]
        return f"{self.check:8} {verdict:6} {self.subject}: {self.detail}"


@dataclass(frozen=True)
class Check:
    """What the questions are asked about."""

    device: torch.device
    cells: Sequence[tuple[str, str]] = CELLS
    seeds: tuple[int, ...] = (0, 1, 2)
    updates: int = 100
    seconds: float = _SECONDS
    at_once: Sequence[int] = (1, 4, 8, 16, 24)

    def run(self) -> Iterator[Finding]:
        """Yield the findings, question by question."""
        yield self._environment()
        for cell in self.cells:
            yield self._equal(*cell)
        for cell in self.cells:
            yield self._graph(*cell)
        yield from self._beside()
        for n in self.at_once:
            yield self._speed(n)

    def _environment(self) -> Finding:
        if self.device.type != "cuda":
            return Finding("device", str(self.device), None, f"torch {torch.__version__}")
        found = torch.cuda.get_device_properties(self.device)
        size = f"{found.multi_processor_count} multiprocessors, {found.total_memory / 2**30:.0f} GiB"
        return Finding("device", found.name, None, f"{size}, torch {torch.__version__}")

    def _equal(self, domain: str, agent: str) -> Finding:
        """Make one update from one state with one set of random numbers, here and on a CPU."""
        cpu, here = self._learner(domain, agent, torch.device("cpu")), self._learner(domain, agent)
        here.load_state(cpu.state())
        for learner in (cpu, here):
            UpdateRunner(learner, 1, capture=False).update(0)
        moved = int((cpu.actions != here.actions.cpu()).sum())
        gaps = []
        for of in ("values", "gradients"):
            ours, theirs = (_named(learner, of) for learner in (cpu, here))
            norm = torch.stack([t.double().norm() for t in ours.values()]).norm()
            gap = torch.stack([(ours[k].double() - theirs[k].double().cpu()).norm() for k in ours]).norm()
            gaps.append((gap / norm).item())
        ok = moved == 0 and gaps[0] < PARAMETERS and gaps[1] < GRADIENTS
        detail = f"parameters differ by {gaps[0]:.1e}, gradients by {gaps[1]:.1e}, {moved} actions differ"
        return Finding("equal", f"{domain}/{agent}", ok, detail)

    def _graph(self, domain: str, agent: str) -> Finding:
        """Replay a captured update, twice over, and run the same updates without capturing."""
        states = [self._trained(domain, agent, capture=capture) for capture in (None, None, False)]
        again, eager = _differing(states[0], states[1]), _differing(states[0], states[2])
        detail = f"{self.updates} updates differ from themselves in {_few(again)}, from eager ones in {_few(eager)}"
        return Finding("graph", f"{domain}/{agent}", not again and not eager, detail)

    def _beside(self) -> Iterator[Finding]:
        """Run all cells in threads, which capture while others replay, and compare with each alone."""
        with ThreadPoolExecutor(len(self.cells)) as pool:
            together = list(pool.map(lambda cell: self._trained(*cell), self.cells))
        for cell, state in zip(self.cells, together, strict=True):
            gap = _differing(state, self._trained(*cell))
            what = f"beside {len(self.cells) - 1} others it differs from alone in {_few(gap)}"
            yield Finding("beside", "/".join(cell), not gap, what)

    def _speed(self, n: int) -> Finding:
        """Measure the environment steps per second of ``n`` cells at once."""
        stop, ready = threading.Event(), threading.Barrier(n + 1)
        with ThreadPoolExecutor(n) as pool:
            work = [pool.submit(self._race, self.cells[i % len(self.cells)], ready, stop) for i in range(n)]
            try:
                ready.wait()
                stop.wait(self.seconds)
            except threading.BrokenBarrierError:
                pass  # a cell failed; its result says why
            finally:
                stop.set()
            rate = sum(one.result() for one in work)
        return Finding("speed", f"{n} cells at once", None, f"{rate:,.0f} environment steps per second")

    def _race(self, cell: tuple[str, str], ready: threading.Barrier, stop: threading.Event) -> float:
        with _aborting(ready), own_stream(self.device), torch.no_grad():
            learner = self._learner(*cell, seeds=FASTEST_SEEDS if self.device.type == "cuda" else self.seeds)
            with contextlib.closing(UpdateRunner(learner, 1_000_000)) as runner:
                runner.update(0)
                ready.wait()
                begin, done = time.monotonic(), 0
                while not stop.is_set():
                    done += 1
                    runner.update(done)
                self._wait()
                seconds = time.monotonic() - begin
        return done * len(learner.seeds) * learner.shape.lanes * learner.shape.steps / seconds

    def _trained(self, domain: str, agent: str, *, capture: bool | None = None) -> dict[str, Tensor]:
        """Return the state after the updates, on the host."""
        with own_stream(self.device), torch.no_grad():
            learner = self._learner(domain, agent)
            with contextlib.closing(UpdateRunner(learner, 10_000, capture=capture)) as runner:
                for i in range(self.updates):
                    runner.update(i)
                self._wait()
                return {name: _kept(name, tensor) for name, tensor in learner.state().items()}

    def _learner(
        self,
        domain: str,
        agent: str,
        device: torch.device | None = None,
        seeds: tuple[int, ...] | None = None,
    ) -> A2CLearner:
        return A2CLearner(
            AGENTS[agent], domains.get(domain), Hyperparameters(), seeds or self.seeds, device or self.device
        )

    def _wait(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.current_stream().synchronize()


@contextlib.contextmanager
def _aborting(barrier: threading.Barrier) -> Iterator[None]:
    """Let nobody wait for a thread that failed."""
    try:
        yield
    except BaseException:
        barrier.abort()
        raise


def _named(learner: A2CLearner, buffer: str) -> Mapping[str, Tensor]:
    parameters = learner.networks.parameters
    return parameters.views(getattr(parameters, buffer))


def _kept(name: str, tensor: Tensor) -> Tensor:
    """Copy to the host what counts: a recorder's last column takes what is not an episode's end."""
    copied = tensor.detach().cpu().clone()
    return copied[..., :WINDOW] if name.endswith("window") else copied


def _differing(one: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> list[str]:
    """Return what is not equal to the bit; NaN equals NaN."""
    return [name for name, t in one.items() if not torch.equal(t.nan_to_num(), other[name].nan_to_num())]


def _few(names: Sequence[str]) -> str:
    more = ", …" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more if names else "nothing"


def main(
    arguments: Sequence[str] | None = None, run: Callable[[Check], Iterator[Finding]] = Check.run
) -> int:
    """Print the findings; return 1 if something is wrong, 2 if there is no such device."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gpu_check", description=__doc__)
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cuda")
    parser.add_argument("--quick", action="store_true", help="fewer and shorter: to see that the check works")
    options = parser.parse_args(arguments)
    if options.device == "cuda" and not torch.cuda.is_available():
        print(f"error: torch {torch.__version__} sees no GPU; --device cpu checks the check", file=sys.stderr)
        return 2
    torch.set_num_threads(1)
    check = Check(torch.device(options.device))
    if options.quick:
        check = Check(check.device, CELLS[2:], (0,), updates=3, seconds=0.2, at_once=(1, 2))
    assert max(check.at_once) <= MAX_CELLS
    wrong = 0
    for finding in run(check):
        print(finding, flush=True)
        wrong += finding.ok is False
    print(f"{wrong} wrong" if wrong else "all is well")
    return 1 if wrong else 0


if __name__ == "__main__":
    os.environ.setdefault("CUDA_DEVICE_MAX_CONNECTIONS", "32")  # before CUDA starts
    sys.exit(main())
