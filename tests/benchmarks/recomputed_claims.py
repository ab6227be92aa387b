"""The paper's claims judged once more, from published rows: rules of the documents, written out again.

A claim *holds* if each of its comparisons is significant by itself, and *does not hold* if one is significantly
contradicted, after Holm's correction over all comparisons of the claim. Cells or reference rows that are missing, and
runs shorter than the paper's, leave a claim *not run* or *short* unless what is there contradicts it.
"""

from __future__ import annotations

import itertools
import json
import pathlib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from tests.benchmarks.published_rows import Cell, Rows, Table6
from tests.benchmarks.recomputed_statistics import (
    METRICS,
    TABLE_6,
    TOLERANCES,
    Sample,
    bootstrap,
    holm,
    rank_sum,
    sides,
    sides_of_rate,
    tost,
    welch,
    within_groups,
)

HALLWAYS, ROCKSAMPLES = ("hallway", "hallway-2"), ("rocksample-4-4", "rocksample-5-5")
CLASSIC, ROBOT = HALLWAYS + ROCKSAMPLES, ("top-plate", "two-bumps-1d", "two-bumps-2d")
HISTORY = ("ah-cs", "ah-cb", "ah-ch")
OTHERS = (*HISTORY, "ab-cb")
BGN = "ah-ch+bgn"
FILES = pathlib.Path(__file__).parents[2] / "data" / "pomdp_files"
ALPHA = 0.05
#: Tests against a bound are one-sided, at the level at which a 95 % interval lies beside it.
EITHER_SIDE = ALPHA / 2

Finding = tuple[str | None, str | None]
"""Verdict and statistic; None where they are not told here."""
Judge = Callable[[Rows], Finding]


@dataclass(frozen=True)
class Question:
    """What a claim asks of its cells."""

    cells: tuple[Cell, ...]
    judge: Judge
    asks_table_6: bool = False
    """Whether means, deviations and numbers of seeds are all it needs."""


def _cells(domains: Iterable[str], agents: Iterable[str]) -> tuple[Cell, ...]:
    return tuple(itertools.product(domains, agents))


def better(higher: Sequence[str], lower: Sequence[str], domains: Sequence[str]) -> Question:
    """Ask whether every one of some agents is above each of the others."""
    cells = _cells(domains, (*higher, *lower))
    pairs = [((d, a), (d, b)) for d, a, b in itertools.product(domains, higher, lower)]

    def judge(rows: Rows) -> Finding:
        samples = [(rows.sample(a), rows.sample(b), a[0]) for a, b in pairs if rows.judged(a, b)]
        above = [welch(a, b, "greater") < ALPHA for a, b, _ in samples]
        below = holm([welch(a, b, "less") for a, b, _ in samples], len(pairs))
        alike = holm([tost(a, b, TOLERANCES[d]) for a, b, d in samples], len(pairs))
        # Better by less than the tolerance is better all the same.
        against = sum(not a and (b < ALPHA or e < ALPHA) for a, b, e in zip(above, below, alike, strict=True))
        text = _significant(above, pairs)
        return _conclude(rows, cells, above, len(pairs), against, text + _contradict(against))

    return Question(cells, judge, asks_table_6=True)


def similar(agents: Sequence[str], domains: Sequence[str], tolerance: float | None = None) -> Question:
    """Ask whether agents are equivalent, two by two."""
    cells = _cells(domains, agents)
    pairs = [((d, a), (d, b)) for d in domains for a, b in itertools.combinations(agents, 2)]

    def judge(rows: Rows) -> Finding:
        samples = [(rows.sample(a), rows.sample(b), a[0]) for a, b in pairs if rows.judged(a, b)]
        alike = [tost(a, b, tolerance or TOLERANCES[d]) < ALPHA for a, b, d in samples]
        unlike = holm([welch(a, b, "two-sided") for a, b, _ in samples], len(pairs))
        against = sum(p < ALPHA and not e for p, e in zip(unlike, alike, strict=True))
        text = f"{sum(alike)} of {len(pairs)} pairs equivalent, {against} differ"
        return _conclude(rows, cells, alike, len(pairs), against, text)

    return Question(cells, judge, asks_table_6=True)


