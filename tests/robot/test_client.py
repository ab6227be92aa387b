"""The unmodified field client on the twin: it connects, moves, stops and recovers; and one whole short session."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from bgn.robot.twin.client import TwinProcess
from tests.robot.conftest import Evaluation
from tests.waiting import await_


def test_it_connects_moves_stops_and_recovers(twin: TwinProcess) -> None:
    rtde_control = pytest.importorskip("rtde_control")
    rtde_receive = pytest.importorskip("rtde_receive")
    twin.client.ask("scale", scale=2)
    receive = rtde_receive.RTDEReceiveInterface(twin.host)  # all 58 variables of its default
    control = rtde_control.RTDEControlInterface(twin.host)
    try:
        pose = np.array(receive.getActualTCPPose())
        np.testing.assert_allclose(pose[:3], [-0.45, 0.0, 0.254], atol=1e-4)
        there = pose - [0, 0.06, 0, 0, 0, 0]
        assert control.moveL(there.tolist(), 0.2, 1.0)
        np.testing.assert_allclose(receive.getActualTCPPose()[:3], there[:3], atol=1e-3)

        assert control.moveL(pose.tolist(), 0.02, 0.5, True)
        time.sleep(0.2)
        control.stopL(2.0)
        assert control.isSteady() or np.linalg.norm(receive.getActualTCPSpeed()[:3]) < 0.02
        assert twin.client.wait_for_rest()["tool"][1] < pose[1] - 0.001

        assert not control.moveL([-2.0, 0, 0.2, np.pi, 0, 0], 0.1, 0.5)  # out of reach: the program ends
        assert not control.isProgramRunning()
        assert control.reuploadScript()
        await_(control.isProgramRunning, "a program that runs", seconds=3)
        joints = receive.getActualQ()
        joints[5] += 0.1
        assert control.moveJ(joints, 0.5, 1.0)
        assert control.getTCPOffset()[2] == pytest.approx(0.15)
        assert control.triggerProtectiveStop() in (True, False)
        await_(
            receive.isProtectiveStopped, "a protective stop", seconds=3
        )  # its stream comes after the answer
    finally:
        control.disconnect()
        receive.disconnect()


def test_a_whole_episode_ends_in_the_table(evaluation: Evaluation) -> None:
    outcome = evaluation.run("--require-success", "1", scale=8)
    assert outcome.code == 0, outcome.said
    assert "1/1   100 %" in outcome.said
    assert outcome.last.outcome == "success"
    raw = outcome.raw()
    assert raw.time.is_monotonic_increasing
    kinds = set(outcome.events().kind)
    assert {"move_line", "gripper", "outcome"} <= kinds


@pytest.mark.twin
def test_the_raw_recording_is_dense(evaluation: Evaluation) -> None:
    """In real time there are at least 125 rows a second."""
    if os.getloadavg()[0] > (os.cpu_count() or 1):
        pytest.skip("this machine is too busy to keep real time")
    outcome = evaluation.run(faults=("stop-program@5+0.3",))
    assert outcome.code == 18
    assert np.median(np.diff(outcome.raw().time)) <= 1 / 125 + 1e-6
