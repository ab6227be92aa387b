"""Every entry that tables print, made once more from parquet alone; what is judged in them, see test_recomputation."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pandas as pd
import pytest

from bgn.analysis import tables
from bgn.analysis.habits import HABITS
from bgn.analysis.text_table import TextTable
from tests.benchmarks import published_rows
from tests.benchmarks.published_rows import Cell, Rows
from tests.benchmarks.published_stores import POOLED, Store, stored
from tests.benchmarks.recomputed_claims import ROBOT
from tests.benchmarks.recomputed_statistics import METRICS, TABLE_6

CLASSIC = tuple(domain for domain in METRICS if domain not in ROBOT)
#: SARSOP's and Random's rows of Tables 6 and 7.
TABLE_6_ENDS = {
    "hallway": (0.53, 0.05),
    "hallway-2": (0.35, 0.03),
    "rocksample-4-4": (17.75, -62.0),
    "rocksample-5-5": (19.2, -61.0),
}
of_some_stores = pytest.mark.parametrize(
    "store", [POOLED, ("overnight", "ridge-start"), ("laptop", "calibrated")], ids="/".join
)


def rows_of(store: Store) -> Rows:
    return published_rows.longest("reproduction")[0] if store == POOLED else published_rows.read(*store)


def entries(store: Store, table: TextTable) -> Iterator[tuple[str, str, str, str]]:
    """Return the entries of a table that are not blank: its row's title and label, the column, the text."""
    title = ""
    for first, label, *texts in table.rows:
        title = first or title
        for column, text in zip(table.columns[2:], texts, strict=True):
            if text not in ("–", ""):
                yield title, label, column, text


def names(store: Store) -> dict[str, str]:
    """Return ids of domains and agents by the titles that stand in tables."""
    found = stored(store)
    titles = {domain.title: domain.id for domain in found.domains}
    return titles | {title: agent for agent, title in found.agent_titles.items()}


def spread(values: pd.Series | np.ndarray, digits: int = 2) -> str:
    """Return mean ± standard deviation (ddof 0) as tables print them."""
    values = np.asarray(values, dtype=float)
    return f"{values.mean():.{digits}f}±{values.std():.{digits}f}"


def unmarked(text: str) -> str:
    """Return an entry without its verdict and other marks."""
    return re.sub(r"[‡ ?=≈↑↓s…°]+$", "", text)


@of_some_stores
def test_raw_returns(store: Store) -> None:
    rows, seen = rows_of(store), 0
    ids = names(store)
    for title, label, column, text in entries(store, tables.raw_returns(stored(store))):
        seen += 1
        domain = ids[column]
        if title in ids:
            cell: Cell = domain, ids[title]
            if label == "ours":
                assert unmarked(text) == spread(rows.values(cell))
            elif label == "as authors":
                assert unmarked(text) == spread(rows.runs[cell]["first_100_return"].dropna())
            elif label == "n, power":
                assert int(text.split(",")[0]) == len(rows.runs[cell])
            else:
                mean, sd = TABLE_6[domain][("ah-ch", "ah-ch+bgn", "ah-cs", "ab-cb", "ah-cb").index(cell[1])]
                assert (label, text) == ("paper", f"{mean:.2f}±{sd:.2f}")
        elif label == "ours":
            start = "clean" if title == "SARSOP" else "hidden-first-action"
            row = rows.references[domain, title.lower(), start]
            width = 1.96 * row["return_se"] if title == "SARSOP" else row["return_sd"]
            assert text == f"{row['return']:.2f}±{width:.2f}"
        else:
            assert float(text.split("±")[0]) == TABLE_6_ENDS[domain][title == "Random"]
    assert seen or not rows.domains() & set(CLASSIC)


@of_some_stores
def test_normalised_returns(store: Store) -> None:
    rows, ids = rows_of(store), names(store)
    for title, label, column, text in entries(store, tables.normalised_returns(stored(store))):
        cell: Cell = ids[title], ids[column]
        start = "hidden-first-action" if "alike" in label else "clean"
        best = rows.references.get((cell[0], "sarsop", start))
        worst = rows.references.get((cell[0], "random", "hidden-first-action"))
        missing = best is None or worst is None
        assert ("†" in label) == (missing and label != "paper")
        printed_best, printed_worst = TABLE_6_ENDS[cell[0]]
        upper = printed_best if best is None or label == "paper" else best["return"]
        lower = printed_worst if worst is None or label == "paper" else worst["return"]
        if label.startswith("ours"):
            values = (rows.values(cell) - lower) / (upper - lower)
            assert text == spread(values)
        else:
            place = ("ah-ch", "ah-ch+bgn", "ah-cs", "ab-cb", "ah-cb").index(cell[1])
            mean, sd = TABLE_6[cell[0]][place]
            assert text == f"{(mean - lower) / (upper - lower):.2f}±{sd / (upper - lower):.2f}"


