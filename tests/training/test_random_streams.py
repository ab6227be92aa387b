from __future__ import annotations

import numpy as np
import torch
from scipy import stats

from bgn.training.random_streams import Purpose, RandomStreams

CPU = torch.device("cpu")


def block(seeds, index=0, purpose=Purpose.TRAINING, shape=(3, 4, 2)):
    return RandomStreams(seeds, purpose, CPU).block(index, *shape)


def test_a_block_is_a_function_of_seed_purpose_and_index():
    assert torch.equal(block((5,), 9), block((5,), 9))
    streams = RandomStreams((5,), Purpose.TRAINING, CPU)
    streams.block(0, 3, 4, 2)  # what was drawn before does not matter
    assert torch.equal(streams.block(9, 3, 4, 2), block((5,), 9))


def test_lanes_go_seed_by_seed():
    stack = block((5, 1, 8))
    assert stack.shape == (3, 12, 2)
    for i, seed in enumerate((5, 1, 8)):
        assert torch.equal(stack[:, 4 * i : 4 * i + 4], block((seed,)))


def test_streams_share_no_numbers():
    """Seeds, purposes and blocks: 23 bits make chance collisions rare, equal streams would share all."""
    parts = [block((s,), i, p, (10, 10, 10)) for s in (0, 1) for i in (0, 1, 2) for p in Purpose]
    for i, one in enumerate(parts):
        for other in parts[:i]:
            assert np.intersect1d(one.numpy(), other.numpy()).size < 5
            assert abs(np.corrcoef(one.flatten(), other.flatten())[0, 1]) < 0.13


def test_variates_are_uniform_on_the_half_open_unit_interval():
    u = block((3,), shape=(100, 100, 10)).flatten().numpy()
    assert u.dtype == np.float32
    assert u.min() >= 0
    assert u.max() < 1
    assert stats.kstest(u, "uniform").pvalue > 1e-3
