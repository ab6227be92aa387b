"""Verdict and statistic of every claim computed once more, from parquet alone (see recomputed_claims.py)."""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pandas as pd
import pytest

from benchmarks.pooled import PooledEvidence
from bgn.analysis import criteria
from bgn.analysis.claims import CLAIMS as CLAIMS_AS_DATA
from bgn.analysis.claims import judge_claims
from bgn.analysis.scores import Scores
from tests.benchmarks import published_rows, recomputed_claims
from tests.benchmarks.published_rows import Rows
from tests.benchmarks.published_stores import POOLED, Store, stored
from tests.benchmarks.recomputed_claims import CLAIMS, by_table_6

LENDER = ("laptop", "calibrated")
STORES = [POOLED, *published_rows.stores()]
of_every_store = pytest.mark.parametrize("store", STORES, ids="/".join)


@functools.cache
def rows(store: Store) -> Rows:
    """Return a store as its shards say."""
    return published_rows.longest(stored(store).preset)[0] if store == POOLED else published_rows.read(*store)


def claims_of(scores: Scores) -> pd.DataFrame:
    """Return what the tables print of the claims, by name."""
    return judge_claims(scores).set_index("claim")


@functools.cache
def scores_at_any_length(store: Store) -> Scores:
    """Return a store's rows as if the paper's runs had been as short, so that every criterion meets rows.

    Reference rows, which are not trained, are lent to stores that have none, for the domains that they have.
    """
    scores = stored(store).scores
    domains = [dataclasses.replace(domain, horizon=0) for domain in scores.domains]
    lent = stored(LENDER).references
    lent = lent[lent["domain"].isin([domain.id for domain in domains])]
    references = scores.references if len(scores.references) else lent
    return dataclasses.replace(scores, domains=domains, references=references)


@functools.cache
def rows_at_any_length(store: Store) -> Rows:
    """Return the same from the shards."""
    ours = rows(store)
    lent = {key: row for key, row in rows(LENDER).references.items() if key[0] in ours.domains()}
    return ours.at_any_length(lent)


def differences(claims: pd.DataFrame, ours: Rows) -> list[str]:
    """Return the claims whose verdict or statistic is another than the one printed."""
    found = []
    for name, question in CLAIMS.items():
        verdict, statistic = question.judge(ours)
        theirs = (claims.loc[name, "verdict"], claims.loc[name, "statistic"])
        # A reason stands where nothing is measured; what is bootstrapped has a test of its own below.
        same = verdict == theirs[0] if statistic is None else (verdict, statistic) == theirs
        if verdict is not None and not same:
            found.append(f"{name}: printed {theirs}, recomputed {(verdict, statistic)}")
    return found


@of_every_store
def test_verdicts_and_statistics(store: Store) -> None:
    assert differences(stored(store).claims.set_index("claim"), rows(store)) == []


@of_every_store
def test_verdicts_and_statistics_at_any_length(store: Store) -> None:
    assert differences(claims_of(scores_at_any_length(store)), rows_at_any_length(store)) == []


@pytest.mark.parametrize("store", [POOLED, LENDER, ("short-robots", "calibrated")], ids="/".join)
def test_what_is_measured_of_each_run(store: Store) -> None:
    """Compare values too: a verdict may be right for a wrong one."""
    scores, ours = scores_at_any_length(store), rows_at_any_length(store)
    for cell, curves in ours.curves.items():
        column, level = recomputed_claims.shown(cell[0]), recomputed_claims.nine_tenths(ours, cell[0])
        steps = (
            [] if level is None else [recomputed_claims.steps_to(curve, column, level) for curve in curves]
        )
        assert criteria.learning_steps(scores, cell) == pytest.approx(steps)
        assert criteria.success_interval(scores, cell) == pytest.approx(ours.rate(cell))
        theirs = scores.cell_curves(cell)
        falls = [recomputed_claims.fall(curve, column) for curve in curves]
        assert [criteria.fall(curve, column) for curve in theirs] == pytest.approx(falls)
        early = [recomputed_claims.early_fall(curve, 0.1) for curve in curves]
        expected = [np.nan if share is None else share for share in early]
        assert [criteria.early_fall(curve, 0.1) for curve in theirs] == pytest.approx(expected, nan_ok=True)