def matches_in(agent: str, others: Sequence[str], domains: Sequence[str], enough: int) -> Question:
    """Ask whether an agent is no worse than others, by more than the tolerance, in so many domains."""
    cells = _cells(domains, (agent, *others))

    def judge(rows: Rows) -> Finding:
        met = [(d, o) for d, o in _cells(domains, others) if rows.judged((d, agent), (d, o))]
        duels = [(rows.sample((d, agent)), rows.sample((d, o))) for d, o in met]
        p_below = holm([welch(a, b, "less") for a, b in duels], len(domains) * len(others))
        p_close = {d: [1.0] * len(others) for d in domains}
        lost = set()
        for (d, o), (a, b), p in zip(met, duels, p_below, strict=True):
            p_close[d][others.index(o)] = close = welch(a, b, "greater", -TOLERANCES[d])
            lost |= {d} if p < ALPHA and not close < ALPHA else set()
        p_matched = np.sort([np.nan_to_num(np.max(p), nan=1.0) for p in p_close.values()])
        # That at least u of m domains are matched: the u-th smallest p, times the m - u + 1 largest that remain.
        surely = [u for u in range(1, len(domains) + 1) if (len(domains) - u + 1) * p_matched[u - 1] < ALPHA]
        matched, worse = max(surely, default=0), len(lost)
        text = f"matches in {matched} of {len(domains)} domains, worse in {worse}"
        if matched >= enough:  # whatever the other domains would say
            return "holds", text
        if len(domains) - worse < enough:
            return "does not hold", text
        return _lacking(rows, cells) or "inconclusive", text

    return Question(cells, judge, asks_table_6=True)


def order_varies(agents: Sequence[str], domains: Sequence[str]) -> Question:
    """Ask whether two agents differ one way in one domain and the other way in another."""
    cells = _cells(domains, agents)
    duels = list(itertools.combinations(agents, 2))

    def judge(rows: Rows) -> Finding:
        met = [(d, duel) for d in domains for duel in duels if rows.judged(*((d, a) for a in duel))]
        samples = [[rows.sample((d, a)) for a in duel] for d, duel in met]
        p_values = holm([welch(a, b, "two-sided") for a, b in samples], len(domains) * len(duels))
        seen = {
            (duel, a.mean > b.mean)
            for (_, duel), (a, b), p in zip(met, samples, p_values, strict=True)
            if p < ALPHA
        }
        turned = sum({(duel, True), (duel, False)} <= seen for duel in duels)
        text = f"{turned} of {len(duels)} pairs of agents change order"
        return "holds" if turned else _lacking(rows, cells) or "inconclusive", text

    return Question(cells, judge, asks_table_6=True)


def matches_sarsop(agents: Sequence[str], domains: Sequence[str]) -> Question:
    """Ask whether agents are equivalent to SARSOP from a clean start, whose values are single episodes."""
    cells = _cells(domains, agents)

    def judge(rows: Rows) -> Finding:
        alike, below = [], []
        for cell in cells:
            row = rows.references.get((cell[0], "sarsop", "clean"))
            if rows.judged(cell) and row is not None:
                n = json.loads(row["spec"])["episodes"]
                ours, best = rows.sample(cell), Sample(row["return"], row["return_se"] * np.sqrt(n), n)
                alike.append(tost(ours, best, TOLERANCES[cell[0]]) < ALPHA)
                below.append(welch(ours, best, "less"))
        against = sum(p < ALPHA and not e for p, e in zip(holm(below, len(cells)), alike, strict=True))
        text = f"{sum(alike)} of {len(cells)} cells equivalent, {against} below"
        unknown = [d for d in domains if (d, "sarsop", "clean") not in rows.references]
        return _conclude(rows, cells, alike, len(cells), against, text, unknown)

    return Question(cells, judge)


