from __future__ import annotations

import itertools
import math

import pandas as pd
import pytest

from bgn.agents.specs import AGENTS
from bgn.analysis import claims, criteria, paper
from bgn.analysis.criteria import Answer
from bgn.analysis.statistics import Sample, welch_p
from bgn.domains.episode_opening import CLEAN, HIDDEN
from tests.analysis._evidence import DOMAINS, STEPS, cell, curve, reference, scores

NEAR = [0.0, 0.002, -0.002, 0.001, -0.001]
ROBOTS = ("top-plate", "two-bumps-1d", "two-bumps-2d")


def around(value: float, n: int = 5) -> list[float]:
    return [value + offset for offset in NEAR[:n]]


def robots(**means: float) -> list[dict[str, object]]:
    """Return five seeds of each agent, named with underscores, at the same mean in all robot domains."""
    names = {
        "bgn": "ah-ch+bgn",
        "ab_cb": "ab-cb",
        "ab_cb_bgn": "ab-cb+bgn",
        "ah_ch": "ah-ch",
        "ah_cs": "ah-cs",
    }
    names["ah_cb"] = "ah-cb"
    return [
        row
        for d, (agent, mean) in itertools.product(ROBOTS, means.items())
        for row in cell(d, names[agent], around(mean))
    ]


def test_claims_are_well_formed() -> None:
    ids = [claim.id for claim in claims.CLAIMS]
    assert len(set(ids)) == len(ids)
    known = {domain.id for domain in DOMAINS}
    for claim in claims.CLAIMS:
        assert claim.quote == " ".join(claim.quote.split())
        assert {domain for domain, _ in claim.criterion.cells} <= known
        assert {agent for _, agent in claim.criterion.cells} <= set(AGENTS)
        assert len(claim.asks) <= 72  # a line of the table


def test_alone_perfect_is_one_claim_over_all_tasks() -> None:
    (claim,) = (claim for claim in claims.CLAIMS if claim.id == "alone-perfect")
    assert (
        claim.quote == "Ah-Ch + BGN is the only agent that can achieve a perfect success rate in all tasks."
    )
    assert {domain for domain, _ in claim.criterion.cells} == set(ROBOTS)
    perfect = [1.0] * 5
    ours = [row for domain in ROBOTS for row in cell(domain, "ah-ch+bgn", perfect)]
    others = [row for d, a in itertools.product(ROBOTS, claims.OTHERS) for row in cell(d, a, around(0.5))]
    assert claim.criterion.judge(scores(ours + others)).answer is Answer.HOLDS
    # Another agent that is perfect in one or two tasks does not refute it; in all three it does.
    two = [row for row in others if row["agent"] != "ah-cs"]
    two += [row for d in ROBOTS[:2] for row in cell(d, "ah-cs", perfect)] + cell(
        ROBOTS[2], "ah-cs", around(0.5)
    )
    assert claim.criterion.judge(scores(ours + two)).answer is Answer.HOLDS
    rest = [row for row in two if row["agent"] != "ah-cs"]
    all_three = rest + [row for domain in ROBOTS for row in cell(domain, "ah-cs", perfect)]
    assert claim.criterion.judge(scores(ours + all_three)).answer is Answer.FAILS
    # Nor is the agent itself perfect if one task is missed.
    missed = [row for row in ours if row["domain"] != ROBOTS[0]] + cell(ROBOTS[0], "ah-ch+bgn", around(0.9))
    assert claim.criterion.judge(scores(missed + others)).answer is Answer.FAILS
    assert claim.criterion.judge(scores(ours)).answer is Answer.MISSING


def test_better_holds_fails_and_stays_open() -> None:
    better = criteria.Better(("ah-ch+bgn",), ("ah-ch",), ("hallway", "hallway-2"))
    ours = cell("hallway", "ah-ch+bgn", around(0.5)) + cell("hallway-2", "ah-ch+bgn", around(0.5))
    second = cell("hallway-2", "ah-ch", around(0.3))
    assert better.judge(scores(ours + cell("hallway", "ah-ch", around(0.3)) + second)).answer is Answer.HOLDS
    # As good within the tolerance in one domain: contradicted.
    assert better.judge(scores(ours + cell("hallway", "ah-ch", around(0.5)) + second)).answer is Answer.FAILS
    # Significantly better by less than the tolerance is better all the same.
    assert better.judge(scores(ours + cell("hallway", "ah-ch", around(0.45)) + second)).answer is Answer.HOLDS
    noisy = cell("hallway", "ah-ch", [0.1, 0.9, 0.2, 0.8, 0.5])
    assert better.judge(scores(ours + noisy + second)).answer is Answer.INCONCLUSIVE


