"""The six agents of the paper (Section 4) as declarations: what actor and critic see, and who is grounded.

``Ax-Cy`` names the inputs of **A**ctor and **C**ritic: **h**istory, **b**elief or **s**tate.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from bgn.errors import InputError

InputKind = Literal["history", "belief", "state"]


@dataclass(frozen=True, kw_only=True)
class AgentSpec:
    """One agent."""

    id: str
    """Stable name in the registry, the store and the command line."""
    title: str
    """The name as the paper prints it."""
    actor: InputKind
    """What the policy is a function of; only ``history`` can act without a belief filter."""
    critic: InputKind
    """What the value is a function of."""
    grounded: bool = False
    """Whether heads on the actor's and the critic's features reconstruct the belief (Eq. 5)."""

    @property
    def needs_beliefs(self) -> bool:
        """Whether training needs the exact belief."""
        return self.grounded or "belief" in (self.actor, self.critic)


_PAPER = (
    AgentSpec(id="ah-ch", title="Ah-Ch", actor="history", critic="history"),
    AgentSpec(id="ah-ch+bgn", title="Ah-Ch+BGN", actor="history", critic="history", grounded=True),
    AgentSpec(id="ah-cs", title="Ah-Cs", actor="history", critic="state"),
    AgentSpec(id="ab-cb", title="Ab-Cb", actor="belief", critic="belief"),
    AgentSpec(id="ah-cb", title="Ah-Cb", actor="history", critic="belief"),
    AgentSpec(id="ab-cb+bgn", title="Ab-Cb+BGN", actor="belief", critic="belief", grounded=True),
)

#: All agents by id, in the order of the paper's tables.
AGENTS: MappingProxyType[str, AgentSpec] = MappingProxyType({spec.id: spec for spec in _PAPER})


def agent(agent_id: str) -> AgentSpec:
    """Look an agent up; an unknown id raises an :class:`InputError` that lists the known ones."""
    if agent_id not in AGENTS:
        raise InputError(f"unknown agent {agent_id!r}; known: {', '.join(AGENTS)}")
    return AGENTS[agent_id]