def comes_close(agents: Sequence[str], domains: Sequence[str], share: float) -> Question:
    """Ask for a share of the way from Random, which opens with a hidden action, to SARSOP, which does not."""
    cells = _cells(domains, agents)

    def judge(rows: Rows) -> Finding:
        bounds = ("random", "hidden-first-action"), ("sarsop", "clean")
        known = {d: [rows.references.get((d, *bound)) for bound in bounds] for d in domains}
        unknown = [d for d in domains if any(bound is None for bound in known[d])]
        found = []
        for cell in cells:
            if rows.judged(cell) and cell[0] not in unknown:
                low, high = (bound["return"] for bound in known[cell[0]])
                mean, sd, n = rows.sample(cell)
                found.append(sides(Sample((mean - low) / (high - low), sd / (high - low), n), share))
        return _beyond(rows, cells, found, f"above {share:.2f}", unknown)

    return Question(cells, judge)


def alone_perfect(agent: str, others: Sequence[str], domains: Sequence[str]) -> Question:
    """Ask whether one agent succeeds always in all domains, and no other does."""
    cells = _cells(domains, (agent, *others))

    def judge(rows: Rows) -> Finding:
        p_always, p_missed = {}, {}
        for a in (agent, *others):
            there = [d for d in domains if rows.judged((d, a))]
            found = [rows.rate_sides((d, a), 1 - TOLERANCES[d]) for d in there]
            p_always[a] = max(above for above, _ in found) if len(there) == len(domains) else np.nan
            p_missed[a] = [below for _, below in found]
        not_others = sum(min(holm(p_missed[o], len(domains)), default=1) < EITHER_SIDE for o in others)
        against = holm([*p_missed[agent], *(p_always[o] for o in others)], len(domains) + len(others))
        cut = len(p_missed[agent])
        missed, also = (
            any(p < EITHER_SIDE for p in against[:cut]),
            sum(p < EITHER_SIDE for p in against[cut:]),
        )
        always = p_always[agent] < EITHER_SIDE
        ours = "not perfect in all" if missed else "perfect in all" if always else "undecided"
        text = f"{ours} {len(domains)}; of {len(others)} others {also} perfect, {not_others} not"
        if missed or also:
            return "does not hold", text
        if always and not_others == len(others):
            return "holds", text
        return _lacking(rows, cells) or "inconclusive", text

    return Question(cells, judge)


def succeeds_below(agents: Sequence[str], domains: Sequence[str], level: float) -> Question:
    """Ask whether success rates stay below a level."""
    cells = _cells(domains, agents)

    def judge(rows: Rows) -> Finding:
        found = [rows.rate_sides(cell, level)[::-1] for cell in cells if rows.judged(cell)]
        return _beyond(rows, cells, found, f"below {level:.2f}")

    return Question(cells, judge)


def less_stable(agents: Sequence[str], calm: Sequence[str], domains: Sequence[str]) -> Question:
    """Ask whether curves of some agents fall back further from their best so far than those of others."""
    cells = _cells(domains, (*agents, *calm))
    pairs = [((d, a), (d, b)) for d, a, b in itertools.product(domains, agents, calm)]

    def judge(rows: Rows) -> Finding:
        met = [pair for pair in pairs if rows.judged(*pair) and all(rows.curves[cell] for cell in pair)]
        falls = {cell: [fall(c, shown(cell[0])) for c in rows.curves[cell]] for pair in met for cell in pair}
        p_more = [_welch_of_values(falls[a], falls[b], "greater") for a, b in met]
        p_less = [_welch_of_values(falls[a], falls[b], "less") for a, b in met]
        more = [p < ALPHA for p in p_more]
        against = sum(p < ALPHA for p in holm(p_less, len(pairs)))
        text = _significant(more, pairs) + _contradict(against)
        return _conclude(rows, cells, more, len(pairs), against, text)

    return Question(cells, judge)


