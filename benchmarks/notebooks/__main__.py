"""Executes the notebooks: ``python -m benchmarks.notebooks [NAME …] [--results DIR] [--budget B] [--preset P]``.

Pages and an index go to ``build/notebooks`` (``--out``). Without ``--results`` the published results are shown, and the
notebooks in the repository must show the same: if they were made from other results, or from other sources, this fails;
``--write`` puts the new ones in their place.
"""

from __future__ import annotations

import argparse
import os
import pathlib
import sys
from collections.abc import Sequence
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from benchmarks.notebooks import report

ROOT = pathlib.Path(__file__).parents[2]
FOLDER = ROOT / "notebooks"
TIMEOUT = 900
"""Seconds a cell may take."""
_METADATA = {
    "jupytext": {"formats": "ipynb,py:percent"},
    "kernelspec": {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute, write the report, and compare with what is committed; 0 if all is well, 1 if not, 2 for wrong usage."""
    options = _parser().parse_args(arguments)
    names = [path.stem for path in sorted(FOLDER.glob("*.py"))]
    for name in options.names:
        if name not in names:
            print(f"error: no notebook {name!r}; there are {', '.join(names)}", file=sys.stderr)
            return 2
    if options.write and options.results:
        print("error: --write shows the published results; leave out --results", file=sys.stderr)
        return 2
    for variable, value in (
        ("RESULTS", options.results),
        ("BUDGET", options.budget),
        ("PRESET", options.preset),
    ):
        if value:
            os.environ[f"BGN_{variable}"] = str(value)
    executed, failed = _execute_all(options.names or names)
    index = report.write_report(executed, options.out)
    print(f"report: {index}")
    default = not (options.results or options.budget or options.preset)
    if options.write:
        for name, notebook in executed.items():
            nbformat.write(notebook, FOLDER / f"{name}.ipynb")
    elif default:
        failed |= _report_stale(executed)
    return int(failed)


def execute(source: pathlib.Path) -> Any:
    """Return the notebook of a py:percent source, executed in the repository's root."""
    notebook = prepared(source)
    client = NotebookClient(
        notebook, timeout=TIMEOUT, resources={"metadata": {"path": str(ROOT)}}, record_timing=False
    )
    client.execute()
    notebook["metadata"] = nbformat.from_dict(_METADATA)
    return notebook


def prepared(source: pathlib.Path) -> Any:
    """Return the notebook of a source, not executed; cells are named by their place, the same each time."""
    notebook = jupytext.read(source)
    notebook["metadata"] = nbformat.from_dict(_METADATA)
    for number, cell in enumerate(notebook["cells"]):
        cell["id"] = f"cell-{number}"
        cell["metadata"] = {}
    return notebook


def stale(name: str, executed: Any) -> str:
    """Say why the committed notebook does not show what an execution shows now; empty if it does."""
    path = FOLDER / f"{name}.ipynb"
    if not path.is_file():
        return "it was never executed"
    committed = nbformat.read(path, as_version=4)
    if [cell["source"] for cell in committed["cells"]] != [cell["source"] for cell in executed["cells"]]:
        return "its source was edited since"
    if report.stamps(committed) != report.stamps(executed):
        return f"it read other results: {' / '.join(report.stamps(committed)) or 'none'}"
    return ""


def _execute_all(names: Sequence[str]) -> tuple[dict[str, Any], bool]:
    executed, failed = {}, False
    for name in names:
        try:
            executed[name] = execute(FOLDER / f"{name}.py")
            print(f"executed {name}", flush=True)
        except CellExecutionError as error:
            print(f"error: {name}: {error.ename}: {error.evalue}", file=sys.stderr)
            failed = True
    return executed, failed


def _report_stale(executed: dict[str, Any]) -> bool:
    reasons = {name: reason for name, notebook in executed.items() if (reason := stale(name, notebook))}
    for name, reason in reasons.items():
        print(f"error: notebooks/{name}.ipynb is stale: {reason}", file=sys.stderr)
    if reasons:
        print("execute and replace them: nox -s notebooks -- --write", file=sys.stderr)
    return bool(reasons)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.notebooks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="such as 01-tables (default: all)")
    parser.add_argument(
        "--results", type=pathlib.Path, help="folder of the results (default: results/published)"
    )
    parser.add_argument("--budget", help="show this one (default: for each domain the longest)")
    parser.add_argument("--preset", help="show this one (default: the registry's)")
    parser.add_argument(
        "--out", type=pathlib.Path, default=ROOT / "build" / "notebooks", help="folder of the report"
    )
    parser.add_argument("--write", action="store_true", help="replace the notebooks in the repository")
    return parser


if __name__ == "__main__":
    sys.exit(main())
