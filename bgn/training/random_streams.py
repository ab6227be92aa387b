"""Random numbers of a run as a function of its seed and the update's index alone.

Every seed owns counter-based Philox streams, drawn on the host in blocks of updates. A run's numbers
therefore do not depend on which seeds share its stack, on the device, on threads, or on where it was
interrupted.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import torch
from torch import Tensor


class Purpose(IntEnum):
    """What a stream is for; streams of different purposes are independent."""

    TRAINING = 0
    OPENING = 1
    SAMPLED_EVALUATION = 2
    GREEDY_EVALUATION = 3


class RandomStreams:
    """Uniform variates on [0, 1) for a stack of seeds."""

    def __init__(self, seeds: tuple[int, ...], purpose: Purpose, device: torch.device) -> None:
        self._seeds, self._purpose, self._device = seeds, purpose, device

    def block(self, index: int, steps: int, lanes: int, width: int) -> Tensor:
        """Return block ``index`` as float32 (steps, S * lanes, width), seed-major in the lanes."""
        parts = [self._of_seed(seed, index, (steps, 1, lanes, width)) for seed in self._seeds]
        stacked = np.concatenate(parts, axis=1).reshape(steps, -1, width)
        return torch.from_numpy(stacked).to(self._device)

    def _of_seed(self, seed: int, index: int, shape: tuple[int, ...]) -> np.ndarray:
        # The counter's low word counts draws within a block; the next one holds the block's index.
        bits = np.random.Philox(key=[seed, int(self._purpose)], counter=[0, index, 0, 0])
        return np.random.Generator(bits).random(shape, dtype=np.float32)