def test_short_and_missing_cells_cannot_make_a_claim_hold() -> None:
    better = criteria.Better(("ah-ch+bgn",), ("ah-ch",), ("hallway",))
    ours, low = cell("hallway", "ah-ch+bgn", around(0.5)), cell("hallway", "ah-ch", around(0.3))
    assert better.judge(scores(ours)).answer is Answer.MISSING
    assert better.judge(scores(ours + low[:1])).answer is Answer.MISSING  # a single seed has no spread
    short = cell("hallway", "ah-ch", around(0.3), STEPS - 1)
    assert better.judge(scores(ours + short)).answer is Answer.SHORT


def test_similar_and_order() -> None:
    similar = criteria.Similar(("ah-cs", "ah-cb"), ("hallway",))
    same = cell("hallway", "ah-cs", around(0.4)) + cell("hallway", "ah-cb", around(0.41))
    apart = cell("hallway", "ah-cs", around(0.4)) + cell("hallway", "ah-cb", around(0.6))
    assert similar.judge(scores(same)).answer is Answer.HOLDS
    assert similar.judge(scores(apart)).answer is Answer.FAILS
    varies = criteria.OrderVaries(("ah-cs", "ah-cb"), ("hallway", "hallway-2"))
    turned = apart + cell("hallway-2", "ah-cs", around(0.6)) + cell("hallway-2", "ah-cb", around(0.4))
    kept = apart + cell("hallway-2", "ah-cs", around(0.4)) + cell("hallway-2", "ah-cb", around(0.6))
    assert varies.judge(scores(turned)).answer is Answer.HOLDS
    assert varies.judge(scores(kept)).answer is Answer.INCONCLUSIVE


def test_matches_in_three_of_four() -> None:
    matches = criteria.MatchesIn("ah-ch", ("ah-cs",), claims.CLASSIC, 3)
    rows = [row for domain in claims.CLASSIC for row in cell(domain, "ah-cs", around(0.5))]
    for means, answer in (((0.2, 0.5, 0.5, 0.5), Answer.HOLDS), ((0.2, 0.2, 0.5, 0.5), Answer.FAILS)):
        pairs = zip(claims.CLASSIC, means, strict=True)
        ours = [row for domain, mean in pairs for row in cell(domain, "ah-ch", around(mean))]
        assert matches.judge(scores(rows + ours)).answer is answer


def test_three_of_four_is_a_partial_conjunction() -> None:
    """The third smallest p of four counts twice: any three of the four would do."""
    matches = criteria.MatchesIn("ah-ch", ("ah-cs",), claims.CLASSIC, 3)
    rows = []
    for domain, gap in zip(claims.CLASSIC, (0.0, 0.0, 0.0, 1.0), strict=True):
        scale = 1 if domain.startswith("hallway") else 20  # in units of the domain's tolerance
        for agent, mean in (("ah-ch", -gap), ("ah-cs", 0.0)):
            values = [scale * (mean + side * 0.01) for side in (-1, 1)]
            rows += cell(domain, agent, values, sampled_return_se=0.0, greedy_return_se=0.0)
    # Equal means of two seeds .01 to either side: .05 is 3.54 errors of the difference, p = .036 with 2 degrees of
    # freedom. Each of three domains is matched by itself; that three are is significant at 2 x .036 only.
    p = welch_p(Sample(0.0, 0.01, 2), Sample(0.0, 0.01, 2), shift=-0.05, tail="greater")
    assert 0.05 / 2 < p < 0.05
    assert matches.judge(scores(rows)) == criteria.Finding(
        Answer.INCONCLUSIVE, "matches in 0 of 4 domains, worse in 1"
    )