@of_some_stores
def test_success_rates(store: Store) -> None:
    rows, ids, seen = rows_of(store), names(store), 0
    for title, label, column, text in entries(store, tables.success_rates(stored(store))):
        seen += 1
        domain = ids[column]
        if title == "Random":
            assert text == f"{rows.references[domain, 'random', 'clean']['success']:.3f}"
        elif title == "Perfect":
            assert text == f"{rows.references[domain, 'perfect', 'clean']['return']:.3f}"
        else:
            runs = rows.runs[domain, ids[title]]
            if label == "ours":
                assert unmarked(text) == spread(runs["sampled_success"], 3)
            elif label == "in MuJoCo":
                assert text == spread(runs["physics_success"].dropna(), 3)
            else:  # the interval's ends are recomputed in test_recomputation
                low, high = rows.rate((domain, ids[title]))
                assert text == f"{low:.3f} to {high:.3f}, {len(runs)}"
    assert seen


@of_some_stores
def test_all_metrics(store: Store) -> None:
    rows, ids = rows_of(store), names(store)
    kinds = {"training": "train", "sampled": "sampled", "greedy": "greedy"}
    for title, label, column, text in entries(store, tables.all_metrics(stored(store))):
        cell: Cell = ids[title], ids[column]
        quantity = "success" if cell[0] in ROBOT else "return"
        if label == "KL, nats":
            assert text == spread(rows.runs[cell]["sampled_belief_kl"].dropna(), 3)
        else:
            metric = f"{kinds[label.removesuffix(' *')]}_{quantity}"
            assert label.endswith(" *") == (metric == METRICS[cell[0]])
            assert text == spread(rows.runs[cell][metric])


@of_some_stores
def test_reference_policies(store: Store) -> None:
    rows, ids = rows_of(store), names(store)
    starts = {"clean start": "clean", "hidden first action": "hidden-first-action"}
    for title, label, column, text in entries(store, tables.reference_policies(stored(store))):
        if column != "paper":
            row = rows.references[ids[title], label.lower().replace(" ", "-"), starts[column]]
            assert text == f"{row['return']:.3f}±{1.96 * row['return_se']:.3f}"


@of_some_stores
def test_habits(store: Store) -> None:
    rows, table = rows_of(store), tables.policies_habits(stored(store))
    agents = {title: agent for agent, title in stored(store).agent_titles.items()}
    habits = {habit.asks: habit for habit in HABITS}
    asks = ""
    for first, *texts in table.rows:
        asks = first or asks
        for title, text in zip(table.columns[1:], texts, strict=True):
            if asks.endswith(", policies") or text in ("–", ""):
                continue
            habit = habits[asks]
            shares = 100 * rows.runs[habit.domain, agents[title]][f"habit_{habit.id}"].dropna()
            assert text == (f"{shares.mean():.0f}" if first else f"{shares.min():.0f}-{shares.max():.0f}")


@of_some_stores
def test_collapses(store: Store) -> None:
    rows, ids, found = rows_of(store), names(store), stored(store)
    for title, label, column, text in entries(store, tables.success_collapses(found, found.scores)):
        curves = [Lost(curve) for curve in rows.curves[ids[title], ids[column]]]
        lost = [curve for curve in curves if curve.points.any()]
        expected = {
            "collapses": f"{sum(c.falls for c in curves)} ({sum(c.returns for c in curves)})",
            "end lost": f"{sum(c.falls > c.returns for c in curves)} of {len(curves)}",
            "nats, lost": f"{np.mean([c.entropy[c.points].mean() for c in lost]):.2f}" if lost else "",
            "steps, lost": f"{np.mean([np.nanmean(c.lengths[c.points]) for c in lost]):.0f}" if lost else "",
            "last fifth": spread(np.array([c.late for c in curves])),
        }
        assert text == expected[label]


class Lost:
    """The points of a curve at which success is .01 or less, after it was .2 or more and before it is again."""

    def __init__(self, curve: pd.DataFrame) -> None:
        curve = curve[curve["episodes"] >= 100]
        success = curve["success_100"].to_numpy()
        # 1 where it is learnt, -1 where it is lost, and in between what it was before.
        sign = (
            pd.Series(np.select([success >= 0.2, success <= 0.01], [1.0, -1.0], np.nan)).ffill().fillna(-1.0)
        )
        changes = np.diff(sign.to_numpy(), prepend=-1.0)
        learnt = np.flatnonzero(changes > 0)
        self.falls = int((changes < 0).sum())
        self.returns = max(len(learnt) - 1, 0)
        after = np.arange(len(success)) > (learnt[0] if len(learnt) else len(success))
        self.points = (sign.to_numpy() < 0) & after & (success <= 0.01)
        self.entropy = curve["entropy"].to_numpy()
        episodes = curve["episodes"].diff().to_numpy()
        ended = np.where(episodes > 0, episodes, np.nan)
        self.lengths = curve["env_steps"].diff().to_numpy() / ended
        steps = curve["env_steps"].to_numpy()
        late = steps >= 0.8 * steps[-1]
        self.late = np.trapezoid(success[late], steps[late]) / (steps[-1] - steps[late][0])
