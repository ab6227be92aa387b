from __future__ import annotations

from collections import Counter

import pytest

from bgn.agents.specs import AGENTS
from bgn.analysis import paper


def test_every_cell_has_its_kind_of_reference() -> None:
    domains = ("hallway", "hallway-2", "rocksample-4-4", "rocksample-5-5", *paper._ROBOT_DOMAINS)
    kinds = Counter(paper.reference_kind(domain, agent) for domain in domains for agent in paper.AGENTS)
    assert kinds == {"numeric": 20, "claim": 18, "none": 4}
    assert set(paper.AGENTS) <= set(AGENTS)


def test_only_the_grounded_history_agent_is_claimed_to_be_perfect() -> None:
    perfect = {agent for (_, agent), claim in paper.CELL_CLAIMS.items() if claim.kind == "perfect"}
    assert perfect == {"ah-ch+bgn"}


@pytest.mark.parametrize(
    ("domain", "agent", "printed"),
    # Table 7 of the paper follows from its Table 6.
    [
        ("hallway", "ah-ch", 0.94),
        ("hallway", "ah-ch+bgn", 1.02),
        ("hallway-2", "ah-cs", 0.72),
        ("hallway-2", "ab-cb", 1.03),
        ("rocksample-4-4", "ah-ch", 0.88),
        ("rocksample-4-4", "ah-cb", 0.85),
        ("rocksample-5-5", "ab-cb", 0.95),
        ("rocksample-5-5", "ah-cs", 0.84),
    ],
)
def test_table_7_gives_table_8(domain: str, agent: str, printed: float) -> None:
    best, worst = (paper.REFERENCE_RETURNS[domain, policy].mean for policy in ("sarsop", "random"))
    assert (paper.RETURNS[domain, agent].mean - worst) / (best - worst) == pytest.approx(printed, abs=0.011)
