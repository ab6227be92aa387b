"""What is measured: each workload is set up once and then called, one unit of work a call, on one thread.

Executed as a program, this file serves its workloads to :mod:`benchmarks.speed.compare` over its standard
streams. It then runs against whatever revision of ``bgn`` is on the path, so it imports nothing of this
package and little of ``bgn``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import registry
from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.specs import AGENTS
from bgn.domains.domain import Domain
from bgn.pomdp import reader
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld

try:
    from bgn.training.learners import make_learner
    from bgn.training.update_runner import UpdateRunner
except ImportError:  # a revision from before there were several learners
    from bgn.training import executor, learner  # type: ignore[attr-defined]

    make_learner, UpdateRunner = learner.Learner, executor.Executor  # type: ignore[misc]

#: Seeds stacked in a measured cell: those of the ``laptop`` budget.
SEEDS = (0, 1, 2)
#: More updates than any measurement makes.
MANY_UPDATES = 100_000
POMDP_FILES = Path(__file__).parents[2] / "data" / "pomdp_files"

Workload = Callable[[], object]


def settings_of(domain_id: str, preset: str = "authors-code") -> Hyperparameters:
    """Return a preset's settings on a domain of the registry."""
    return registry.load().presets[preset].hyperparameters(domain_id)


class Training:
    """Updates of one cell by the learner that ``make`` returns.

    ``env_steps`` is how many environment steps a call makes over all seeds.
    """

    def __init__(
        self,
        domain: Domain,
        agent_id: str,
        settings: Hyperparameters,
        *,
        seeds: tuple[int, ...] = SEEDS,
        warm_up: int = 2,
        make: Callable[..., Any] = make_learner,
    ) -> None:
        torch.set_num_threads(1)
        self.spec, self.domain, self.settings, self.seeds = AGENTS[agent_id], domain, settings, seeds
        self.learner = make(self.spec, domain, settings, seeds, torch.device("cpu"))
        self.runner = UpdateRunner(self.learner, MANY_UPDATES)
        self.env_steps = len(seeds) * settings.lanes * settings.rollout
        self.done = 0
        for _ in range(warm_up):
            self()

    @classmethod
    def of_cell(cls, domain_id: str, agent_id: str) -> Training:
        """Return the cell of the registry, under the default preset."""
        return cls(domains.get(domain_id), agent_id, settings_of(domain_id))

    def __call__(self) -> None:
        """Make one update."""
        self.runner.update(self.done)
        self.done += 1


class Filtering:
    """Steps of a table world with exact beliefs under random actions; ``env_steps`` a call."""

    def __init__(self, domain_id: str, *, lanes: int = 48, track_beliefs: bool = True) -> None:
        torch.set_num_threads(1)
        torch.manual_seed(0)
        domain = domains.get(domain_id)
        self.world = TableWorld(domain, lanes, track_beliefs=track_beliefs)
        self.world.reset(torch.rand(lanes, START_VARIATES))
        self.env_steps = lanes
        self.n_actions = domain.model.joint.n_actions

    def __call__(self) -> None:
        """Step every lane once."""
        lanes = self.world.lanes
        actions = torch.randint(self.n_actions, (lanes,))
        openings = self.world.openings(torch.rand(lanes, START_VARIATES))
        self.world.step(actions, torch.rand(lanes, STEP_VARIATES), openings)


def repeated(work: Workload, times: int) -> Workload:
    """Make one call of several, for work too short for the clock."""

    def call() -> None:
        for _ in range(times):
            work()

    return call


def loading(name: str) -> Workload:
    """Return the reading of one of the repository's ``.pomdp`` files."""
    return partial(reader.load, POMDP_FILES / name)


def compiling(domain_id: str) -> Workload:
    """Return the layout of a domain's sparse model as simulator tables."""
    domain = replace(domains.get(domain_id))
    return lambda: TableWorld(domain, 1)


#: What two revisions are compared by.
COMPARED: dict[str, Callable[[], Workload]] = {
    "train hallway/ah-ch+bgn": partial(Training.of_cell, "hallway", "ah-ch+bgn"),
    "train hallway/ab-cb": partial(Training.of_cell, "hallway", "ab-cb"),
    "train rocksample-5-5/ah-ch+bgn": partial(Training.of_cell, "rocksample-5-5", "ah-ch+bgn"),
    "train two-bumps-1d/ah-cs": partial(Training.of_cell, "two-bumps-1d", "ah-cs"),
    "belief rocksample-5-5": lambda: repeated(Filtering("rocksample-5-5"), 20),
    "belief hallway": lambda: repeated(Filtering("hallway"), 20),
    "belief two-bumps-1d": lambda: repeated(Filtering("two-bumps-1d"), 20),
    "compile hallway": lambda: compiling("hallway"),
    "load hallway.pomdp": lambda: loading("hallway.pomdp"),
}


def serve() -> None:
    """Answer each name read from standard input with the CPU seconds of one call, or with an error."""
    ready: dict[str, Workload] = {}
    for line in sys.stdin:
        name = line.strip()
        try:
            if name not in ready:
                ready[name] = COMPARED[name]()
                ready[name]()
            start = time.process_time()
            ready[name]()
            answer: dict[str, float | str] = {"seconds": time.process_time() - start}
        except Exception as error:  # another revision may lack anything; the caller reports it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    serve()
