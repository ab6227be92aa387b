"""The Hallways as the authors measured them, computed afterwards from stored policies.

Their test runs the policy greedily in 16 environments side by side, each starting over when its episode ends, and
averages the first 100 episodes to finish. That favours short episodes: one that takes long is likelier not to be among
the first. It is a metric of its own beside the unbiased one, kept in ``measures/`` of the store, so that what training
leaves behind stays as it is.
"""

from __future__ import annotations

import pathlib
from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import torch

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.domains.domain import Domain
from bgn.results.store import Store
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld

EPISODES, LANES = 100, 16
COLUMNS = ("first_100_return", "first_100_return_se")


def first_to_finish(
    networks: AgentNetworks, domain: Domain, settings: Hyperparameters, rng: np.random.Generator
) -> list[float]:
    """Return the discounted returns of the first 100 greedy episodes to finish in 16 lanes."""
    world = TableWorld(
        domain,
        LANES,
        hidden_first_action=settings.hidden_first_action,
        track_beliefs=networks.actor.kind == "belief",
    )
    networks.prepare()
    world.reset(_uniform(rng, START_VARIATES))
    hidden = torch.zeros(1, LANES, networks.hidden_width)
    returns, discounts = torch.zeros(LANES, dtype=torch.double), torch.ones(LANES, dtype=torch.double)
    finished: list[float] = []
    with torch.no_grad():
        while len(finished) < EPISODES:
            features, hidden = networks.actor_features(world.inputs, hidden)
            action = networks.actor.head.forward(features).argmax(-1)[0]
            openings = world.openings(_uniform(rng, START_VARIATES))
            step = world.step(action, _uniform(rng, STEP_VARIATES), openings)
            returns += discounts * step.reward
            discounts *= domain.report_discount
            done = step.ended | step.truncated
            finished += returns[done].tolist()
            returns[done], discounts[done] = 0.0, 1.0
    return finished[:EPISODES]


def measure(store: Store, domain_ids: Sequence[str]) -> int:
    """Measure every finished run of these domains whose policy is stored; return how many were measured now."""
    runs, measures = store.read("runs"), store.read("measures")
    known = set(zip(measures["run"], measures["key"], strict=True)) if len(measures) else set()
    measured = 0
    for row in runs.to_dict("records") if len(runs) else ():
        run, key = str(row["run"]), str(row["key"])
        wanted = row["status"] == "ok" and row["domain"] in domain_ids and (run, key) not in known
        if wanted and store.policy(run).is_file():
            values = measure_policy(store.policy(run), seed=int(row["seed"]))
            store.write("measures", run, pa.Table.from_pylist([{"run": run, "key": key, **values}]))
            measured += 1
    return measured


def measure_policy(path: pathlib.Path, *, seed: int) -> Mapping[str, float]:
    """Return the metric of one stored policy, by column."""
    import safetensors.torch

    from bgn.policies.saved import describe

    description = describe(path)
    domain = domains.get(description["domain"], **description["variant"])
    settings = Hyperparameters(**description["hyperparameters"])
    networks = AgentNetworks(agent(description["agent"]), domain, settings, (0,), torch.device("cpu"))
    networks.parameters.load(0, safetensors.torch.load_file(path))
    returns = first_to_finish(networks, domain, settings, np.random.default_rng(seed))
    return dict(zip(COLUMNS, (np.mean(returns), np.std(returns, ddof=1) / np.sqrt(EPISODES)), strict=True))


def _uniform(rng: np.random.Generator, width: int) -> torch.Tensor:
    return torch.from_numpy(rng.random((LANES, width), dtype=np.float32))
