from __future__ import annotations

import pathlib

import pandas as pd
import pytest

from benchmarks import evidence, measures, registry
from benchmarks.__main__ import main
from bgn.analysis import tables
from bgn.policies.saved import save_policy
from bgn.results.store import Store
from tests.policies.test_every_start import SETTINGS, networks_of

SMOKE = ["--budget", "smoke"]


def test_measured_from_stored_policies_and_read_back(tmp_path: pathlib.Path) -> None:
    options = ["--results", str(tmp_path), "--budget", "smoke"]
    assert (
        main(["run", *options, "--domain", "hallway", "--agent", "ab-cb", "--seeds", "0", "--jobs", "1"]) == 0
    )
    assert main(["measure", *options]) == 0
    found = evidence.load(tmp_path, budget="smoke")
    (measured,) = found.runs["first_100_return"]
    policy = found.store.policy("hallway/ab-cb/seed-0")
    wanted = measures.measures_of(registry.load())
    assert measured == measures.measure_policy(policy, wanted["hallway"], seed=0)["first_100_return"]
    (cell,) = found.cells.to_dict("records")
    assert (cell["authors_metric"], cell["authors_runs"]) == ("first_100_return", 1)
    assert cell["authors_mean"] == measured
    assert measures.unmeasured(Store(found.store.root), wanted) == []
    assert pd.notna(found.cells["mean"]).all()


def test_only_what_is_asked_for_is_measured_and_named(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--results", str(tmp_path), *SMOKE]
    agents = ["--agent", "ab-cb", "ah-ch"]
    assert (
        main(["run", *options, "--domain", "hallway", "top-plate", *agents, "--seeds", "0", "--jobs", "1"])
        == 0
    )

    def said(*more: str) -> str:
        capsys.readouterr()
        assert main(["measure", *options, *more]) == 0
        return capsys.readouterr().out.strip()

    assert said("--domain", "two-bumps-1d") == "No stored policy is left to measure."
    assert said("--agent", "ah-ch", "--domain", "hallway") == "Policies measured: Hallway 1."
    assert said() == "Policies measured: Hallway 1, TopPlate 2."
    assert said() == "No stored policy is left to measure."

    store = evidence.load(tmp_path, budget="smoke").store
    for run in ("hallway/ab-cb/seed-0", "top-plate/ah-ch/seed-0"):
        (store.root / "measures" / f"{run}.parquet").unlink()
    store.policy("hallway/ab-cb/seed-0").write_bytes(b"no policy")
    assert main(["measure", *options]) == 1  # the damaged one is named, the other is measured
    printed = capsys.readouterr()
    assert printed.out.strip() == "Policies measured: TopPlate 1."
    assert "ab-cb/seed-0.safetensors is not a safetensors file" in printed.err


def test_habits_of_the_robot_domains(tmp_path: pathlib.Path) -> None:
    options = ["--results", str(tmp_path), *SMOKE]
    only = ["--domain", "top-plate", "--agent", "ah-ch+bgn", "--seeds", "0", "--jobs", "1"]
    assert main(["run", *options, *only]) == 0
    assert tables.policies_habits(evidence.load(tmp_path, budget="smoke")).rows == []
    assert main(["measure", *options]) == 0
    found = evidence.load(tmp_path, budget="smoke")
    (cases,), (share,) = found.runs["habit_up_then_down_cases"], found.runs["habit_up_then_down"]
    assert cases == 9  # stacks of one to nine plates, all from the same start
    assert 0 <= share <= 1
    (policies, first, second) = tables.policies_habits(found).rows
    assert policies == ["TopPlate, policies", "1"]
    assert first == [
        "TopPlate, under ten plates: up past the top, one down, grasps",
        f"{100 * share:.0f}",
    ]
    assert second[0].startswith("TopPlate, ten plates")


def test_a_variant_has_other_states_and_no_habits(tmp_path: pathlib.Path) -> None:
    networks = networks_of("ah-ch", "top-plate", variant="authors")
    kept = networks.actor_parameters()
    tensors = {n: t for n, t in networks.parameters.of_seed(0).items() if n in kept}
    about = {"domain": "top-plate", "agent": "ah-ch", "variant": {"variant": "authors"}}
    save_policy(tmp_path / "p", tensors, hyperparameters=SETTINGS, **about)
    wanted = measures.measures_of(registry.load())["top-plate"]
    assert measures.measure_policy(tmp_path / "p", wanted, seed=0) == {}


def test_nothing_to_measure_says_so(tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "--results", str(tmp_path), *SMOKE]) == 2
    assert "holds no policies to measure" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
