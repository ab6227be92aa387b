"""How training speed grows with states, seeds and lanes: measured points and their figure."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from matplotlib.figure import Figure

from benchmarks.speed.workloads import Training, Workload, settings_of
from bgn import domains
from bgn.domains.rocksample import rocksample
from bgn.training.learners.plain_a2c import PlainA2CLearner

#: RockSample instances by grid size and rocks; |S| = n² 2^k + 1.
INSTANCES = {
    2: ((1, 0),),
    3: ((1, 1), (2, 0)),
    4: ((3, 1), (2, 1), (1, 3), (1, 0)),
    5: ((2, 4), (0, 4), (3, 3), (2, 2), (4, 1)),
    6: ((2, 4), (0, 4), (3, 3), (2, 2), (4, 1), (5, 5)),
}
#: The plain learner's dense arrays grow with the square of the states.
PLAIN_STATES = 1000
SEEDS = (1, 2, 3, 5, 10)
LANES = (4, 8, 16, 32, 64)
PLAIN = "plain, ah-ch+bgn"
AGENT_IDS = ("ah-ch+bgn", "ah-ch", "ab-cb")
ROUNDS = 5

Points = list[tuple[int, float]]


@dataclass(frozen=True)
class Growth:
    """Environment steps per CPU second along one axis, by line."""

    axis: str
    lines: Mapping[str, Points]


def by_states() -> Growth:
    """RockSample[n,k] from 9 to 2,305 states, three seeds; the plain learner has one."""
    settings = settings_of("rocksample-5-5")
    lines: dict[str, Points] = {label: [] for label in (*AGENT_IDS, PLAIN)}
    for n, rocks in INSTANCES.items():
        domain = rocksample(n, rocks)
        states = domain.model.n_hidden
        for agent in AGENT_IDS:
            training = Training(domain, agent, settings)
            lines[agent].append((states, rate(training, training.env_steps)))
        if states < PLAIN_STATES:
            plain = Training(domain, "ah-ch+bgn", settings, seeds=(0,), make=PlainA2CLearner)
            lines[PLAIN].append((states, rate(plain, plain.env_steps)))
    return Growth("states", lines)


def by_seeds() -> Growth:
    """Seeds stacked on Hallway."""
    return _along("seeds", SEEDS, lambda agent, n: _hallway(agent, seeds=n))


def by_lanes() -> Growth:
    """Lanes of three seeds on Hallway: an update then learns from more steps."""
    return _along("lanes", LANES, lambda agent, n: _hallway(agent, lanes=n))


def _along(axis: str, values: Sequence[int], make: Callable[[str, int], Training]) -> Growth:
    lines: dict[str, Points] = {}
    for agent in AGENT_IDS:
        lines[agent] = []
        for value in values:
            training = make(agent, value)
            lines[agent].append((value, rate(training, training.env_steps)))
    return Growth(axis, lines)


def _hallway(agent: str, *, seeds: int = 3, lanes: int = 16) -> Training:
    settings = replace(settings_of("hallway"), lanes=lanes)
    return Training(domains.get("hallway"), agent, settings, seeds=tuple(range(seeds)))


def rate(update: Workload, env_steps: int) -> float:
    """Environment steps per CPU second: the median of a few calls."""
    seconds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        update()
        seconds.append(time.process_time() - start)
    return env_steps / median(seconds)


def draw(growths: Sequence[Growth], path: Path) -> None:
    """Draw one panel a growth, on logarithmic axes."""
    figure = Figure(figsize=(4 * len(growths), 3.6), layout="constrained")
    for axes, growth in zip(figure.subplots(1, len(growths), sharey=True), growths, strict=True):
        for label, points in growth.lines.items():
            axes.loglog(*zip(*points, strict=True), marker="o", markersize=4, label=label)
        values = sorted({x for points in growth.lines.values() for x, _ in points})
        axes.set_xticks(values, [f"{x:,}" for x in values])
        axes.minorticks_off()
        axes.set_xlabel(growth.axis)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize=8)
    figure.axes[0].set_ylabel("environment steps per CPU-second")
    figure.savefig(path, dpi=130)
