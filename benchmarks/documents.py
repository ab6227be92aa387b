"""Writes what the documents say of the results: ``python -m benchmarks.documents [--check]``.

``CLAIMS.md`` is written as a whole, ``README.md`` between its markers, and the figures of ``docs/figures`` as PNG and
SVG. All of it comes from ``results/published``, under the registry's preset. ``--check`` writes nothing and fails where
a text is not what the results say.
"""

from __future__ import annotations

import argparse
import pathlib
import sys
from collections.abc import Callable, Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from benchmarks import pooled
from benchmarks.notebooks.display import digest
from benchmarks.pooled import PooledEvidence
from bgn.analysis import answers, tables
from bgn.analysis.figures import across, curves, schematic, style
from bgn.errors import BgnError

ROOT = pathlib.Path(__file__).parents[1]
BEGIN, END = "<!-- results: begin (python -m benchmarks.documents) -->", "<!-- results: end -->"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the documents, or check them; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.documents", description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; fail where a text is out of date"
    )
    options = parser.parse_args(arguments)
    try:
        found = pooled.load(ROOT / "results" / "published")
        texts = documents(found)
    except BgnError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    old = [
        path for path, text in texts.items() if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]
    if options.check:
        for path in old:
            print(
                f"error: {path.name} is not what the results say: python -m benchmarks.documents",
                file=sys.stderr,
            )
        return int(bool(old))
    for path in old:
        path.write_text(texts[path], encoding="utf-8")
        print(f"wrote {path.relative_to(ROOT)}")
    for name, draw in FIGURES.items():
        style.save(draw(found), ROOT / "docs" / "figures" / name)
    print(f"wrote {len(FIGURES)} figures to docs/figures")
    return 0


#: The figures of the documents.
FIGURES: Mapping[str, Callable[[PooledEvidence], Figure]] = {
    "training-curves": lambda found: curves.training_curves(found.scores, found.agent_titles),
    "success-curves": lambda found: curves.success_curves(found.scores, found.agent_titles),
    "belief-agents": lambda found: curves.success_curves(
        found.scores, found.agent_titles, ("ah-ch+bgn", "ab-cb", "ab-cb+bgn")
    ),
    "belief-losses": lambda found: curves.belief_losses(found.scores, found.agent_titles),
    "belief-against-score": lambda found: across.belief_against_score(found.scores, found.agent_titles),
    "every-seed-classic": lambda found: across.every_seed(found.scores, found.agent_titles, "classic"),
    "every-seed-robot": lambda found: across.every_seed(found.scores, found.agent_titles, "robot"),
    "performance-profiles": lambda found: across.performance_profiles(found.scores, found.agent_titles),
    "openings": lambda found: across.openings(found.scores, found.agent_titles, found.reference_titles),
    "cost": lambda found: across.cost(found.scores, found.agent_titles),
    "architecture": lambda _: schematic.architecture(),
}


def documents(found: PooledEvidence) -> dict[pathlib.Path, str]:
    """Return the texts that say what the results are, by path."""
    readme = ROOT / "README.md"
    return {
        ROOT / "CLAIMS.md": claims_text(found),
        readme: with_block(readme.read_text(encoding="utf-8"), readme_block(found)),
    }


def with_block(text: str, block: str) -> str:
    """Return a text with what stands between its markers replaced."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise BgnError(f"README.md has no block between {BEGIN!r} and {END!r}")
    return f"{before}{BEGIN}\n{block}{END}{after}"


def claims_text(found: PooledEvidence) -> str:
    """Return ``CLAIMS.md``: every claim word for word, what is asked, its cells, statistic and verdict."""
    lines = [
        "# The paper's claims",
        "",
        "Sentences of the paper that assert an ordering, a rate or a mechanism, word for word (citations left "
        "out), and what the stored runs say to it. A sentence that asserts several things is judged part by part. "
        "This file is written by `python -m benchmarks.documents`; the rules are in `bgn/analysis/criteria/`, what "
        'they leave open in DEVIATIONS.md, "Method".',
        "",
        _source(found),
        "",
        answers.claims_verdicts(found.claims),
        "",
        "*holds*: every comparison is significant by itself. *does not hold*: one is significantly contradicted. "
        "*short*: runs are shorter than the paper's. The horizons of the robot domains are ours: the paper's text "
        "prints none. *By Table 6*: the same question put to its own numbers, as printed.",
    ]
    section = ""
    for _, claim in found.claims.iterrows():
        if claim["section"] != section:
            section = claim["section"]
            lines += ["", f"## {section if len(section) > 3 else f'Section {section}'}"]
        lines += [
            "",
            f"> {claim['quote']}",
            "",
            f"`{claim['claim']}`: {claim['asks']}. {'; '.join(_facts(claim))}.",
        ]
    return "\n".join(lines) + "\n"


def _facts(claim: pd.Series) -> list[str]:
    cells = f"{claim['cells_run']} of {claim['cells']} cells" if claim["cells"] else ""
    facts = [
        f"**{claim['verdict']}**",
        claim["statistic"],
        f"n = {claim['runs']}, {claim['env_steps']} steps, {cells}" if claim["runs"] else cells,
        f"by Table 6: {claim['by_table_6']}" if claim["by_table_6"] else "",
        f"[{claim['notebook']}](notebooks/{claim['notebook']}.ipynb#Verdict)",
    ]
    return [fact for fact in facts if fact]


def readme_block(found: PooledEvidence) -> str:
    """Return what README says of the results."""
    scores = found.scores
    lines = [
        "",
        _source(found),
        "",
        f"- **Numbers.** {answers.numbers(found)}",
        f"- **Claims.** {answers.claims_verdicts(found.claims)} One by one: [CLAIMS.md](CLAIMS.md).",
        f"- **Speed of learning.** {answers.speed_of_learning(scores)}",
        f"- **Grounding.** {answers.grounding(scores)}",
        f"- **Robot domains.** {answers.robots(scores)}",
        f"- **Collapses.** {answers.lost_success(found, scores)}",
        f"- **Cost.** {answers.cost(found.runs)}",
        "",
    ]
    for table in (tables.raw_returns(found), tables.success_rates(found)):
        lines += ["<details>", f"<summary>{table.title}</summary>", "", table.markdown(), "</details>", ""]
    return "\n".join(lines)


def _source(found: PooledEvidence) -> str:
    horizons = []
    for domain in found.domains:
        cells = found.cells[found.cells["domain"] == domain.id]
        steps, runs = cells["env_steps"].max(), cells["runs"]
        n = f"{runs.min()}" if runs.min() == runs.max() else f"{runs.min()} to {runs.max()}"
        agents = f"{len(cells)} agent" + ("s" if len(cells) > 1 else "")
        horizons.append(f"{domain.title} {steps / 1e6:g} M (n = {n}, {agents})")
    return (
        f"From `results/published` ({digest(found)}), preset `{found.preset}`, "
        f"for each domain the longest budget with most agents: {', '.join(horizons)}."
    )


if __name__ == "__main__":
    sys.exit(main())
