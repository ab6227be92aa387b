"""A trained actor at work from every state in which an episode of its domain can start, all of them at once.

It takes its most probable action. Where the domain is deterministic too, as the robot domains are, what comes out is
exact: nothing is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from bgn.agents.networks import AgentNetworks
from bgn.domains.domain import Domain
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode of T actions."""

    states: NDArray[np.int64]
    """(T + 1,) joint states s; the last is where the episode ended or was cut."""
    actions: NDArray[np.int64]
    """(T,)"""
    rewards: NDArray[np.float32]
    """(T,)"""


def every_start(networks: AgentNetworks, domain: Domain) -> list[Trajectory]:
    """Return one greedy episode from each start state, in the order of the states.

    Raises
    ------
    ValueError
        The domain opens episodes with an unseen action, so that none starts in a state that is known.
    """
    if domain.hidden_first_action:
        raise ValueError(f"{domain.id} opens its episodes with an unseen random action")
    starts = np.flatnonzero(domain.model.joint.start)
    world = TableWorld(domain, len(starts), track_beliefs=networks.actor.kind == "belief")
    networks.prepare()
    world.reset(_variates_of_every_start(domain.model.joint.start[starts]))
    if not np.array_equal(world.inputs.state.numpy(), starts):
        raise AssertionError("the simulator draws start states in another order than the model lists them")
    paths: list[list[tuple[int, int, float]]] = [[] for _ in starts]
    ends = np.zeros_like(starts)
    lanes = torch.arange(len(starts))
    hidden = torch.zeros(1, len(starts), networks.hidden_width)
    with torch.no_grad():
        while len(lanes):
            features, hidden = networks.actor_features(world.inputs, hidden)
            action = networks.actor.head.forward(features).argmax(-1)[0]
            state, inputs = world.inputs.state, world.inputs
            step = world.step(action, torch.zeros(len(lanes), STEP_VARIATES), inputs)
            for lane, *taken in zip(
                lanes.tolist(), state.tolist(), action.tolist(), step.reward.tolist(), strict=True
            ):
                paths[lane].append((taken[0], taken[1], taken[2]))
            ends[lanes] = step.arrival.state
            going = torch.nonzero(~(step.ended | step.truncated))[:, 0]
            world.keep(going)
            lanes, hidden = lanes[going], hidden[:, going]
    return [_trajectory(path, int(end)) for path, end in zip(paths, ends, strict=True)]


def _variates_of_every_start(probabilities: NDArray[np.float64]) -> torch.Tensor:
    """Return variates (N, 4) of which each opens an episode in another start state: the middle of its share."""
    shares = probabilities / probabilities.sum()
    middles = np.cumsum(shares) - shares / 2
    variates = torch.zeros(len(middles), START_VARIATES)
    variates[:, 0] = torch.from_numpy(middles.astype(np.float32))
    return variates


def _trajectory(path: list[tuple[int, int, float]], end: int) -> Trajectory:
    states, actions, rewards = zip(*path, strict=True)
    return Trajectory(np.array([*states, end]), np.array(actions), np.array(rewards, dtype=np.float32))
