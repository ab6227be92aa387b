"""Hallway: reach the goal alcove from an unknown cell and heading (Littman et al. 1995; paper, Appendix C).

60 states (15 cells x 4 headings), 5 actions, 21 observations. The paper counts the goal's four headings
as one state (57).
"""

from __future__ import annotations

from bgn.domains.domain import Domain
from bgn.domains.grid_navigation import CorridorMap, build_layout, build_model
from bgn.domains.registry import register

MAP = CorridorMap(
    (
        "***********",
        "  * * * +  ",
    )
)

#: Corridor cells above an alcove, west to east; the last one is above the goal.
LANDMARKS = (2, 4, 6, 8)


@register("hallway")
def hallway() -> Domain:
    """Build Hallway."""
    return Domain(
        id="hallway",
        title="Hallway",
        family="classic",
        model=build_model(MAP, LANDMARKS),
        episode_limit=100,  # paper, Table 4
        training_discount=0.95,
        report_discount=0.95,
        hidden_first_action=True,
        layout=build_layout(MAP),
    )