def learns_faster(agent: str, other: str, domains: Sequence[str]) -> Question:
    """Ask whether an agent gets to 90 % of the upper row in fewer steps, run by run."""
    cells = _cells(domains, (agent, other))

    def judge(rows: Rows) -> Finding:
        faster, slower, few = [], [], 0
        for d in domains:
            level = nine_tenths(rows, d)
            if level is not None and rows.judged((d, agent), (d, other)):
                ours, theirs = (
                    [steps_to(curve, shown(d), level) for curve in rows.curves[d, a]] for a in (agent, other)
                )
                if min(len(ours), len(theirs)) > 1:
                    faster.append(rank_sum(ours, theirs) < ALPHA)
                    slower.append(rank_sum(theirs, ours))
                    few += rank_sum([0] * len(ours), [1] * len(theirs)) >= ALPHA
        against = sum(p < ALPHA for p in holm(slower, len(domains)))
        text = f"faster in {sum(faster)} of {len(domains)} domains" + (
            f", slower in {against}" if against else ""
        )
        text += f", too few runs to tell in {few}" if few else ""
        unknown = [d for d in domains if nine_tenths(rows, d) is None]
        return _conclude(rows, cells, faster, len(domains), against, text, unknown)

    return Question(cells, judge)


def reconstructs(agent: str, domains: Sequence[str], nats: float) -> Question:
    """Ask whether the mean divergence from the exact belief stays below a bound."""
    cells = _cells(domains, (agent,))

    def judge(rows: Rows) -> Finding:
        found = [rows.runs[cell]["sampled_belief_kl"] for cell in cells if rows.judged(cell)]
        tested = [sides(_of(kl), nats)[::-1] for kl in found if kl.notna().all()]
        return _beyond(rows, cells, tested, f"below {nats:.2f} nats")

    return Question(cells, judge)


def belief_goes_with_score(agents: Sequence[str], domains: Sequence[str]) -> Question:
    """Ask for the correlation of divergence and score, both ranked within each cell, over all cells or none."""
    cells = _cells(domains, agents)

    def judge(rows: Rows) -> Finding:
        there = [cell for cell in cells if rows.judged(cell)]
        found = [rows.runs[cell].dropna(subset="sampled_belief_kl") for cell in there]
        lacking = "not run" if any(runs.empty for runs in found) else _lacking(rows, cells)
        runs = pd.concat(
            [
                of_cell.assign(score=of_cell[METRICS[cell[0]]], cell="/".join(cell))
                for cell, of_cell in zip(there, found, strict=True)
            ]
            or [pd.DataFrame(columns=["cell", "sampled_belief_kl", "score"])]
        )
        ranks = runs.groupby("cell")[["sampled_belief_kl", "score"]].rank(pct=True)
        rho, p = within_groups(ranks["sampled_belief_kl"], ranks["score"], runs["cell"])
        if np.isnan(rho):
            return lacking or "inconclusive", "too few runs, or none differ"
        text = f"rank correlation {rho:.2f} over {len(runs)} runs, p = {p:.3f}"
        said = ("holds" if rho < 0 else "does not hold") if p < ALPHA else "inconclusive"
        return lacking or said, text

    return Question(cells, judge)


def learns_before_reward(agent: str, domains: Sequence[str], rare: float, share: float) -> Question:
    """Ask how much of the belief loss's fall has happened by the time that success is more than rare."""
    cells = _cells(domains, (agent,))

    def judge(rows: Rows) -> Finding:
        tested = []
        for cell in cells:
            shares = (
                [early_fall(curve, rare) for curve in rows.curves.get(cell, ())] if rows.judged(cell) else []
            )
            known = [value for value in shares if value is not None]
            if len(known) > 1:
                tested.append(sides(_of(known), share))
        return _beyond(rows, cells, tested, f"above {share:.2f}")

    return Question(cells, judge)


def recovers_half(agent: str, lower: str, higher: str, domains: Sequence[str]) -> Question:
    """Ask whether a third agent closes about half of the gap between two: see :func:`recovered`."""
    cells = _cells(domains, (agent, lower, higher))

    def judge(rows: Rows) -> Finding:
        lacking = _lacking(rows, cells)
        return lacking, "" if lacking else None

    return Question(cells, judge)


