import pytest

from benchmarks import registry
from bgn import domains
from bgn.errors import InputError
from bgn.planning.reference_rows import evaluate_reference

BASIC = {"return", "return_se", "return_sd", "success", "success_se", "length"}


REGISTRY = registry.load()


@pytest.mark.parametrize("name", REGISTRY.domains)
def test_every_reference_of_every_domain_gives_a_row(name):
    domain = domains.get(name)
    rows = {}
    for reference in REGISTRY.domains[name].references:
        row = rows[reference] = evaluate_reference(reference, domain, episodes=300, seed=0, backups=1000)
        assert row.keys() >= BASIC
        assert 0 <= row["success"] <= 1
        assert row["length"] <= domain.episode_limit
    for best in ("perfect", "sarsop"):
        if best in rows and "random" in rows:
            assert rows[best]["return"] >= rows["random"]["return"]


def test_rows_repeat_from_the_seed():
    domain = domains.get("rocksample-4-4")
    first, second, other = (
        evaluate_reference("sarsop", domain, episodes=300, seed=seed, convention="hidden-first-action")
        for seed in (1, 1, 2)
    )
    assert first == second
    assert first["return"] != other["return"]
    assert first["lower_bound"] == pytest.approx(14.117, abs=2e-3)
    assert first["upper_bound"] - first["lower_bound"] <= 1e-3


def test_the_perfect_row_is_exact():
    row = evaluate_reference("perfect", domains.get("top-plate"), episodes=2, seed=0)
    assert row["success"] == pytest.approx(1)
    assert row["value"] == pytest.approx(0.929579, abs=1e-6)
    assert (row["length"], row["max_length"]) == (pytest.approx(8.3), 12)
    assert row["return_se"] == 0


@pytest.mark.parametrize(
    ("name", "rate"), [("top-plate", 0.0376), ("two-bumps-1d", 0.150), ("two-bumps-2d", 0.0038)]
)
def test_random_success_of_the_robot_domains(name, rate):
    row = evaluate_reference("random", domains.get(name), episodes=20_000, seed=0)
    assert row["success"] == row["return"] == pytest.approx(rate, abs=4 * (rate / 20_000) ** 0.5)


def test_what_does_not_apply_is_refused():
    with pytest.raises(InputError, match=r"no reference policy 'best'; known: random, sarsop"):
        evaluate_reference("best", domains.get("hallway"), episodes=10, seed=0)
    with pytest.raises(InputError, match=r"no action 'east'; known: "):
        evaluate_reference("drive-east", domains.get("hallway"), episodes=10, seed=0)
    with pytest.raises(InputError, match="hallway reports discounted returns"):
        evaluate_reference("perfect", domains.get("hallway"), episodes=10, seed=0)
    with pytest.raises(ValueError, match="no hidden first action"):
        evaluate_reference(
            "random", domains.get("top-plate"), episodes=10, seed=0, convention="hidden-first-action"
        )


def test_a_solve_that_is_cut_off_says_so():
    row = evaluate_reference("sarsop", domains.get("hallway"), episodes=10, seed=0, timeout=0.2)
    assert row["timed_out"] == 1
    assert row["backups"] < 10_000


def test_a_row_is_the_same_however_long_the_solve_takes():
    rows = []
    for seconds in (500.0, 600.0):  # another limit, so that the solution is not the one kept in memory
        row = evaluate_reference(
            "sarsop", domains.get("hallway-2"), episodes=50, seed=0, backups=400, timeout=seconds
        )
        assert row["timed_out"] == 0
        rows.append(row)
    assert rows[0] == rows[1]
