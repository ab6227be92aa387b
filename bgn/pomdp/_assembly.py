"""The entries of a .pomdp file, put together: the last entry wins, what none mentions is zero."""

from __future__ import annotations

from collections.abc import Iterable

from bgn.pomdp._declarations import Declarations
from bgn.pomdp._entries import Entry
from bgn.pomdp._limits import Limits
from bgn.pomdp._rewards import Rewards
from bgn.pomdp._table import Table
from bgn.pomdp.model import POMDP


def assemble(
    declarations: Declarations, entries: Iterable[Entry], limits: Limits, end: tuple[int, int]
) -> POMDP:
    """Return the model of a whole file; ``end`` is the line and column where it ends.

    Raises
    ------
    PomdpFormatError
        The entries do not make a model, or one beyond the limits.
    """
    states, actions, observations = (declarations.spaces[kind] for kind in ("state", "action", "observation"))
    T = Table("T", actions, states, states, limits)
    O = Table("O", actions, states, observations, limits)
    R = Rewards((actions, states, states, observations), limits)
    tables: dict[str, Table | Rewards] = {"T": T, "O": O, "R": R}
    for entry in entries:
        tables[entry.letter].add(entry)
    start = declarations.start_distribution()
    return POMDP(
        transitions=T.arrays(start, end),
        observations=O.arrays(None, end),
        rewards=R.array(declarations.sign),
        start=start,
        reset=T.resets(),
        discount=declarations.discount_value,
        state_names=states.names,
        action_names=actions.names,
        observation_names=observations.names,
    )