def recovered(rows: Rows) -> tuple[float, np.ndarray]:
    """Return the share of the gap from Ab-Cb to Ah-Ch+BGN that Ab-Cb+BGN closes, and 4,000 bootstrapped ones.

    Without a gap there is nothing to close, and whatever is closed counts as more than all of it.
    """
    values = {f"{d} {a}": rows.values((d, a)) for d, a in _cells(ROBOT, ("ab-cb+bgn", "ab-cb", BGN))}

    def share(means: dict[str, np.ndarray]) -> np.ndarray:
        middle, low, high = (sum(means[f"{d} {a}"] for d in ROBOT) for a in ("ab-cb+bgn", "ab-cb", BGN))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(high > low, (middle - low) / (high - low), np.inf)

    return float(share({name: v.mean() for name, v in values.items()})), bootstrap(values, share)


#: Levels that the habits of policies are held to (Section 5.3): as a rule, and "unconditionally".
AS_A_RULE, UNCONDITIONALLY = 0.9, 0.99


def habit(domain: str, name: str, level: float = AS_A_RULE) -> Question:
    """Ask whether policies of Ah-Ch+BGN do what they are said to do, in the cases that are counted beside."""
    cell = domain, BGN

    def judge(rows: Rows) -> Finding:
        runs = rows.runs.get(cell, pd.DataFrame())
        known = runs.dropna(subset=[name, f"{name}_cases"]) if f"{name}_cases" in runs else runs[:0]
        if len(known) < 2:
            return "not measured", None
        shares = known[name].to_numpy()
        p_within, p_outside = sides_of_rate(shares, known[f"{name}_cases"].to_numpy().astype(int), level)
        low, mean, high = (f"{share:.0%}" for share in (shares.min(), shares.mean(), shares.max()))
        text = f"in {mean} of its cases, {low} to {high} by policy; {len(known)} policies"
        judged = (
            "does not hold"
            if p_outside < EITHER_SIDE
            else "holds"
            if p_within < EITHER_SIDE
            else "inconclusive"
        )
        return ("short" if rows.short(cell) else judged), text

    return Question((cell,), judge)


def penalised(domains: Sequence[str]) -> Question:
    """Ask the model files whether anything costs reward."""
    costs = [bool(re.search(r"^R:.*\s-\d", (FILES / f"{d}.pomdp").read_text(), re.M)) for d in domains]
    text = f"an action costs reward in {sum(costs)} of {len(costs)} models"
    return Question((), lambda _: ("holds" if all(costs) else "does not hold", text))


def only_success(domains: Sequence[str]) -> Question:
    """The compiled tables of these know no other reward: see the tests of the domains."""
    return Question(
        (), lambda _: ("holds", f"only success is rewarded in {len(domains)} of {len(domains)} models")
    )


def not_measured() -> Question:
    return Question((), lambda _: ("not measured", None))