def test_one_cell_of_many_contradicts_after_a_correction() -> None:
    """A cell that is beyond the level by itself may be so by chance when many are asked."""
    agents = ("ah-ch", "ah-cs", "ah-cb")
    alone = criteria.SucceedsBelow(agents[:1], ROBOTS[:1], 0.5)
    among = criteria.SucceedsBelow(agents, ROBOTS, 0.5)
    rows = [row for d, a in itertools.product(ROBOTS, agents) for row in cell(d, a, around(0.2))]
    rows = [r for r in rows if (r["domain"], r["agent"]) != (ROBOTS[0], agents[0])]
    rows += cell(
        ROBOTS[0], agents[0], [0.52, 0.6, 0.7, 0.55, 0.63]
    )  # t = 3.5 with 4 degrees of freedom: p = .012
    assert alone.judge(scores(rows)).answer is Answer.FAILS
    assert among.judge(scores(rows)) == criteria.Finding(Answer.INCONCLUSIVE, "8 of 9 cells below 0.50")


def test_too_few_runs_to_be_faster() -> None:
    """Of three runs and three, no order is rarer than 1 in 20."""
    faster = criteria.LearnsFaster("ah-ch+bgn", "ah-ch", ("top-plate",))
    runs, curves = [], []
    for agent, late in (("ah-ch+bgn", 100), ("ah-ch", 900)):
        runs += cell("top-plate", agent, [1.0] * 3)
        curves += [curve("top-plate", agent, seed, [0, late, 1000], [0.0, 1.0, 1.0]) for seed in range(3)]
    rows = [reference("top-plate", "perfect", CLEAN, 1.0), reference("top-plate", "random", CLEAN, 0.0)]
    found = faster.judge(scores(runs, curves, rows))
    assert found == criteria.Finding(
        Answer.INCONCLUSIVE, "faster in 0 of 1 domains, too few runs to tell in 1"
    )


def test_habits_are_judged_by_policy() -> None:
    (claim,) = (claim for claim in claims.CLAIMS if claim.id == "moves-right-first")
    column, cases = "habit_moves_right_first", 507.0

    def judged(*shares: float, steps: int = STEPS) -> criteria.Finding:
        rows = cell("two-bumps-1d", "ah-ch+bgn", [1.0] * len(shares), steps)
        for row, share in zip(rows, shares, strict=True):
            row |= {column: share, f"{column}_cases": cases}
        return claim.criterion.judge(scores(rows))

    assert judged(1.0, 1.0).answer is Answer.HOLDS
    assert judged(0.7, 0.75, 0.72) == criteria.Finding(
        Answer.FAILS, "in 72% of its cases, 70% to 75% by policy; 3 policies"
    )
    assert judged(1.0, 0.2).answer is Answer.INCONCLUSIVE  # seeds differ
    assert judged(0.7, 0.75, 0.72, steps=STEPS - 1).answer is Answer.SHORT
    assert judged(0.7, math.nan).answer is Answer.NOT_MEASURED
    assert judged(0.7).answer is Answer.NOT_MEASURED


def test_domains_are_lost_by_a_correction_over_all_comparisons() -> None:
    # Two seeds .007 to either side: each mean has an error of .007, their difference one of .0099. A gap of .06 is 6.06
    # of it, p = .013 with 2 degrees of freedom: significant among a domain's 2 comparisons, not among all 8. It is
    # beyond the tolerance, .05, so no match either.
    matches = criteria.MatchesIn("ah-ch", ("ah-cs", "ah-cb"), claims.CLASSIC, 3)
    rows = []
    for domain, scale in zip(
        claims.CLASSIC, (1, 1, 20, 20), strict=True
    ):  # in units of the domain's tolerance
        for agent, mean in (("ah-ch", 0.0), ("ah-cs", 0.06), ("ah-cb", 0.06)):
            values = [scale * (mean + side * 0.007) for side in (-1, 1)]
            rows += cell(domain, agent, values, sampled_return_se=0.0, greedy_return_se=0.0)
    found = matches.judge(scores(rows))
    p = welch_p(Sample(0.0, 0.007, 2), Sample(0.06, 0.007, 2), tail="less")
    assert 0.05 / 8 < p < 0.05 / 2
    assert found == criteria.Finding(Answer.INCONCLUSIVE, "matches in 0 of 4 domains, worse in 0")


