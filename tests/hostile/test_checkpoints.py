"""A damaged checkpoint is named, set aside, and costs no more than the work it held."""

from __future__ import annotations

import logging
import pathlib
import pickle

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.training import checkpoint as checkpoints
from bgn.training import trainer
from bgn.training.checkpoint import DamagedCheckpointError
from bgn.training.trainer import train_cell
from tests.effort import effort
from tests.hostile.mutation import mutate, refusal
from tests.training.test_trainer import assert_identical, cell

CONTENT = {
    "spec": {"domain": "hallway", "env_steps": 80, "hyperparameters": {"lanes": 16, "tf32": False}},
    "seeds": [0, 1],
    "state": {"values": torch.arange(600.0), "episodes": torch.zeros(2, dtype=torch.int64)},
    "done": 3,
    "curves": [[{"env_steps": 80, "return_100": 0.5}], []],
    "seconds": [1.5, 1.25],
}


class Attack:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("raise SystemExit('code was run')",)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tmp_path_factory.mktemp("checkpoints") / "stack.checkpoint"


@settings(max_examples=effort(300, 20_000))
@given(seed=st.integers(0, 2**63))
def test_damaged_checkpoints(path: pathlib.Path, seed: int) -> None:
    checkpoints.save(path, CONTENT)
    path.write_bytes(
        mutate(path.read_bytes(), seed, [b"PK\x03\x04", b"data.pkl", b"ctorch\n", b"c__builtin__\nexec\n"])
    )

    def read() -> None:
        content = checkpoints.load(path)
        assert content is not None
        checkpoints.check(path, content, CONTENT)

    refused = refusal(read, DamagedCheckpointError)
    assert refused is None or str(path) in refused


def test_no_code_is_run(path: pathlib.Path) -> None:
    for content in (pickle.dumps(Attack()), pickle.dumps({"state": Attack()})):
        path.write_bytes(content)
        with pytest.raises(DamagedCheckpointError, match="is not a checkpoint"):
            checkpoints.load(path)
    torch.save({"state": Attack()}, path)
    with pytest.raises(DamagedCheckpointError, match="is not a checkpoint"):
        checkpoints.load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"done": "3"}, "done is a str, not a int"),
        ({"more": 1}, "it has too much or lacks more"),
        ({"state": {"values": torch.zeros(3)}}, "state has too much or lacks episodes"),
        (
            {"state": {**CONTENT["state"], "values": torch.zeros(3)}},
            r"state.values is \(3,\) torch.float32, not \(600,\)",
        ),
    ],
)
def test_checkpoints_of_another_version(path: pathlib.Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(DamagedCheckpointError, match=message):
        checkpoints.check(path, {**CONTENT, **changes}, CONTENT)


def test_work_starts_over_from_a_damaged_checkpoint(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(trainer, "CHECKPOINT_SECONDS", -1.0)
    path = tmp_path / "stack.checkpoint"
    spec = cell("ah-cs", "rocksample-4-4", updates=8)
    whole = train_cell(spec, (0,), checkpoint=path)
    path.write_bytes(path.read_bytes()[:-1000])
    with caplog.at_level(logging.WARNING):
        again = train_cell(spec, (0,), checkpoint=path)
    assert_identical(whole[0], again[0])
    assert f"{path} is not a checkpoint" in caplog.text
    assert "set aside as stack.damaged, and its runs start over" in caplog.text
    assert {file.name for file in tmp_path.iterdir()} == {"stack.checkpoint", "stack.damaged"}
