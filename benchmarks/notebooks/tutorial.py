"""The steps of the tutorial: train declared agents for seconds, and compare their seeds."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from types import MappingProxyType

import pandas as pd
from matplotlib.figure import Figure

from benchmarks import registry
from bgn.agents import specs
from bgn.agents.specs import AgentSpec
from bgn.analysis.figures import style
from bgn.analysis.figures.curves import band
from bgn.analysis.statistics import Sample, detectable_gap, welch_p
from bgn.training.cell import CellSpec, RunResult

Results = dict[str, list[RunResult]]
_METRIC = "sampled_return"
_EPISODES = 500


def train(
    agents: Sequence[AgentSpec | str],
    *,
    domain: str,
    env_steps: int,
    seeds: Sequence[int],
    preset: str | None = None,
) -> Results:
    """Train agents, declared here or known by id, on one domain; returns their runs by agent id."""
    from bgn.training.trainer import train_cell  # imported here because torch takes seconds

    known = registry.load()
    settings = known.presets[preset or known.defaults.preset].hyperparameters(domain)
    results: Results = {}
    for one in agents:
        agent_id = one if isinstance(one, str) else one.id
        spec = CellSpec(
            domain=domain,
            agent=agent_id,
            hyperparameters=settings,
            env_steps=env_steps,
            evaluation_episodes=_EPISODES,
        )
        with _declared([one] if isinstance(one, AgentSpec) else []):
            results[agent_id] = train_cell(spec, seeds)
    return results


def summary(results: Results) -> pd.DataFrame:
    """Return one row per agent: runs, and mean ± sd of the sampled evaluation."""
    rows = []
    for agent, runs in results.items():
        sample = _sample(runs)
        rows.append({"agent": agent, "runs": sample.n, "return": f"{sample.mean:.3f} ± {sample.sd:.3f}"})
    return pd.DataFrame(rows)


def curves(results: Results) -> Figure:
    """Return the agents' training curves."""
    figure, (axes,) = style.panels(1, panel=(5.2, 2.8))
    for agent, runs in results.items():
        line = band([run.curve for run in runs], "return_100")
        axes.plot(line["env_steps"], line["mean"], label=agent, **style.line(agent, tuple(results)))
        tint = style.colour(agent, tuple(results))
        axes.fill_between(line["env_steps"], line["low"], line["high"], color=tint, alpha=0.13, linewidth=0)
    style.plain(axes, "", "environment steps", "return, last 100 episodes")
    style.logarithmic(axes)
    style.legend(figure, [axes])
    return figure


def compare(results: Results, first: str, second: str) -> pd.DataFrame:
    """Return the difference of two agents' means, Welch's p-value, and the difference that would be seen."""
    a, b = _sample(results[first]), _sample(results[second])
    row = {
        "difference": f"{a.mean - b.mean:+.3f}",
        "p (Welch, two-sided)": f"{welch_p(a, b):.3f}",
        "seen four times in five": f"{detectable_gap(a, b, level=0.05):.3f}",
        "n": f"{a.n} and {b.n}",
    }
    return pd.DataFrame([{"agents": f"{first} - {second}", **row}])


def _sample(runs: Sequence[RunResult]) -> Sample:
    values = [run.metrics[_METRIC] for run in runs]
    return Sample.of(values, [run.metrics[f"{_METRIC}_se"] for run in runs])


@contextlib.contextmanager
def _declared(agents: Sequence[AgentSpec]) -> Iterator[None]:
    """Put declarations beside the paper's for a while."""
    before = specs.AGENTS
    specs.AGENTS = MappingProxyType({**before, **{agent.id: agent for agent in agents}})
    try:
        yield
    finally:
        specs.AGENTS = before