CLAIMS: dict[str, Question] = {
    "outperforms-all": better([BGN], OTHERS, CLASSIC + ROBOT),
    "transfers": not_measured(),
    "outperforms-baselines": better([BGN], HISTORY, CLASSIC + ROBOT),
    "beats-asymmetric": better([BGN], ["ah-cs"], CLASSIC + ROBOT),
    "beats-belief-agent": better([BGN], ["ab-cb"], CLASSIC + ROBOT),
    "without-adjustments": not_measured(),
    "belief-beats-history": better(["ab-cb"], ["ah-ch"], CLASSIC + ROBOT),
    "features-beat-belief": better([BGN], ["ab-cb"], CLASSIC + ROBOT),
    "learns-faster": learns_faster(BGN, "ah-ch", CLASSIC + ROBOT),
    "two-groups": better([BGN, "ab-cb"], HISTORY, CLASSIC),
    "as-good-as-belief-agent": similar([BGN, "ab-cb"], CLASSIC),
    "matches-sarsop": matches_sarsop([BGN, "ab-cb"], HALLWAYS),
    "close-to-sarsop": comes_close([BGN, "ab-cb"], ROCKSAMPLES, 0.9),
    "order-varies": order_varies(HISTORY, CLASSIC),
    "belief-critic-helps": better(["ah-cb"], ["ah-cs"], HALLWAYS),
    "belief-critic-no-effect": similar(["ah-cb", "ah-cs"], ROCKSAMPLES),
    "plain-matches-asymmetric": matches_in("ah-ch", ["ah-cb", "ah-cs"], CLASSIC, 3),
    "alone-perfect": alone_perfect(BGN, OTHERS, ROBOT),
    "belief-agent-worse": better([BGN], ["ab-cb"], ROBOT),
    "belief-agent-second": better(["ab-cb"], HISTORY, ROBOT),
    "rest-alike": similar(HISTORY, ROBOT, 0.1),
    "rest-bad": succeeds_below(HISTORY, ROBOT, 0.5),
    "rest-unstable": less_stable(HISTORY, [BGN, "ab-cb"], ROBOT),
    "robot-perfect": not_measured(),
    "up-then-down": habit("top-plate", "habit_up_then_down"),
    "counts-plates": habit("top-plate", "habit_counts_plates"),
    "moves-right-first": habit("two-bumps-1d", "habit_moves_right_first", UNCONDITIONALLY),
    "pushes-second": habit("two-bumps-1d", "habit_pushes_second"),
    "turns-at-the-end": habit("two-bumps-1d", "habit_turns_at_the_end"),
    "turns-softly": habit("two-bumps-1d", "habit_turns_softly"),
    "non-intersecting": habit("two-bumps-2d", "habit_non_intersecting"),
    "grasps-at-once": habit("two-bumps-2d", "habit_grasps_at_once"),
    "shortest-way-back": habit("two-bumps-2d", "habit_shortest_way_back"),
    "best-in-robots": better([BGN], OTHERS, ROBOT),
    "not-beliefs-alone": better([BGN], ["ah-cb", "ab-cb"], ROBOT),
    "reconstructs": reconstructs(BGN, ["two-bumps-1d"], 0.1),
    "better-than-plain": better([BGN], ["ah-ch"], ROBOT),
    "belief-determines": belief_goes_with_score([BGN, "ab-cb+bgn"], ROBOT),
    "reasonable-representation": not_measured(),
    "belief-agent-cannot-match": better([BGN], ["ab-cb"], ROBOT),
    "similar-in-classic": similar([BGN, "ab-cb"], CLASSIC),
    "classic-penalises": penalised(CLASSIC),
    "robots-reward-success": only_success(ROBOT),
    "learns-without-reward": learns_before_reward(BGN, ["two-bumps-2d"], 0.1, 0.1),
    "stops-without-reward": not_measured(),
    "better-features": not_measured(),
    "recovers-half": recovers_half("ab-cb+bgn", "ab-cb", BGN, ROBOT),
    "half-is-not-all": better([BGN], ["ab-cb+bgn"], ROBOT),
    "structure-of-beliefs": not_measured(),
    "flexibility": not_measured(),
    "any-input": better(["ab-cb+bgn"], ["ab-cb"], ROBOT),
    "masterfully": not_measured(),
    "decay-needed": not_measured(),
}


def by_table_6(question: Question, rows: Rows) -> str | None:
    """Return the verdict on the paper's own numbers, where it prints any of a claim's and its domains are shown."""
    printed = {domain for domain, agent in question.cells if domain in TABLE_6}
    if not (question.asks_table_6 and printed and printed <= rows.domains()):
        return ""
    verdict = question.judge(Table6())[0]
    return "" if verdict == "not run" else verdict


def _lacking(rows: Rows, cells: Iterable[Cell]) -> str | None:
    if any(rows.missing(cell) for cell in cells):
        return "not run"
    return "short" if any(rows.short(cell) for cell in cells) else None


def _name(domains: Sequence[str], cells: Sequence[Cell]) -> str:
    """Say of which domains of a claim reference rows are missing."""
    of = set(domains)
    whole = len(of) > 1 and of == {d for d, _ in cells}
    return f"no reference rows of {'any domain' if whole else ', '.join(domains)}" if of else ""


def _significant(judged: Sequence[bool], asked: Sequence[object]) -> str:
    asked_for = f" ({len(asked)} asked for)" if len(asked) > len(judged) else ""
    return f"{sum(judged)} of {len(judged)} comparisons significant{asked_for}"