@of_every_store
def test_what_the_claims_rest_on(store: Store) -> None:
    claims, ours = stored(store).claims.set_index("claim"), rows(store)
    assert list(claims.index) == list(CLAIMS)
    for name, question in CLAIMS.items():
        run = [cell for cell in question.cells if cell in ours.runs]
        expected = {
            "cells": len(question.cells),
            "cells_run": len(run),
            "runs": from_to([len(ours.runs[cell]) for cell in run]),
            "env_steps": from_to([steps for cell in run for steps in ours.steps(cell)]),
            "by_table_6": by_table_6(question, ours),
        }
        assert claims.loc[name, list(expected)].to_dict() == expected, name


def from_to(numbers: list[int]) -> str:
    return " to ".join(f"{number:,}" for number in sorted({min(numbers), max(numbers)})) if numbers else ""


@pytest.mark.parametrize("store", [POOLED, LENDER], ids="/".join)
def test_verdicts_with_agents_exchanged(store: Store) -> None:
    """Judge the rows once more under shuffled names: what does not hold of one agent may hold of another."""
    scores, agents = scores_at_any_length(store), sorted({agent for _, agent in rows(store).runs})
    names = dict(zip(agents, np.random.default_rng(0).permutation(agents), strict=True))
    runs, curves = (frame.assign(agent=frame["agent"].map(names)) for frame in (scores.runs, scores.curves))
    exchanged = dataclasses.replace(scores, runs=runs, curves=curves)
    assert differences(claims_of(exchanged), rows_at_any_length(store).renamed(names)) == []


def test_a_single_seed_counts_as_missing() -> None:
    scores, ours, alone = scores_at_any_length(LENDER), rows_at_any_length(LENDER), ("two-bumps-1d", "ah-cb")
    runs = scores.runs
    dropped = (runs["domain"] == alone[0]) & (runs["agent"] == alone[1]) & (runs["seed"] > 0)
    claims = claims_of(dataclasses.replace(scores, runs=runs[~dropped]))
    first = ours.runs[alone][ours.runs[alone]["seed"] == 0]
    assert differences(claims, dataclasses.replace(ours, runs=ours.runs | {alone: first})) == []


@of_every_store
def test_the_share_of_the_gap(store: Store) -> None:
    (half,) = (claim for claim in CLAIMS_AS_DATA if claim.id == "recovers-half")
    claim = judge_claims(scores_at_any_length(store), [half]).iloc[0]
    if claim["verdict"] == "not run":
        return
    value, low, high = map(float, re.findall(r"-?(?:[0-9.]+|inf)", claim["statistic"]))
    ours, draws = recomputed_claims.recovered(rows(store))
    assert value == pytest.approx(ours, abs=0.0051)
    # Ends are the 2.5 % and 97.5 % quantiles of 2,000 draws: within four standard errors, .35 % each, of that rank.
    assert np.mean(draws <= low + 0.005) > 0.011
    assert np.mean(draws < low - 0.005) < 0.039
    assert np.mean(draws <= high + 0.005) > 0.961
    assert np.mean(draws < high - 0.005) < 0.989
    if min(abs(end - bound) for end in (low, high) for bound in (0.25, 0.75)) > 0.005:  # as printed, rounded
        apart = high < 0.25 or low > 0.75
        expected = "holds" if low >= 0.25 and high <= 0.75 else "does not hold" if apart else "inconclusive"
        assert claim["verdict"] == expected


def test_the_longest_budget_of_most_agents() -> None:
    found = stored(POOLED)
    assert isinstance(found, PooledEvidence)
    assert dict(found.budgets) == published_rows.longest(found.preset)[1]


def test_every_claim_is_put_to_rows() -> None:
    """Guard against recomputing nothing: all cells of every claim that is measured are stored somewhere."""
    asked = {name for name, question in CLAIMS.items() if question.cells}
    for store in STORES:
        asked -= {name for name in asked if not any(rows(store).missing(cell) for cell in CLAIMS[name].cells)}
    assert not asked
