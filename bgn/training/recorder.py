"""Training curves, gathered on the device: nothing here waits for it but :meth:`Recorder.read`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

#: Episodes a curve's point is averaged over (paper, Section 4.1).
WINDOW = 100


@dataclass(frozen=True)
class Readings:
    """One point of each seed's curve: lists over the seeds."""

    return_100: list[float]
    success_100: list[float]
    episodes: list[int]
    losses: dict[str, list[float]]  # means over the updates since the last reading


class Recorder:
    """Returns and successes of the last 100 training episodes of each seed, and mean losses.

    An episode succeeds if its undiscounted reward is positive: the goal was reached, or the task was done.
    ``losses`` names what an update reports beside its episodes.
    """

    def __init__(
        self, seeds: int, lanes: int, discount: float, losses: tuple[str, ...], device: torch.device
    ) -> None:
        self.names = losses
        # Leading axis of two: the discounted return, and the plain sum of rewards.
        self._factors = torch.tensor([discount, 1.0], device=device)[:, None, None]
        self.running = torch.zeros(2, seeds, lanes, device=device)
        self.weights = torch.ones(2, seeds, lanes, device=device)
        # The last column takes what is not an episode's end, so that no shape depends on the data.
        self.window = torch.zeros(2, seeds, WINDOW + 1, device=device)
        self.episodes = torch.zeros(seeds, dtype=torch.int64, device=device)
        self.losses = torch.zeros(seeds, len(losses), device=device)
        self.updates = torch.zeros((), device=device)

    def record(self, rewards: Tensor, done: Tensor, losses: Tensor) -> None:
        """Take in a rollout: rewards and done (S, T, L), losses (S, k) in the order of their names."""
        totals = []
        for reward, over in zip(rewards.unbind(1), done.unbind(1), strict=True):
            totals.append(torch.addcmul(self.running, self.weights, reward))
            torch.mul(totals[-1], ~over, out=self.running)
            self.weights.mul_(self._factors).masked_fill_(over, 1.0)
        finished = done.flatten(1)  # (S, T*L), in order of time
        rank = self.episodes[:, None] + finished.cumsum(1) - 1
        column = torch.where(finished, rank % WINDOW, WINDOW)
        values = torch.stack(totals, 2).flatten(2)
        self.window.scatter_(2, column.expand(2, -1, -1), values)
        self.episodes += finished.sum(1)
        self.losses += losses
        self.updates += 1

    def read(self) -> Readings:
        """Copy a curve point to the host and restart the losses' means."""
        losses = (self.losses / self.updates).tolist()
        episodes = self.episodes.tolist()
        filled = [min(n, WINDOW) for n in episodes]
        returns = [self.window[0, i, :n].mean().item() if n else math.nan for i, n in enumerate(filled)]
        successes = [
            (self.window[1, i, :n] > 0).float().mean().item() if n else math.nan for i, n in enumerate(filled)
        ]
        self.losses.zero_()
        self.updates.zero_()
        by_name = {name: [row[k] for row in losses] for k, name in enumerate(self.names)}
        return Readings(returns, successes, episodes, by_name)

    def state(self) -> dict[str, Tensor]:
        """Return the tensors that a checkpoint must hold."""
        names = ("running", "weights", "window", "episodes", "losses", "updates")
        return {name: getattr(self, name) for name in names}
