"""``python -m benchmarks`` with cells that take a second, and checkpoints a tenth of a second apart."""

from __future__ import annotations

import pathlib
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

from benchmarks import __main__ as command
from benchmarks import registry, tasks
from benchmarks.plan import Selection
from benchmarks.registry import Registry
from benchmarks.tasks import Work
from bgn.results.store import Store
from bgn.training import trainer
from bgn.training.cell import CellSpec, RunResult

ROOT = pathlib.Path(__file__).parents[2]
BUDGET = "smoke"
CELLS = ["--domain", "hallway", "--agent", "ah-ch+bgn", "ab-cb", "--reference", "random"]
RUNS = 2 * 2
#: What the soak draws from, with all agents: a classic domain of each kind, and one with physics.
DOMAINS = ("hallway", "rocksample-4-4", "top-plate")
REFERENCES = ("random", "sarsop", "qmdp", "perfect")
SEEDS = (0, 1)


def tiny_registry() -> Registry:
    """Return the shipped registry with little to do."""
    shipped = registry.load()
    budget = shipped.budgets[BUDGET].model_copy(
        update={
            "env_steps": dict.fromkeys(shipped.domains, 4000),
            "evaluation_episodes": 50,
            "reference_episodes": 50,
            "planning_backups": 200,
            "planning_seconds": 60.0,
        }
    )
    return shipped.model_copy(update={"budgets": {**shipped.budgets, BUDGET: budget}})


def train_cell(spec: CellSpec, seeds: Sequence[int], **options: Any) -> list[RunResult]:
    """Train in earnest, with many checkpoints."""
    trainer.CHECKPOINT_SECONDS, trainer.PROGRESS_SECONDS = 0.1, 0.05
    return tasks.train_cell(spec, seeds, **options)


WORK = Work(train_cell=train_cell)


def main() -> int:
    """Run the command of the process's arguments."""
    tiny = tiny_registry()
    registry.load = lambda *_: tiny  # type: ignore[misc]
    return command.main(sys.argv[1:], work=WORK)


def arguments(results: pathlib.Path, *more: str) -> list[str]:
    """Return the arguments of a run of the few cells into a folder."""
    return ["run", "--results", str(results), "--budget", BUDGET, *CELLS, "--jobs", "2", *more]


def universe() -> Selection:
    """Return everything that the soak draws from."""
    known = tiny_registry()
    return Selection(
        known, BUDGET, known.defaults.preset, DOMAINS, tuple(known.agents), REFERENCES, seeds=SEEDS
    )


def selecting(chosen: Selection, results: pathlib.Path) -> list[str]:
    """Return the arguments of a run of a selection into a folder."""
    names = {"--domain": chosen.domains, "--agent": chosen.agents, "--reference": chosen.references}
    options = [word for option, some in names.items() if some for word in (option, *some)]
    seeds = ",".join(map(str, chosen.seeds))
    return ["run", "--results", str(results), "--budget", BUDGET, *options, "--seeds", seeds]


def start(arguments: Sequence[str], **options: Any) -> subprocess.Popen[str]:
    """Start the command in a process of its own."""
    code = "import sys; from tests.crash.tiny import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )


def store_of(results: pathlib.Path) -> Store:
    """Return the store that the command writes."""
    return Store(results / BUDGET / registry.load().defaults.preset)
