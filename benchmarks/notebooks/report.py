"""Executed notebooks as an HTML report that opens from disk: an index and a page per notebook, light or dark."""

from __future__ import annotations

import html
import pathlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nbconvert.filters.markdown_mistune import markdown2html_mistune
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer

from benchmarks.notebooks.display import STAMP

_STYLE = pathlib.Path(__file__).with_name("report.css")
#: Forms of an output in the order in which they are preferred.
_FORMS = ("text/html", "image/png", "text/markdown", "text/plain")


@dataclass(frozen=True)
class Page:
    """What the index says of a notebook."""

    name: str
    title: str
    answer: str
    stamp: str
    picture: str
    """The first picture as PNG in base64, or nothing."""


def write_report(notebooks: Mapping[str, Any], folder: pathlib.Path) -> pathlib.Path:
    """Write a page for each executed notebook and the index; returns the index's path."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = [describe(name, notebook) for name, notebook in notebooks.items()]
    for page, notebook in zip(pages, notebooks.values(), strict=True):
        links = "".join(
            f'<a href="{p.name}.html"{" aria-current=page" if p is page else ""}>{html.escape(p.name[:2])}</a>'
            for p in pages
        )
        body = "\n".join(_cell(cell) for cell in notebook["cells"])
        navigation = f'<nav><a href="index.html">bgn</a>{links}</nav>'
        _write(folder / f"{page.name}.html", page.title, f"{navigation}<main>{body}</main>")
    index = folder / "index.html"
    cards = "\n".join(_card(page) for page in pages)
    intro = (
        "<h1>Belief-Grounded Networks, reproduced</h1>"
        "<p>One page per question, each with its answer in a sentence, made from stored results.</p>"
    )
    _write(
        index, "Belief-Grounded Networks, reproduced", f"<main>{intro}<div class=cards>{cards}</div></main>"
    )
    return index


def describe(name: str, notebook: Any) -> Page:
    """Find a notebook's title, answer, stamp and first picture."""
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    title = re.search(r"^# (.+)$", notebook["cells"][0]["source"], re.MULTILINE)
    answers = [_data(o)["text/markdown"] for o in outputs if "text/markdown" in _data(o)]
    quoted = next((text for text in answers if text.startswith("> **")), "")
    pictures = [_data(output)["image/png"] for output in outputs if "image/png" in _data(output)]
    return Page(
        name,
        title[1] if title else name,
        quoted.removeprefix("> **").removesuffix("**"),
        next(iter(stamps(notebook)), ""),
        "".join(pictures[0].split()) if pictures else "",
    )


def stamps(notebook: Any) -> list[str]:
    """Return the lines in which a notebook says what results it read."""
    texts = [
        o["text"]
        for cell in notebook["cells"]
        for o in cell.get("outputs", ())
        if o["output_type"] == "stream"
    ]
    return [line for text in texts for line in text.splitlines() if line.startswith(STAMP)]


def _cell(cell: Any) -> str:
    if cell["cell_type"] == "markdown":
        return f'<section class="prose">{markdown2html_mistune(cell["source"])}</section>'
    code = highlight(cell["source"], PythonLexer(), HtmlFormatter(nowrap=True))
    shown = "\n".join(_output(output) for output in cell["outputs"])
    return f"<details><summary>code</summary><pre class=code>{code}</pre></details><section>{shown}</section>"


def _output(output: Any) -> str:
    if output["output_type"] == "stream":
        return f"<pre class=stream>{html.escape(output['text'])}</pre>"
    data = _data(output)
    form = next((form for form in _FORMS if form in data), None)
    if form == "text/html":
        return str(data[form])
    if form == "image/png":
        return f'<img class=figure alt="" src="data:image/png;base64,{"".join(data[form].split())}">'
    if form == "text/markdown":
        return str(markdown2html_mistune(data[form]))
    return f"<pre class=stream>{html.escape(data[form])}</pre>" if form else ""


def _data(output: Any) -> Mapping[str, str]:
    return output.get("data", {}) if output["output_type"] in ("display_data", "execute_result") else {}


def _link(page: Page, *, current: bool) -> str:
    number, mark = page.name.partition("-")[0], " aria-current=page" if current else ""
    return f'<a href="{page.name}.html"{mark} title="{html.escape(page.title)}">{html.escape(number)}</a>'


def _card(page: Page) -> str:
    picture = f'<img alt="" src="data:image/png;base64,{page.picture}">' if page.picture else ""
    return (
        f'<a class=card href="{page.name}.html"><h2>{html.escape(page.title)}</h2><p>{html.escape(page.answer)}</p>'
        f"{picture}<small>{html.escape(page.stamp)}</small></a>"
    )


def _write(path: pathlib.Path, title: str, body: str) -> None:
    style = _STYLE.read_text(encoding="utf-8")
    light, dark = (
        HtmlFormatter(style=name).get_style_defs("pre.code") for name in ("friendly", "github-dark")
    )
    page = f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{html.escape(title)}</title>
<style>
{light}
@media (prefers-color-scheme: dark) {{
{dark}
}}
{style}
</style>
{body}
</html>
"""
    path.write_text(page, encoding="utf-8")
