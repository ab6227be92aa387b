from __future__ import annotations

import pathlib

import pytest
import torch

from bgn.results.environment import environment, git_state, processor


def test_environment_names_versions_and_machine() -> None:
    recorded = environment()
    assert recorded["version_torch"]
    assert processor() in str(recorded["machine"])


def test_outside_a_repository_there_is_no_commit(tmp_path: pathlib.Path) -> None:
    assert git_state(tmp_path) == (None, None)


def test_a_gpu_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: f"a fast {device}")
    environment.cache_clear()
    assert environment("cuda")["machine"] == f"{environment('cpu')['machine']}, a fast cuda"
    environment.cache_clear()
