"""What a domain's agents believe: one belief at a time, by the rule of the domain's variant.

The batched counterpart is :class:`bgn.simulation.table_world.TableWorld`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bgn.domains.domain import Domain
from bgn.pomdp.belief import update_hidden

Floats = NDArray[np.float64]


def start_belief(domain: Domain, x: int) -> Floats:
    """Return the belief b_Y (Y,) at a start x: the variant's prior, or Bayes on the start distribution."""
    if domain.prior is not None:
        return np.array(domain.prior[x])
    joint = domain.model.joint.start.reshape(-1, domain.model.n_hidden)[x]
    return np.asarray(joint / joint.sum())


def next_belief(
    domain: Domain, belief: Floats, action: int, observation: int, *, x: int, x_next: int
) -> Floats:
    """Return b_Y after an action that did not end the episode: exact, or by the variant's elimination."""
    if domain.elimination is None:
        return update_hidden(domain.model, belief, action, observation, x=x, x_next=x_next, ended=False)
    kept = belief * domain.elimination[x_next]
    return np.asarray(kept / kept.sum())
