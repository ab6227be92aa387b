"""Feeds a learner its random numbers and schedules; on a GPU, replays its update as one CUDA graph."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from bgn.training.learners.protocol import Learner
from bgn.training.random_streams import Purpose, RandomStreams

#: Updates whose random numbers are drawn at once.
BLOCK = 64
#: Updates run before a graph is captured, so that every library has set itself up.
WARM_UP = 3
#: Captures of cells that run side by side take turns.
_CAPTURING = threading.Lock()


@contextmanager
def own_stream(device: torch.device) -> Iterator[None]:
    """On a GPU, give this thread's work a stream of its own, so that cells in other threads run beside it."""
    if device.type != "cuda":
        yield
        return
    with torch.cuda.stream(torch.cuda.Stream(device)):  # type: ignore[no-untyped-call]
        yield


class UpdateRunner:
    """Runs the updates of one learner, in order or from where a checkpoint left off."""

    def __init__(self, learner: Learner, total_updates: int, *, tf32: bool = False) -> None:
        self.learner, self.shape = learner, learner.shape
        device = learner.device
        self._streams = RandomStreams(learner.seeds, Purpose.TRAINING, device)
        self._block_index = -1
        self._schedule = learner.schedule(total_updates).to(device)
        steps, lanes, width = self.shape
        self._variates = torch.zeros(steps, len(learner.seeds) * lanes, width, device=device)
        self._scheduled = torch.zeros_like(self._schedule[0])
        self._graph: torch.cuda.CUDAGraph | None = None
        if device.type == "cuda":
            torch.backends.cuda.matmul.allow_tf32 = tf32

    def update(self, index: int) -> None:
        """Run update ``index`` of the run."""
        steps, lanes, width = self.shape
        block, place = divmod(index, BLOCK)
        if block != self._block_index:
            self._block = self._streams.block(block, BLOCK * steps, lanes, width)
            self._block_index = block
        self._variates.copy_(self._block[place * steps : (place + 1) * steps])
        self._scheduled.copy_(self._schedule[index])
        if self.learner.device.type == "cuda":
            self._replay()
        else:
            self.learner.update(self._variates, self._scheduled)

    def _replay(self) -> None:
        if self._graph is None:
            self._graph = self._capture()
        self._graph.replay()

    def _capture(self) -> torch.cuda.CUDAGraph:
        """Capture one update; the learner's state is as before, since warming up is undone."""
        before = {name: tensor.clone() for name, tensor in self.learner.state().items()}
        graph = torch.cuda.CUDAGraph()
        with _CAPTURING:
            stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                for _ in range(WARM_UP):
                    self.learner.update(self._variates, self._scheduled)
            torch.cuda.current_stream().wait_stream(stream)
            # Thread-local: what cells in other threads do meanwhile must not spoil the capture.
            with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
                self.learner.update(self._variates, self._scheduled)
        self.learner.load_state(before)
        return graph
