"""The check of a GPU finds nothing wrong with a CPU, and finds what is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from benchmarks.gpu_check import Check, Finding, main
from bgn.training.learners.a2c import A2CLearner
from bgn.training.update_runner import UpdateRunner

CPU = torch.device("cpu")
QUICK = Check(CPU, (("top-plate", "ah-cb"), ("top-plate", "ab-cb")), (0,), 3, 0.05, (1, 2))


def test_it_passes_on_a_cpu(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--device", "cpu"], run=lambda check: QUICK.run()) == 0
    text = capsys.readouterr().out
    assert text.endswith("all is well\n")
    kinds = [line.split()[0] for line in text.splitlines()[:-1]]
    assert kinds == ["device", *["equal"] * 2, *["graph"] * 2, *["beside"] * 2, *["speed"] * 2]
    assert "0 actions differ" in text


def test_a_device_that_computes_otherwise_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    update, turns = A2CLearner.update, iter([False, True])

    def wrong(self: A2CLearner, variates: torch.Tensor, weight: torch.Tensor) -> None:
        update(self, variates, weight)
        if next(turns):
            self.networks.parameters.values.mul_(1.001)

    monkeypatch.setattr(A2CLearner, "update", wrong)
    finding = QUICK._equal("top-plate", "ab-cb")
    assert finding.ok is False
    assert "parameters differ by 1.0e-03" in finding.detail


def test_a_graph_that_does_otherwise_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        UpdateRunner, "_capture", lambda self: pytest.fail("a CPU captures nothing"), raising=True
    )
    update = UpdateRunner.update
    made: list[int] = []

    def once_more(self: UpdateRunner, index: int) -> None:
        made.append(index)
        update(self, index if len(made) != 7 else index + 1)  # in the last of the three runs

    monkeypatch.setattr(UpdateRunner, "update", once_more)
    finding = QUICK._graph("top-plate", "ab-cb")
    assert finding.ok is False
    assert "differ from themselves in nothing, from eager ones in values." in finding.detail


def test_a_failing_cell_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(self: UpdateRunner, index: int) -> None:
        raise FloatingPointError("NaN")

    monkeypatch.setattr(UpdateRunner, "update", failing)
    with pytest.raises((FloatingPointError, RuntimeError)):
        QUICK._speed(2)


def test_what_is_wrong_is_counted(capsys: pytest.CaptureFixture[str]) -> None:
    def one(check: Check) -> Iterator[Finding]:
        yield Finding("equal", "a/b", False, "parameters differ")
        yield Finding("equal", "a/c", True, "nothing differs")

    assert main(["--device", "cpu"], run=one) == 1
    assert "equal    WRONG  a/b: parameters differ" in capsys.readouterr().out


def test_a_missing_gpu_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert main([]) == 2
    assert "sees no GPU" in capsys.readouterr().err
