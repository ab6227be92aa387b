"""Made-up runs, curves and reference rows for what is judged from them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import pandas as pd

from bgn.analysis.cells import DomainRow, summarise
from bgn.analysis.evidence import Evidence
from bgn.analysis.scores import Scores
from bgn.domains.episode_opening import HIDDEN

STEPS = 1000
AGENTS = {
    "ah-ch": "Ah-Ch",
    "ah-ch+bgn": "Ah-Ch+BGN",
    "ah-cs": "Ah-Cs",
    "ab-cb": "Ab-Cb",
    "ah-cb": "Ah-Cb",
    "ab-cb+bgn": "Ab-Cb+BGN",
}
DOMAINS = (
    DomainRow("hallway", "Hallway", "classic", "greedy_return", 0.05, HIDDEN, "first_100_return", STEPS),
    DomainRow("hallway-2", "Hallway-2", "classic", "greedy_return", 0.05, HIDDEN, None, STEPS),
    DomainRow("rocksample-4-4", "RockSample[4,4]", "classic", "sampled_return", 1.0, HIDDEN, None, STEPS),
    DomainRow("rocksample-5-5", "RockSample[5,5]", "classic", "sampled_return", 1.0, HIDDEN, None, STEPS),
    DomainRow("top-plate", "TopPlate", "robot", "sampled_success", 0.01, horizon=STEPS),
    DomainRow("two-bumps-1d", "TwoBumps-1D", "robot", "sampled_success", 0.01, horizon=STEPS),
    DomainRow("two-bumps-2d", "TwoBumps-2D", "robot", "sampled_success", 0.01, horizon=STEPS),
)


def run(
    domain: str, agent: str, seed: int = 0, steps: int = STEPS, **metrics: float | bool
) -> dict[str, object]:
    """Return a row of ``runs``; metrics that are not named are zero, their errors .01."""
    kinds = [f"{kind}_{what}" for kind in ("train", "sampled", "greedy") for what in ("return", "success")]
    errors = [f"{kind}_return_{what}" for kind in ("sampled", "greedy") for what in ("se", "sd")]
    row: dict[str, object] = dict.fromkeys(kinds, 0.0) | dict.fromkeys(errors, 0.01)
    about = {
        "run": f"{domain}/{agent}/seed-{seed}",
        "key": "k",
        "domain": domain,
        "agent": agent,
        "seed": seed,
    }
    spec = json.dumps({"evaluation_episodes": 1000, "env_steps": steps})
    return (
        row
        | about
        | {"spec": spec, "older": False, "device": "cpu", "cpu_seconds": 1.0, "env_steps_per_second": 9.0}
        | metrics
    )


def cell(
    domain: str, agent: str, values: Sequence[float], steps: int = STEPS, **more: float
) -> list[dict[str, object]]:
    """Return a run for each value of the domain's judged metric."""
    metric = next(row.metric for row in DOMAINS if row.id == domain)
    return [run(domain, agent, seed, steps, **{metric: value}, **more) for seed, value in enumerate(values)]


def curve(
    domain: str,
    agent: str,
    seed: int,
    steps: Sequence[float],
    values: Sequence[float],
    **more: Sequence[float],
) -> pd.DataFrame:
    """Return a learning curve through the given points, in return and success."""
    frame = {"env_steps": steps, "return_100": values, "success_100": values, "episodes": [1000] * len(steps)}
    frame |= {"belief_cross_entropy": [float("nan")] * len(steps)} | more
    return pd.DataFrame(frame).assign(
        run=f"{domain}/{agent}/seed-{seed}", domain=domain, agent=agent, key="k"
    )


def reference(domain: str, policy: str, convention: str, value: float, **more: float) -> dict[str, object]:
    """Return a reference row."""
    spec = json.dumps({"episodes": 10_000})
    row = {"domain": domain, "reference": policy, "convention": convention, "return": value, "spec": spec}
    return row | {"return_se": 0.1, "return_sd": 3.0} | more


def scores(
    runs: Sequence[Mapping[str, object]],
    curves: Sequence[pd.DataFrame] = (),
    references: Sequence[Mapping[str, object]] = (),
) -> Scores:
    """Return scores of made-up rows."""
    frames = pd.concat(curves, ignore_index=True) if curves else pd.DataFrame()
    return Scores(pd.DataFrame(runs), frames, pd.DataFrame(references), DOMAINS)


def evidence(
    runs: Sequence[Mapping[str, object]], references: Sequence[Mapping[str, object]] = ()
) -> Evidence:
    """Return evidence of made-up rows, of the domains that have any."""
    frame = pd.DataFrame(runs)
    present = {str(row["domain"]) for row in (*runs, *references)}
    domains = [domain for domain in DOMAINS if domain.id in present]
    return Evidence(
        cells=summarise(frame, domains, AGENTS),
        runs=frame,
        references=pd.DataFrame(references),
        domains=domains,
        agent_titles=AGENTS,
        reference_titles={
            "random": "Random",
            "sarsop": "SARSOP",
            "perfect": "Perfect",
            "drive-east": "Drive east",
        },
    )
