"""Feeds a learner its random numbers and schedules; on a GPU, replays its update as one CUDA graph."""

from __future__ import annotations

import torch

from bgn.training.cuda import Graph
from bgn.training.learners.protocol import Learner
from bgn.training.random_streams import Purpose, RandomStreams

#: Updates whose random numbers are drawn at once.
BLOCK = 64


class UpdateRunner:
    """Runs the updates of one learner, in order or from where a checkpoint left off; :meth:`close` it in the end.

    On a GPU an update is captured as one CUDA graph, unless ``capture`` is false.
    """

    def __init__(
        self, learner: Learner, total_updates: int, *, tf32: bool = False, capture: bool | None = None
    ) -> None:
        self.learner, self.shape = learner, learner.shape
        device = learner.device
        self._streams = RandomStreams(learner.seeds, Purpose.TRAINING, device)
        self._block_index = -1
        self._schedule = learner.schedule(total_updates).to(device)
        steps, lanes, width = self.shape
        self._variates = torch.zeros(steps, len(learner.seeds) * lanes, width, device=device)
        self._scheduled = torch.zeros_like(self._schedule[0])
        self._graph: Graph | None = None
        self._captures = device.type == "cuda" if capture is None else capture
        if device.type == "cuda":
            torch.backends.cuda.matmul.allow_tf32 = tf32

    def update(self, index: int) -> None:
        """Run update ``index`` of the run.

        Raises
        ------
        bgn.training.cell.DeviceLostError
            The update cannot be captured; the process cannot use the device any more.
        """
        self._feed(index)
        if not self._captures:
            self.learner.update(self._variates, self._scheduled)
            return
        if self._graph is None:
            self._graph = self._capture()
        self._graph.replay()

    def close(self) -> None:
        """Free what is kept on a GPU for replaying."""
        if self._graph is not None:
            self._graph.close()
            self._graph = None

    def _feed(self, index: int) -> None:
        """Put the update's random numbers and scheduled values where it reads them."""
        steps, lanes, width = self.shape
        block, place = divmod(index, BLOCK)
        if block != self._block_index:
            self._block = self._streams.block(block, BLOCK * steps, lanes, width)
            self._block_index = block
        self._variates.copy_(self._block[place * steps : (place + 1) * steps])
        self._scheduled.copy_(self._schedule[index])

    def _capture(self) -> Graph:
        """Capture one update; the learner's state is as before, since warming up is undone."""
        learner = self.learner
        before = {name: tensor.clone() for name, tensor in learner.state().items()}
        return Graph(
            lambda: learner.update(self._variates, self._scheduled),
            restore=lambda: learner.load_state(before),
        )
