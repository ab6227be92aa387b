"""What is measured of stored policies after training, kept in ``measures/`` of the store.

What training leaves behind stays as it is: a row of ``measures`` carries the key of the run whose policy it is about.
"""

from __future__ import annotations

import math
import pathlib
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import safetensors
import safetensors.torch
import torch

from benchmarks import authors_evaluation
from benchmarks.registry import Registry
from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.analysis import habits
from bgn.analysis.habits import Episode
from bgn.domains.domain import Domain
from bgn.policies.every_start import every_start
from bgn.policies.saved import PolicyFileError, describe
from bgn.results.store import Store

Measure = Callable[[AgentNetworks, Domain, Hyperparameters, int], Mapping[str, float]]
"""What is measured of a policy and the seed of its run, by column."""


def measures_of(registry: Registry) -> Mapping[str, Measure]:
    """Return what is measured in which domain."""
    found: dict[str, Measure] = {
        d: _as_authors for d, entry in registry.domains.items() if entry.authors_metric
    }
    return found | {habit.domain: _habits for habit in habits.HABITS if habit.domain in registry.domains}


def unmeasured(store: Store, wanted: Mapping[str, Measure]) -> list[Mapping[Hashable, Any]]:
    """Return the rows of finished runs in these domains whose policies are stored and were not measured yet."""
    runs, measures = store.read("runs"), store.read("measures")
    known = set(zip(measures["run"], measures["key"], strict=True)) if len(measures) else set()
    return [
        row
        for row in (runs.to_dict("records") if len(runs) else ())
        if row["status"] == "ok"
        and row["domain"] in wanted
        and (row["run"], row["key"]) not in known
        and store.policy(row["run"]).is_file()
    ]


def measure(
    store: Store, rows: Iterable[Mapping[Hashable, Any]], wanted: Mapping[str, Measure]
) -> tuple[Counter[str], list[str]]:
    """Measure the policies of these rows, and store what came out.

    Return how many were measured in each domain, and what is wrong with those that could not be.
    """
    counts: Counter[str] = Counter()
    problems = []
    for row in rows:
        run, key, domain = row["run"], row["key"], row["domain"]
        try:
            values = measure_policy(store.policy(run), wanted[domain], seed=int(row["seed"]))
        except PolicyFileError as error:
            problems.append(str(error))
            continue
        if values:
            store.write("measures", run, pa.Table.from_pylist([{"run": run, "key": key, **values}]))
            counts[domain] += 1
    return counts, problems


def measure_policy(path: pathlib.Path, wanted: Measure, *, seed: int) -> Mapping[str, float]:
    """Return what is measured of one stored policy, by column.

    Raises
    ------
    bgn.policies.saved.PolicyFileError
        The file is no policy, or not one whole policy.
    """
    description = describe(path)
    domain = domains.get(description["domain"], **description["variant"])
    settings = Hyperparameters(**description["hyperparameters"])
    networks = AgentNetworks(agent(description["agent"]), domain, settings, (0,), torch.device("cpu"))
    try:
        networks.parameters.load(0, safetensors.torch.load_file(path))
    except (safetensors.SafetensorError, ValueError) as error:
        raise PolicyFileError(f"{path}: {error}") from error
    return wanted(networks, domain, settings, seed)


def _as_authors(
    networks: AgentNetworks, domain: Domain, settings: Hyperparameters, seed: int
) -> Mapping[str, float]:
    returns = authors_evaluation.first_to_finish(networks, domain, settings, np.random.default_rng(seed))
    error = np.std(returns, ddof=1) / math.sqrt(len(returns))
    return dict(zip(authors_evaluation.COLUMNS, (float(np.mean(returns)), float(error)), strict=True))


def _habits(
    networks: AgentNetworks, domain: Domain, settings: Hyperparameters, seed: int
) -> Mapping[str, float]:
    """Return how often a policy does what Section 5.3 says; nothing of a variant, whose states mean other things."""
    if domain.model.joint.state_names != domains.get(domain.id).model.joint.state_names:
        return {}
    hidden = domain.model.n_hidden
    return habits.shares(
        domain.id,
        (
            Episode(
                observed=(path.states // hidden).tolist(),
                hidden=int(path.states[0] % hidden),
                actions=path.actions.tolist(),
                success=bool(path.rewards.sum() > 0),
            )
            for path in every_start(networks, domain)
        ),
    )
