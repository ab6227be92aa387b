from __future__ import annotations

import pathlib

from bgn.results.environment import environment, git_state, processor


def test_environment_names_versions_and_machine() -> None:
    recorded = environment()
    assert recorded["version_torch"]
    assert processor() in str(recorded["machine"])


def test_outside_a_repository_there_is_no_commit(tmp_path: pathlib.Path) -> None:
    assert git_state(tmp_path) == (None, None)
