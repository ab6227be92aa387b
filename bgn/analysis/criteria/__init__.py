"""How a sentence of the paper becomes a question that stored runs can answer.

Each criterion names its cells and judges them. All follow one pattern. A claim about several comparisons *holds*
if every one of them is significant by itself (an intersection-union test needs no correction); it *does not hold* if
any is significantly contradicted (Holm-corrected over the comparisons); otherwise it stays *inconclusive*. Comparisons
whose cells or reference rows are missing, or whose runs are shorter than the paper's, can't make a claim hold.
"""

from bgn.analysis.criteria.comparisons import Better, MatchesIn, OrderVaries, Similar
from bgn.analysis.criteria.findings import Answer, Criterion, Finding, NotMeasured
from bgn.analysis.criteria.grounding import BeliefGoesWithScore, ReconstructsBelief, RecoversHalf
from bgn.analysis.criteria.learning import (
    LearnsBeforeReward,
    LearnsFaster,
    LessStable,
    early_fall,
    fall,
    learning_steps,
)
from bgn.analysis.criteria.models import Penalises, RewardsSuccessOnly
from bgn.analysis.criteria.references import ComesClose, MatchesReference
from bgn.analysis.criteria.success import AlonePerfect, ShowsHabit, SucceedsBelow, success_interval

__all__ = [
    "AlonePerfect",
    "Answer",
    "BeliefGoesWithScore",
    "Better",
    "ComesClose",
    "Criterion",
    "Finding",
    "LearnsBeforeReward",
    "LearnsFaster",
    "LessStable",
    "MatchesIn",
    "MatchesReference",
    "NotMeasured",
    "OrderVaries",
    "Penalises",
    "ReconstructsBelief",
    "RecoversHalf",
    "RewardsSuccessOnly",
    "ShowsHabit",
    "Similar",
    "SucceedsBelow",
    "early_fall",
    "fall",
    "learning_steps",
    "success_interval",
]
