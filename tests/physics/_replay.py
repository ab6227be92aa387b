"""Replays random physics steps against the table that was compiled from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bgn.domains.domain import Domain
from bgn.physics.tasks import Step, draw_start
from bgn.physics.world import PhysicsWorld


class Comparison(NamedTuple):
    violations: int
    """Steps of another x', end or success than the table's."""
    pairs: int
    """How many different (x, y, action) were visited."""


def compare_with_table(domain: Domain, steps: int, seed: int) -> Comparison:
    task, rng = PhysicsWorld(domain).task, np.random.default_rng(seed)
    joint, Y = domain.model.joint, domain.model.n_hidden
    violations, visited = 0, set()
    step, y, length = Step(0, ended=True), 0, 0
    for _ in range(steps):
        if step.ended or length == domain.episode_limit:
            x, y = draw_start(domain, rng)
            step, length = task.reset(x, y), 0
        s, action = step.x * Y + y, _random_action(joint.n_actions, rng)
        visited.add((s, action))
        step, length = task.act(action), length + 1
        expected = Step(
            x=step.x if joint.reset[action, s] else int(joint.transitions[action].indices[s]) // Y,
            ended=bool(joint.reset[action, s]),
            success=bool(joint.expected_rewards[action, s] == 1),
        )
        violations += step != expected
    return Comparison(violations, len(visited))


def _random_action(n_actions: int, rng: np.random.Generator) -> int:
    """Draw an action, the last one (a grasp, or a stiff move) rarely, so that episodes go deep."""
    weights = np.ones(n_actions)
    weights[-1] = 0.2
    return int(rng.choice(n_actions, p=weights / weights.sum()))