def _contradict(count: int) -> str:
    return f", {count} contradict" if count else ""


def _conclude(
    rows: Rows,
    cells: Sequence[Cell],
    held: Sequence[bool],
    asked: int,
    against: int,
    text: str,
    unknown: Sequence[str] = (),
) -> Finding:
    if against:
        return "does not hold", text
    lacking = "not run" if unknown else _lacking(rows, cells)
    if lacking:
        return lacking, "; ".join(filter(None, (text if held else "", _name(unknown, cells))))
    return "holds" if sum(held) == asked else "inconclusive", text


def _beyond(
    rows: Rows,
    cells: Sequence[Cell],
    found: Sequence[tuple[float, float]],
    asked: str,
    unknown: Sequence[str] = (),
) -> Finding:
    """Judge p-values of lying on the side of a bound that is claimed, and on the other, which contradicts."""
    within = [p < EITHER_SIDE for p, _ in found]
    outside = sum(p < EITHER_SIDE for p in holm([p for _, p in found], len(cells)))
    text = f"{sum(within)} of {len(cells)} cells {asked}" + (f", {outside} not" if outside else "")
    return _conclude(rows, cells, within, len(cells), outside, text, unknown)


def _of(values: Sequence[float]) -> Sample:
    return Sample(np.mean(values), np.std(values, ddof=1), len(values))


def _welch_of_values(a: Sequence[float], b: Sequence[float], tail: str) -> float:
    if np.ptp(a) == np.ptp(b) == 0:
        return np.nan
    return stats.ttest_ind(a, b, equal_var=False, alternative=tail).pvalue


def shown(domain: str) -> str:
    """Return the column of a curve that shows how well a domain is learnt."""
    return "success_100" if domain in ROBOT else "return_100"


def nine_tenths(rows: Rows, domain: str) -> float | None:
    """Return 90 % of the upper row, its episodes opening as the agents' do; None where it or Random is missing."""
    upper, opening = ("perfect", "clean") if domain in ROBOT else ("sarsop", "hidden-first-action")
    best = rows.references.get((domain, upper, opening))
    if best is None or (domain, "random", opening) not in rows.references:
        return None
    return 0.9 * (1.0 if domain in ROBOT else best["return"])


def steps_to(curve: pd.DataFrame, column: str, level: float) -> float:
    """Return where a curve, linear between its points, first reaches a level, once 100 episodes are over."""
    points = curve[curve["episodes"] >= 100].dropna(subset=column)
    before: tuple[float, float] | None = None
    for steps, value in zip(points["env_steps"], points[column], strict=True):
        if value >= level:
            if before is None:
                return float(steps)
            return float(np.interp(level, [before[1], value], [before[0], steps]))
        before = steps, value
    return np.inf


def fall(curve: pd.DataFrame, column: str) -> float:
    """Return how far a curve is below its best so far, on average over the second half of its steps.

    Its points count, and may be the best, once 100 episodes are over; NaN where none ever does.
    """
    points = curve[curve["episodes"] >= 100].dropna(subset=column)
    if points.empty:
        return np.nan
    below, steps = (points[column].cummax() - points[column]).to_numpy(), points["env_steps"].to_numpy()
    late = steps >= steps[-1] / 2
    widths, heights = np.diff(steps[late]), below[late]
    return float(np.sum(widths * (heights[1:] + heights[:-1]) / 2) / max(widths.sum(), 1))


def early_fall(curve: pd.DataFrame, rare: float) -> float | None:
    """Return the share of a loss's fall; None of a run without a loss, or a fall of it, or whose success stays rare."""
    loss = curve["belief_cross_entropy"]
    more = (curve["success_100"] > rare) & (curve["episodes"] >= 100)
    if loss.isna().any() or not more.any() or loss.min() >= loss.iloc[0]:
        return None
    until = loss[: int(np.argmax(more)) + 1]
    return float((loss.iloc[0] - until.min()) / (loss.iloc[0] - loss.min()))
