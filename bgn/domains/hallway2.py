"""Hallway-2: reach the goal at the edge of a maze full of look-alikes (Littman et al. 1995; paper, App. C).

92 states (23 cells x 4 headings), 5 actions, 17 observations; no landmarks. The paper counts the goal's
four headings as one state (89).
"""

from __future__ import annotations

from bgn.domains.domain import Domain
from bgn.domains.grid_navigation import CorridorMap, build_layout, build_model
from bgn.domains.registry import register

MAP = CorridorMap(
    (
        " ***** ",
        "** * **",
        " * * * ",
        "** * *+",
        " ***** ",
    )
)


@register("hallway-2")
def hallway2() -> Domain:
    """Build Hallway-2."""
    return Domain(
        id="hallway-2",
        title="Hallway-2",
        family="classic",
        model=build_model(MAP),
        episode_limit=100,  # paper, Table 4
        training_discount=0.95,
        report_discount=0.95,
        hidden_first_action=True,
        layout=build_layout(MAP),
    )
