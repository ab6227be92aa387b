from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.training.learners.a2c import LOSSES
from bgn.training.recorder import WINDOW, Recorder

CPU = torch.device("cpu")


class NaiveRecorder:
    """One seed, a step and a lane at a time."""

    def __init__(self, lanes, discount):
        self.discount, self.rewards, self.finished = discount, [[] for _ in range(lanes)], []

    def record(self, rewards, done):
        for t in range(len(rewards)):
            for lane, episode in enumerate(self.rewards):
                episode.append(float(rewards[t, lane]))
                if done[t, lane]:
                    discounted = sum(r * self.discount**i for i, r in enumerate(episode))
                    self.finished.append((discounted, sum(episode)))
                    episode.clear()

    def means(self):
        last = self.finished[-WINDOW:]
        return np.mean([d for d, _ in last]), np.mean([total > 0 for _, total in last])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.1, 0.6]))
def test_equals_a_list_of_episodes(seed, often):
    """Few episodes, about a hundred, and far more than the window holds: up to 15 end in one update."""
    rng = np.random.default_rng(seed)
    S, T, L = 2, 5, 3
    recorder, naive = Recorder(S, L, 0.9, LOSSES, CPU), [NaiveRecorder(L, 0.9) for _ in range(S)]
    for _ in range(40):
        rewards = (rng.normal(size=(S, T, L)) * (rng.random((S, T, L)) < 0.5)).astype(np.float32)
        done = rng.random((S, T, L)) < often
        recorder.record(torch.from_numpy(rewards), torch.from_numpy(done), torch.zeros(S, len(LOSSES)))
        for i in range(S):
            naive[i].record(rewards[i], done[i])
    readings = recorder.read()
    for i in range(S):
        assert readings.episodes[i] == len(naive[i].finished)
        if naive[i].finished:
            expected = naive[i].means()
            assert (readings.return_100[i], readings.success_100[i]) == pytest.approx(expected, abs=1e-5)
        else:
            assert math.isnan(readings.return_100[i])


def test_before_the_first_episode_there_is_no_return():
    recorder = Recorder(2, 1, 1.0, LOSSES, CPU)
    done = torch.tensor([[[True]], [[False]]])
    recorder.record(torch.tensor([[[3.0]], [[4.0]]]), done, torch.zeros(2, 4))
    readings = recorder.read()
    assert readings.return_100[0] == 3
    assert readings.success_100[0] == 1
    assert math.isnan(readings.return_100[1])
    assert math.isnan(readings.success_100[1])
    assert readings.episodes == [1, 0]


def test_losses_are_means_since_the_last_reading():
    recorder = Recorder(2, 1, 1.0, LOSSES, CPU)
    nothing, going_on = torch.zeros(2, 1, 1), torch.zeros(2, 1, 1, dtype=torch.bool)
    for first in (1.0, 3.0):
        losses = torch.tensor([[first, 0, 0, torch.nan], [0, first * 10, 0, 0.5]])
        recorder.record(nothing, going_on, losses)
    by_name = recorder.read().losses
    assert by_name["entropy"] == [2, 0]
    assert by_name["actor_loss"] == [0, 20]
    assert math.isnan(by_name["belief_cross_entropy"][0])
    assert by_name["belief_cross_entropy"][1] == 0.5
    recorder.record(nothing, going_on, torch.full((2, 4), 7.0))
    assert recorder.read().losses["critic_loss"] == [7, 7]