def test_half_of_the_gap() -> None:
    (claim,) = (claim for claim in claims.CLAIMS if claim.id == "recovers-half")
    for recovered, answer in ((0.7, Answer.HOLDS), (0.99, Answer.FAILS)):
        found = claim.criterion.judge(scores(robots(ab_cb=0.5, ab_cb_bgn=recovered, bgn=0.9)))
        assert found.answer is answer
    assert claim.criterion.judge(scores(robots(ab_cb=0.9, bgn=0.9))).answer is Answer.MISSING


def test_against_the_reference_rows() -> None:
    rows = [reference("hallway", "sarsop", CLEAN, 0.52, return_se=0.001, return_sd=0.1)]
    matches = criteria.MatchesReference(("ab-cb",), ("hallway",))
    assert matches.judge(scores(cell("hallway", "ab-cb", around(0.53)), (), rows)).answer is Answer.HOLDS
    assert matches.judge(scores(cell("hallway", "ab-cb", around(0.3)), (), rows)).answer is Answer.FAILS
    # (14 + 62) / (18 + 62) = .95 of the way from Random to SARSOP, as Table 7 would print.
    rows = [
        reference("rocksample-4-4", "sarsop", CLEAN, 18.0),
        reference("rocksample-4-4", "random", HIDDEN, -62.0),
    ]
    close = criteria.ComesClose(("ab-cb",), ("rocksample-4-4",), 0.9)
    assert close.judge(scores(cell("rocksample-4-4", "ab-cb", around(14.0)), (), rows)).answer is Answer.HOLDS
    assert close.judge(scores(cell("rocksample-4-4", "ab-cb", around(6.0)), (), rows)).answer is Answer.FAILS


def test_nothing_is_compared_without_reference_rows() -> None:
    sarsop = [reference("hallway", "sarsop", CLEAN, 0.52, return_se=0.001, return_sd=0.1)]
    matches = criteria.MatchesReference(("ab-cb",), ("hallway", "hallway-2"))
    rows = cell("hallway", "ab-cb", around(0.53)) + cell("hallway-2", "ab-cb", around(0.3))
    none = matches.judge(scores(rows))
    assert none == criteria.Finding(Answer.MISSING, "no reference rows of any domain")
    some = matches.judge(scores(rows, (), sarsop))
    text = "1 of 2 cells equivalent, 0 below; no reference rows of hallway-2"
    assert some == criteria.Finding(Answer.MISSING, text)
    # What is there may contradict all the same.
    low = cell("hallway", "ab-cb", around(0.3)) + rows[5:]
    assert matches.judge(scores(low, (), sarsop)).answer is Answer.FAILS
    # A missing row weighs more than short runs: longer ones could not be compared either.
    short = cell("hallway", "ab-cb", around(0.53), STEPS - 1) + rows[5:]
    assert matches.judge(scores(short)).answer is Answer.MISSING

    close = criteria.ComesClose(("ab-cb",), ("rocksample-4-4",), 0.9)
    rows = cell("rocksample-4-4", "ab-cb", around(14.0))
    lacking = criteria.Finding(Answer.MISSING, "no reference rows of rocksample-4-4")
    assert close.judge(scores(rows)) == lacking
    assert close.judge(scores(rows, (), [reference("rocksample-4-4", "sarsop", CLEAN, 18.0)])) == lacking

    faster = criteria.LearnsFaster("ah-ch+bgn", "ah-ch", ("top-plate",))
    rows = cell("top-plate", "ah-ch+bgn", [1.0] * 4) + cell("top-plate", "ah-ch", [0.5] * 4)
    found = faster.judge(scores(rows))
    assert found == criteria.Finding(Answer.MISSING, "no reference rows of top-plate")


