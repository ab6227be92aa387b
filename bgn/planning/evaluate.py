"""What a policy earns: simulated episodes with their statistics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bgn.errors import InputError
from bgn.planning import _episodes
from bgn.planning.alpha_vectors import AlphaVectors
from bgn.planning.compiled import compile_model
from bgn.planning.episodic import Convention, start_beliefs
from bgn.planning.policies import Policy, UniformRandom
from bgn.pomdp.model import MOMDP, POMDP

#: Two-sided 95 % quantile of the normal distribution.
Z95 = 1.959963984540054
#: Counted steps of the paper's classic domains (paper, Table 5).
DEFAULT_LIMIT = 100


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Statistics of simulated episodes."""

    episodes: int
    mean: float
    """Discounted return, the first counted reward undiscounted."""
    standard_deviation: float
    """Of single episodes."""
    success: float
    """Share of episodes whose undiscounted return is positive."""
    length: float
    """Mean counted steps."""

    @property
    def standard_error(self) -> float:
        """Of the mean return."""
        return self.standard_deviation / float(np.sqrt(self.episodes))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the mean return (normal approximation)."""
        return self.mean - Z95 * self.standard_error, self.mean + Z95 * self.standard_error


def evaluate(
    model: POMDP | MOMDP,
    policy: Policy,
    *,
    episodes: int,
    seed: int,
    convention: Convention = "clean",
    limit: int = DEFAULT_LIMIT,
    discount: float | None = None,
) -> Evaluation:
    """Simulate a policy acting on exact beliefs.

    Under ``hidden-first-action`` nature opens with an unseen uniformly random action whose reward and end are
    dropped. An episode ends with the step that resets, or after ``limit`` counted steps. ``discount`` weighs
    the reported return; the model's own if not given. The same seed gives the same episodes.

    Raises
    ------
    ValueError
        The policy is for another number of states or actions, or a count makes no sense.
    """
    joint = model.joint if isinstance(model, MOMDP) else model
    if episodes < 2 or limit < 1:
        raise InputError(f"{episodes} episodes of at most {limit} steps; there must be 2 and 1 at least")
    if isinstance(policy, AlphaVectors):
        _check_fits(policy, joint)
    starts = start_beliefs(model, convention)
    compiled = compile_model(joint, starts)
    world = _episodes.lay_out(model, compiled, starts, convention)
    random = isinstance(policy, UniformRandom)
    rule = (
        _episodes.no_rule(compiled)
        if isinstance(policy, UniformRandom)
        else _episodes.cut_to_classes(policy, compiled)
    )
    weight = joint.discount if discount is None else discount
    results = _episodes.simulate(world, compiled, rule, random, seed, limit, weight, episodes)
    return Evaluation(
        episodes=episodes,
        mean=float(results[:, 0].mean()),
        standard_deviation=float(results[:, 0].std(ddof=1)),
        success=float((results[:, 1] > 0).mean()),
        length=float(results[:, 2].mean()),
    )


def _check_fits(policy: AlphaVectors, model: POMDP) -> None:
    if policy.vectors.shape[1] != model.n_states:
        raise InputError(
            f"the policy is for {policy.vectors.shape[1]} states, the model has {model.n_states}"
        )
    if policy.actions.max() >= model.n_actions:
        raise InputError(f"the policy takes action {policy.actions.max()}; the model has {model.n_actions}")
