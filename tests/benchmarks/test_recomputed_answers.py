"""What README says in a sentence each, counted once more from parquet alone (see recomputed_claims.py)."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bgn.analysis import answers
from tests.benchmarks import published_rows
from tests.benchmarks.published_rows import Rows
from tests.benchmarks.published_stores import Store, stored
from tests.benchmarks.recomputed_claims import BGN, ROBOT, nine_tenths, shown, steps_to
from tests.benchmarks.recomputed_statistics import METRICS, TOLERANCES

STORES = [("laptop", "calibrated"), ("short-robots", "calibrated"), ("search", "search-plain")]
of_some_stores = pytest.mark.parametrize("store", STORES, ids="/".join)


@of_some_stores
def test_speed_of_learning(store: Store) -> None:
    rows, medians = published_rows.read(*store), []
    for domain in METRICS:
        level, curves = nine_tenths(rows, domain), [rows.curves.get((domain, a)) for a in (BGN, "ah-ch")]
        if level is not None and all(curves):
            steps = [sorted(steps_to(c, shown(domain), level) for c in of_agent) for of_agent in curves]
            medians.append(
                [values[len(values) // 2] for values in steps]
            )  # the upper one, which may be infinite
    sooner, later = (sum(sign * a < sign * b for a, b in medians) for sign in (1, -1))
    said = f"in {sooner} of {len(medians)} domains, later in {later}" if medians else "No domain is stored"
    assert said in answers.speed_of_learning(stored(store).scores)


@of_some_stores
def test_grounding(store: Store) -> None:
    rows = published_rows.read(*store)
    known = [
        d for d in METRICS if (d, BGN) in rows.runs and rows.runs[d, BGN]["sampled_belief_kl"].notna().any()
    ]
    close = sum(rows.runs[d, BGN]["sampled_belief_kl"].mean() < 0.1 for d in known)
    gains = [
        rows.values((d, BGN)).mean() - rows.values((d, "ah-ch")).mean()
        for d in known
        if (d, "ah-ch") in rows.runs
    ]
    text = answers.grounding(stored(store).scores)
    assert f"less than 0.1 nats in {close} of {len(known)} domains" in text
    assert f"above Ah-Ch's in {np.sum(np.array(gains) > 0)} of {len(gains)}." in text


@of_some_stores
def test_robots_that_succeed_always(store: Store) -> None:
    rows = published_rows.read(*store)
    titles = {domain.id: domain.title for domain in stored(store).domains}
    always = {cell: sure(rows, cell) for cell in rows.runs if cell[0] in ROBOT and not rows.missing(cell)}
    counts = []
    for domain in [d for d in ROBOT if d in titles]:
        of_domain = [perfect for cell, perfect in always.items() if cell[0] == domain]
        counts.append(f"{titles[domain]} {sum(of_domain)} of {len(of_domain)}")
    ours = sum(always.get((domain, BGN), False) for domain in ROBOT)
    said = (
        f"succeed in at least 99% of episodes in {ours} of {len(counts)} domains; "
        f"of all agents stored, {', '.join(counts)} are."
    )
    assert said in answers.robots(stored(store).scores)


@pytest.mark.parametrize("store", [*STORES, ("overnight", "reproduction")], ids="/".join)
def test_who_loses_what_was_learnt(store: Store) -> None:
    rows, said = published_rows.read(*store), answers.lost_success(stored(store), stored(store).scores)
    fell = {}
    for agent, title in stored(store).agent_titles.items():
        curves = [c for domain in ROBOT for c in rows.curves.get((domain, agent), [])]
        if curves:
            fell[title] = sum(map(falls_to_nothing, curves)), len(curves)
    for title, (count, runs) in fell.items():
        assert (f"{count} of {runs} runs of {title}" if count else f"{runs} of {title}") in said
    assert ("No runs" in said) == (sum(count for count, _ in fell.values()) == 0)


def falls_to_nothing(curve: pd.DataFrame) -> bool:
    """Say whether success is .01 or less anywhere after it was .2 or more, 100 episodes behind each point."""
    success = curve.loc[curve["episodes"] >= 100, "success_100"].to_numpy()
    learnt = np.flatnonzero(success >= 0.2)
    return bool(len(learnt) and (success[learnt[0] :] <= 0.01).any())


def sure(rows: Rows, cell: tuple[str, str]) -> bool:
    """Say whether a cell is shown to succeed always, up to the tolerance."""
    return bool(rows.rate(cell)[0] >= 1 - TOLERANCES[cell[0]])
