from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bgn.results.run_ids import CellId, ReferenceId, RunId, RunIdError, check_name

NAMES = st.from_regex(r"[a-z0-9][a-z0-9.+_-]{0,9}", fullmatch=True)


def test_ids_read_as_they_are_printed() -> None:
    run = RunId.of("hallway", "ah-ch+bgn", 3)
    assert str(run) == "hallway/ah-ch+bgn/seed-3"
    assert str(run.cell) == "hallway/ah-ch+bgn"
    assert str(ReferenceId("hallway", "sarsop", "clean")) == "hallway/sarsop/clean"


@given(NAMES, NAMES, st.integers(0, 10**6))
def test_what_is_made_is_parsed(domain: str, agent: str, seed: int) -> None:
    run = RunId.of(domain, agent, seed)
    assert RunId.parse(str(run)) == run
    assert CellId.parse(str(run.cell)) == run.cell
    for convention in ("clean", "hidden-first-action"):
        reference = ReferenceId(domain, agent, convention)  # type: ignore[arg-type]
        assert ReferenceId.parse(str(reference)) == reference


@pytest.mark.parametrize(
    "text", ["", "hallway", "hallway/ah-ch", "hallway/ah-ch/3", "hallway/ah-ch/seed-03", "hallway/ah-ch/seed-x",
             "hallway/ah-ch/seed--1", "/ah-ch/seed-0", "hallway/../seed-0", "hallway/ah-ch/seed-0/", "a/b/c/seed-1"],
)  # fmt: skip
def test_what_is_no_run_id_is_said(text: str) -> None:
    with pytest.raises(RunIdError, match=f"{re.escape(repr(text))} is not a run id: DOMAIN/AGENT/seed-N"):
        RunId.parse(text)


def test_other_ids_say_what_they_look_like() -> None:
    with pytest.raises(RunIdError, match="a cell id: DOMAIN/AGENT"):
        CellId.parse("hallway/ah-ch/seed-0")
    with pytest.raises(RunIdError, match="clean or hidden-first-action"):
        ReferenceId.parse("hallway/sarsop/dirty")
    with pytest.raises(RunIdError, match="negative"):
        RunId.of("hallway", "ah-ch", -1)


@pytest.mark.parametrize("name", ["", "..", "a/b", "A", "-a", "a b"])
def test_names_that_no_folder_should_have(name: str) -> None:
    with pytest.raises(RunIdError, match="cannot be part of an id"):
        check_name(name)
