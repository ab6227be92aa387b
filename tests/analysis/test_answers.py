"""Sentences about stored results."""

from __future__ import annotations

import pandas as pd

from bgn.analysis import answers
from tests.analysis._evidence import curve, evidence, run, scores


def runs(**devices: int) -> pd.DataFrame:
    rows = [(device, 36.0, '{"env_steps": 500000}') for device, n in devices.items() for _ in range(n)]
    return pd.DataFrame(rows, columns=["device", "cpu_seconds", "spec"])


def test_the_cost_of_runs_on_cpus_and_on_a_gpu_is_told_apart() -> None:
    on_cpus = (
        "2 runs shown took 0.0 core-hours for 1.0 million environment steps: 13,889 steps per CPU second."
    )
    on_a_gpu = (
        "3 runs of 1.5 million steps were trained on a GPU, which cells share: "
        "docs/performance.md has its speed."
    )
    assert answers.cost(runs(cpu=2)) == on_cpus
    assert answers.cost(runs(cuda=3)) == on_a_gpu
    assert answers.cost(runs(cpu=2, cuda=3)) == f"{on_cpus} {on_a_gpu}"
    assert answers.cost(runs()) == "No run is stored."


def test_one_claim_holds_and_two_hold() -> None:
    def said(*verdicts: str) -> str:
        return answers.claims_verdicts(pd.DataFrame({"verdict": verdicts, "notebook": "01-tables"}))

    assert said("holds", "does not hold", "does not hold") == "Of 3 claims: 1 holds, 2 do not hold."
    assert said("holds", "holds", "does not hold") == "Of 3 claims: 2 hold, 1 does not hold."


def test_who_loses_what_was_learnt() -> None:
    def said(**successes: list[float]) -> str:
        agents = {"plain": "ah-ch", "grounded": "ah-ch+bgn"}
        found = [run("top-plate", agents[name]) for name in successes]
        curves = [curve("top-plate", agents[n], 0, [1, 2, 3], values) for n, values in successes.items()]
        curves = [c.assign(entropy=0.0) for c in curves]
        return answers.lost_success(evidence(found), scores(found, curves))

    assert "in 1 of 1 runs of Ah-Ch; never in 1 of Ah-Ch+BGN." in said(plain=[0, 1, 0], grounded=[0, 1, 1])
    assert said(plain=[0, 1, 0]).endswith("in 1 of 1 runs of Ah-Ch.")
    assert said(plain=[0, 0.1, 0]).startswith("No runs (1 of Ah-Ch) in which")
    assert answers.lost_success(evidence([run("hallway", "ah-ch")]), scores([])).startswith(
        "No run stored in"
    )