def test_a_normalised_spread_is_not_below_the_error_of_measuring() -> None:
    # Random -62 and SARSOP 18 lie 80 apart. Three equal seeds measured to within 4 have t(.975, 2) = 4.303 times
    # 4 / sqrt(3) = 9.94 to either side of the mean: a normalised .95 ± .124 reaches below .9, .95 ± 0 would not.
    domain = "rocksample-4-4"
    rows = [reference(domain, "sarsop", CLEAN, 18.0), reference(domain, "random", HIDDEN, -62.0)]
    close = criteria.ComesClose(("ab-cb",), (domain,), 0.9)
    rough = scores(cell(domain, "ab-cb", [14.0] * 3, sampled_return_se=4.0), (), rows)
    assert close.judge(rough) == criteria.Finding(Answer.INCONCLUSIVE, "0 of 1 cells above 0.90")
    # Measured to within 1 it is .95 ± .031.
    exact = scores(cell(domain, "ab-cb", [14.0] * 3, sampled_return_se=1.0), (), rows)
    assert close.judge(exact).answer is Answer.HOLDS
    # A stored error of divergences would count too: .09 ± 4.303 * .01 / sqrt(3) = .09 ± .025 reaches above .1.
    accurate = criteria.ReconstructsBelief("ah-ch+bgn", ("two-bumps-1d",), 0.1)
    runs = cell("two-bumps-1d", "ah-ch+bgn", [1.0] * 3, sampled_belief_kl=0.09)
    assert accurate.judge(scores(runs)).answer is Answer.HOLDS
    runs = [row | {"sampled_belief_kl_se": 0.01} for row in runs]
    assert accurate.judge(scores(runs)).answer is Answer.INCONCLUSIVE


def test_learning_faster_by_ranks() -> None:
    faster = criteria.LearnsFaster("ah-ch+bgn", "ah-ch", ("top-plate",))
    rows = cell("top-plate", "ah-ch+bgn", [1.0] * 4) + cell("top-plate", "ah-ch", [0.5] * 4)
    rows_of_references = [
        reference("top-plate", "random", CLEAN, 0.0),
        reference("top-plate", "perfect", CLEAN, 1.0),
    ]
    quick = [curve("top-plate", "ah-ch+bgn", s, [100, 200 + s], [0.0, 1.0]) for s in range(4)]
    never = [curve("top-plate", "ah-ch", s, [100, 1000], [0.0, 0.5]) for s in range(4)]
    assert faster.judge(scores(rows, quick + never, rows_of_references)).answer is Answer.HOLDS
    turned = criteria.LearnsFaster("ah-ch", "ah-ch+bgn", ("top-plate",))
    assert turned.judge(scores(rows, quick + never, rows_of_references)).answer is Answer.FAILS


def test_falls_by_hand() -> None:
    # Second half of the steps: from 500 on the curve stands .5, 0 and .5 below its best: mean .25 over two trapezia.
    fallen = curve("top-plate", "ah-ch", 0, [0, 500, 750, 1000], [1.0, 0.5, 1.0, 0.5])
    assert criteria.fall(fallen, "success_100") == pytest.approx(0.25)
    rising = curve("top-plate", "ah-ch", 0, [0, 500, 1000], [0.0, 0.5, 1.0])
    assert criteria.fall(rising, "success_100") == 0.0
    # A first episode that happened to succeed is no best to fall from: else it would be .75.
    early = curve(
        "top-plate",
        "ah-ch",
        0,
        [0, 250, 500, 750, 1000],
        [1.0, 0.5, 0.0, 0.5, 0.0],
        episodes=[1, 100, 200, 300, 400],
    )
    assert criteria.fall(early, "success_100") == pytest.approx(0.25)
    assert math.isnan(criteria.fall(early[:1], "success_100"))


