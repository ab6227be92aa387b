"""Episodes of the force-feedback domains in MuJoCo physics: final evaluation, and the test of the tables.

A policy is trained on tables that were compiled from this physics; here it acts on the physics itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from bgn import domains
from bgn.domains.domain import Domain
from bgn.errors import InputError
from bgn.physics.tasks import Step, Task, draw_start, task_of
from bgn.simulation.belief_rules import next_belief, start_belief
from bgn.simulation.policy import Policy

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """Where an episode in physics stands."""

    observation: int
    x: int
    y: int
    belief: Floats
    """(Y,) the domain's belief over the hidden part."""
    angle: float
    """Raw finger angle in radians."""
    ended: bool
    truncated: bool
    success: bool
    steps: int


class Evaluation(TypedDict):
    """Result of :func:`evaluate_in_physics`; ``success_se`` is the standard error of ``success``."""

    success: float
    success_se: float
    length: float
    episodes: int


class PhysicsWorld:
    """One lane of a robot domain in physics, with the domain's belief beside it."""

    def __init__(self, domain: Domain) -> None:
        self.domain = domain
        task = task_of(domain.id)
        self.scene = task.make_scene(domain)
        self.task = task(domain, self.scene)
        self._seen = observations(domain)
        self._y = -1
        self._now: EpisodeState | None = None

    @property
    def now(self) -> EpisodeState:
        """The current state; an error before the first ``reset``."""
        if self._now is None:
            raise RuntimeError("reset() must be called before the first step")
        return self._now

    def reset(self, rng: np.random.Generator) -> EpisodeState:
        """Begin an episode drawn from the domain's start distribution."""
        return self.reset_to(*draw_start(self.domain, rng))

    def reset_to(self, x: int, y: int) -> EpisodeState:
        """Begin an episode at a chosen start (x, y)."""
        self._y = y
        step = self.task.reset(x, y)
        self._now = self._state_after(step, start_belief(self.domain, step.x), steps=0)
        return self._now

    def step(self, action: int) -> EpisodeState:
        """Take one action.

        Raises
        ------
        RuntimeError
            The episode is over, or has not begun.
        ValueError
            There is no such action.
        """
        now, n_actions = self.now, self.domain.model.joint.n_actions
        if now.ended or now.truncated:
            raise RuntimeError("the episode is over: reset() begins the next one")
        if not 0 <= action < n_actions:
            raise InputError(f"action {action} is not in 0..{n_actions - 1}")
        step = self.task.act(action)
        belief = now.belief if step.ended else self._next_belief(now, action, step.x)
        self._now = self._state_after(step, belief, steps=now.steps + 1)
        return self._now

    def _next_belief(self, now: EpisodeState, action: int, x_next: int) -> Floats:
        observation = int(self._seen[x_next])
        return next_belief(self.domain, now.belief, action, observation, x=now.x, x_next=x_next)

    def _state_after(self, step: Step, belief: Floats, steps: int) -> EpisodeState:
        return EpisodeState(
            observation=int(self._seen[step.x]),
            x=step.x,
            y=self._y,
            belief=belief,
            angle=self.scene.measurement.angle,
            ended=step.ended,
            truncated=not step.ended and steps >= self.domain.episode_limit,
            success=step.success,
            steps=steps,
        )


def evaluate_in_physics(
    domain_id: str, policy: Policy, episodes: int, seed: int, **variant: str | int | float | bool
) -> Evaluation:
    """Run a policy in physics and return its success rate, standard error, mean length and episode count.

    Raises
    ------
    ValueError
        ``episodes`` is below 1, the domain has no physics, or no such variant.
    """
    if episodes < 1:
        raise InputError(f"an evaluation needs episodes >= 1, not {episodes}")
    domain = domains.get(domain_id, **variant)
    task, rng = PhysicsWorld(domain).task, np.random.default_rng(seed)
    results = np.array([play(domain, task, policy, rng) for _ in range(episodes)], dtype=np.float64)
    success, length = results.mean(axis=0)
    return Evaluation(
        success=float(success),
        success_se=float(np.sqrt(success * (1 - success) / episodes)),
        length=float(length),
        episodes=episodes,
    )


def play(domain: Domain, task: Task, policy: Policy, rng: np.random.Generator) -> tuple[bool, int]:
    """Play one episode from a drawn start; return whether it succeeded, and its length."""
    seen = observations(domain)
    step, action = task.reset(*draw_start(domain, rng)), None
    policy.reset(rng)
    for length in range(1, domain.episode_limit + 1):
        action = policy.act(int(seen[step.x]), action)
        step = task.act(action)
        if step.ended:
            return step.success, length
    return False, domain.episode_limit


def observations(domain: Domain) -> NDArray[np.integer[Any]]:
    """Return the observation of each x, shape (X,); a robot domain's depends on nothing else."""
    rows = domain.model.joint.observations[0].indices  # one per joint state
    seen: NDArray[np.integer[Any]] = rows[:: domain.model.n_hidden]
    return seen
