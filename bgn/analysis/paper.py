"""What the paper prints: the raw returns of Appendix D (Table 6) and its statements about single cells.

Every number and claim of the paper stands here and nowhere else. Normalised returns are always recomputed
from the raw ones: three standard deviations of the paper's Table 7 do not follow from its Table 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: Seeds behind every mean of an agent (Appendix D).
SEEDS = 10
#: Half a unit of the last printed digit: Table 6 rounds to two decimals (and drops trailing zeros in places).
HALF_UNIT = 0.005

#: Agents in the order of Table 6; Ab-Cb+BGN appears in Section 5.4 only.
AGENTS = ("ah-ch", "ah-ch+bgn", "ah-cs", "ab-cb", "ah-cb", "ab-cb+bgn")


@dataclass(frozen=True)
class Printed:
    """A printed mean ± standard deviation."""

    mean: float
    sd: float


#: Table 6, agents: mean ± standard deviation over seeds (of the population: the authors' code uses ddof 0).
RETURNS = {
    ("hallway", "ah-ch"): Printed(0.50, 0.02),
    ("hallway", "ah-ch+bgn"): Printed(0.54, 0.01),
    ("hallway", "ah-cs"): Printed(0.46, 0.08),
    ("hallway", "ab-cb"): Printed(0.53, 0.04),
    ("hallway", "ah-cb"): Printed(0.48, 0.03),
    ("hallway-2", "ah-ch"): Printed(0.10, 0.02),
    ("hallway-2", "ah-ch+bgn"): Printed(0.35, 0.01),
    ("hallway-2", "ah-cs"): Printed(0.26, 0.02),
    ("hallway-2", "ab-cb"): Printed(0.36, 0.01),
    ("hallway-2", "ah-cb"): Printed(0.29, 0.02),
    ("rocksample-4-4", "ah-ch"): Printed(7.79, 1.12),
    ("rocksample-4-4", "ah-ch+bgn"): Printed(14.14, 0.21),
    ("rocksample-4-4", "ah-cs"): Printed(6.73, 0.15),
    ("rocksample-4-4", "ab-cb"): Printed(13.94, 0.33),
    ("rocksample-4-4", "ah-cb"): Printed(6.10, 2.04),
    ("rocksample-5-5", "ah-ch"): Printed(6.23, 0.35),
    ("rocksample-5-5", "ah-ch+bgn"): Printed(14.71, 0.50),
    ("rocksample-5-5", "ah-cs"): Printed(6.52, 0.09),
    ("rocksample-5-5", "ab-cb"): Printed(15.22, 0.52),
    ("rocksample-5-5", "ah-cb"): Printed(6.53, 0.08),
}

#: Table 6, reference rows. Random's ± can only be that of single episodes; SARSOP's fits no one definition.
REFERENCE_RETURNS = {
    ("hallway", "sarsop"): Printed(0.53, 0.05),
    ("hallway", "random"): Printed(0.05, 0.15),
    ("hallway-2", "sarsop"): Printed(0.35, 0.04),
    ("hallway-2", "random"): Printed(0.03, 0.11),
    ("rocksample-4-4", "sarsop"): Printed(17.75, 0.12),
    ("rocksample-4-4", "random"): Printed(-62.0, 38.2),
    ("rocksample-5-5", "sarsop"): Printed(19.20, 0.07),
    ("rocksample-5-5", "random"): Printed(-61.0, 36.12),
}

ClaimKind = Literal["perfect", "below-bgn"]


@dataclass(frozen=True)
class CellClaim:
    """A statement of the paper about one cell."""

    kind: ClaimKind
    """``perfect``: always succeeds. ``below-bgn``: succeeds less often than Ah-Ch+BGN on the same domain."""
    quote: str
    section: str


# Being the *only* agent that is perfect in all tasks is a claim about all cells at once: bgn.analysis.claims.
_PERFECT = CellClaim(
    "perfect",
    "Ah-Ch + BGN is the only agent that can achieve a perfect success rate in all tasks.",
    "5.2",
)
_BELOW_BGN = CellClaim(
    "below-bgn",
    "Ah-Ch + BGN performs significantly better than the other methods in the force-feedback robot environments.",
    "5.4",
)
_ROBOT_DOMAINS = ("top-plate", "two-bumps-1d", "two-bumps-2d")

#: What the paper says about each robot cell; it prints no numbers for them.
CELL_CLAIMS = {
    (domain, agent): _PERFECT if agent == "ah-ch+bgn" else _BELOW_BGN
    for domain in _ROBOT_DOMAINS
    for agent in AGENTS
}


def reference_kind(domain: str, agent: str) -> Literal["numeric", "claim", "none"]:
    """Say what the paper offers to compare a cell with."""
    if (domain, agent) in RETURNS:
        return "numeric"
    return "claim" if (domain, agent) in CELL_CLAIMS else "none"
