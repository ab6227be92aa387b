"""The notebooks' machinery; `nox -s notebooks -- --fixture` tests that they run, on a small store."""

from __future__ import annotations

import copy
import pathlib

import nbformat
import pytest

from benchmarks import evidence
from benchmarks.notebooks import __main__ as notebooks
from benchmarks.notebooks import display, report

STORE = pathlib.Path(__file__).parents[1] / "data" / "store"
NAMES = sorted(path.stem for path in notebooks.FOLDER.glob("*.py"))


@pytest.mark.parametrize("name", NAMES)
def test_committed_notebooks_are_executed_and_match_their_sources(name: str) -> None:
    source = notebooks.prepared(notebooks.FOLDER / f"{name}.py")
    path = notebooks.FOLDER / f"{name}.ipynb"
    committed = nbformat.read(path, as_version=4)
    assert [cell["source"] for cell in committed["cells"]] == [cell["source"] for cell in source["cells"]]
    outputs = [output for cell in committed["cells"] for output in cell.get("outputs", ())]
    assert outputs
    assert not any(output["output_type"] == "error" for output in outputs)
    assert path.stat().st_size < 1_000_000
    page = report.describe(name, committed)
    assert page.title.startswith(name[:2])
    assert page.answer
    assert page.stamp.startswith(display.STAMP) or name.startswith("08")


def test_what_makes_a_notebook_stale(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    executed = nbformat.read(notebooks.FOLDER / "01-tables.ipynb", as_version=4)
    monkeypatch.setattr(notebooks, "FOLDER", tmp_path)
    assert notebooks.stale("01-tables", executed) == "it was never executed"
    nbformat.write(executed, tmp_path / "01-tables.ipynb")
    assert notebooks.stale("01-tables", executed) == ""
    other = copy.deepcopy(executed)
    (output,) = (o for c in other["cells"] for o in c.get("outputs", ()) if o["output_type"] == "stream")
    output["text"] = f"{display.STAMP} 000000000000 | other\n"
    assert notebooks.stale("01-tables", other).startswith("it read other results: Results read: ")
    other["cells"][0]["source"] = "# Edited"
    assert notebooks.stale("01-tables", other) == "its source was edited since"


def test_digest_is_of_numbers_not_of_times() -> None:
    found = evidence.load(STORE, budget="laptop", preset="calibrated")
    first = display.digest(found)
    found.runs["wall_seconds"] += 1.0
    found.runs["key"] = "another"
    assert display.digest(found) == first
    found.runs.loc[0, "greedy_return"] += 0.01
    assert display.digest(found) != first


def test_report_opens_from_disk(tmp_path: pathlib.Path) -> None:
    chosen = {name: nbformat.read(notebooks.FOLDER / f"{name}.ipynb", as_version=4) for name in NAMES[:2]}
    index = report.write_report(chosen, tmp_path)
    text = index.read_text()
    assert 'href="01-tables.html"' in text
    assert "prefers-color-scheme: dark" in text
    assert "http://" not in text  # nothing is fetched
    assert "https://" not in text
    page = (tmp_path / "01-tables.html").read_text()
    assert "data:image/png;base64," in page
    assert "Raw returns (paper, Table 6)" in page


def test_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert notebooks.main(["09-none"]) == 2
    assert "no notebook '09-none'; there are 01-tables" in capsys.readouterr().err
    assert notebooks.main(["--write", "--results", "elsewhere"]) == 2
    assert "leave out --results" in capsys.readouterr().err