def test_belief_criteria() -> None:
    good = cell("two-bumps-1d", "ah-ch+bgn", [1.0] * 5, sampled_belief_kl=0.02)
    bad = cell("two-bumps-1d", "ah-ch+bgn", [1.0] * 5, sampled_belief_kl=0.5)
    good = [row | {"sampled_belief_kl": 0.02 + 0.001 * i} for i, row in enumerate(good)]
    bad = [row | {"sampled_belief_kl": 0.5 + 0.001 * i} for i, row in enumerate(bad)]
    accurate = criteria.ReconstructsBelief("ah-ch+bgn", ("two-bumps-1d",), 0.1)
    assert accurate.judge(scores(good)).answer is Answer.HOLDS
    assert accurate.judge(scores(bad)).answer is Answer.FAILS
    goes = criteria.BeliefGoesWithScore(("ah-ch+bgn",), ("two-bumps-1d",))
    falling = [
        row | {"sampled_belief_kl": float(i), "sampled_success": 1 - 0.1 * i} for i, row in enumerate(good)
    ]
    assert goes.judge(scores(falling)).answer is Answer.HOLDS
    rising = [row | {"sampled_belief_kl": float(i), "sampled_success": 0.1 * i} for i, row in enumerate(good)]
    assert goes.judge(scores(rising)).answer is Answer.FAILS


def test_belief_goes_with_score_in_all_cells_or_none() -> None:
    goes = criteria.BeliefGoesWithScore(("ah-ch+bgn", "ab-cb+bgn"), ("two-bumps-1d", "two-bumps-2d"))

    def falling(domain: str, agent: str, *, steps: int = STEPS) -> list[dict[str, object]]:
        rows = cell(domain, agent, [1.0, 0.9, 0.8, 0.7], steps)
        return [row | {"sampled_belief_kl": 0.1 * i} for i, row in enumerate(rows)]

    pairs = list(itertools.product(goes.domains, goes.agents))
    rows = [row for pair in pairs for row in falling(*pair)]
    assert goes.judge(scores(rows)).answer is Answer.HOLDS
    missing = goes.judge(scores(rows[:-4]))
    # However sure the rest: 12 runs, perfectly ordered.
    text = "rank correlation -1.00 over 12 runs, p = 0.000"
    assert missing == criteria.Finding(Answer.MISSING, text)
    short = falling(*pairs[-1], steps=STEPS - 1)
    assert goes.judge(scores(rows[:-4] + short)) == criteria.Finding(Answer.SHORT, text)
    unmeasured = [row | {"sampled_belief_kl": math.nan} for row in rows[-4:]]
    assert goes.judge(scores(rows[:-4] + unmeasured)) == criteria.Finding(Answer.MISSING, text)


def test_early_fall_by_hand() -> None:
    # The loss falls from 4 to 1; it stands at 3 when success first exceeds .1: a third of the fall.
    learnt = curve(
        "top-plate", "ah-ch+bgn", 0, [1, 2, 3, 4], [0.0, 0.2, 0.6, 1.0], belief_cross_entropy=[4, 3, 2, 1]
    )
    assert criteria.early_fall(learnt, 0.1) == pytest.approx(1 / 3)


def test_the_paper_s_own_numbers_are_asked_too() -> None:
    judged = {claim.id: claims.own_numbers(claim, DOMAINS) for claim in claims.CLAIMS}
    two_groups, outperforms = judged["two-groups"], judged["outperforms-all"]
    assert two_groups is not None
    assert two_groups.answer is Answer.HOLDS
    # Table 6 has Ab-Cb above Ah-Ch+BGN in Hallway-2 and RockSample[5,5].
    assert outperforms is not None
    assert outperforms.answer is Answer.FAILS
    assert judged["alone-perfect"] is None
    assert (
        claims.PrintedScores(pd.DataFrame(), pd.DataFrame(), pd.DataFrame(), DOMAINS)
        .sample(("hallway", "ah-ch"))
        .n
        == paper.SEEDS
    )


def test_every_claim_has_a_row_whatever_is_stored() -> None:
    empty = scores([])
    table = claims.judge_claims(empty)
    assert len(table) == len(claims.CLAIMS)
    of_models = table["claim"].isin(["classic-penalises", "robots-reward-success"])  # which need no runs
    assert table.loc[of_models, "verdict"].tolist() == [Answer.FAILS.value, Answer.HOLDS.value]
    assert set(table.loc[~of_models, "verdict"]) == {Answer.MISSING.value, Answer.NOT_MEASURED.value}
    some = claims.judge_claims(scores(robots(bgn=0.9, ab_cb=0.5)))
    row = some.set_index("claim").loc["belief-agent-worse"]
    assert (row["verdict"], row["runs"], row["env_steps"], row["cells_run"]) == ("holds", "5", "1,000", 6)
