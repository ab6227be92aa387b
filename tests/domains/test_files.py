from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bgn import domains
from bgn.__main__ import main
from bgn.pomdp import reader

COMMITTED = Path(__file__).parents[2] / "data" / "pomdp_files"
IDS = ["hallway", "hallway-2", "rocksample-4-4", "rocksample-5-5"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    assert main(["write", "--out", str(folder)]) == 0
    return folder


@pytest.mark.parametrize("name", [f"{domain_id}.pomdp" for domain_id in IDS])
def test_writing_again_gives_the_committed_bytes(written, name):
    assert (written / name).read_bytes() == (COMMITTED / name).read_bytes()


def test_every_classic_domain_has_its_file(written):
    classic = [name for name in domains.ids() if domains.get(name).family == "classic"]
    assert {path.name for path in written.glob("*.pomdp")} == {f"{name}.pomdp" for name in classic}


@pytest.mark.parametrize("folder", ["written", "committed"])
def test_checksums(written, folder):
    files = written if folder == "written" else COMMITTED
    digests = dict(line.split("  ")[::-1] for line in (files / "SHA256SUMS").read_text().splitlines())
    assert set(digests) == {path.name for path in files.glob("*.pomdp")} >= {f"{name}.pomdp" for name in IDS}
    for name, digest in digests.items():
        assert hashlib.sha256((files / name).read_bytes()).hexdigest() == digest


@pytest.mark.parametrize("domain_id", IDS)
def test_a_file_is_its_domain(written, domain_id):
    file, model = reader.load(written / f"{domain_id}.pomdp"), domains.get(domain_id).model.joint
    for mine, theirs in zip(
        file.transitions + file.observations, model.transitions + model.observations, strict=True
    ):
        assert abs(mine - theirs).nnz == 0
    np.testing.assert_array_equal(file.rewards, model.rewards)
    np.testing.assert_array_equal(file.start, model.start)
    np.testing.assert_array_equal(file.reset, model.reset)
    assert file.discount == model.discount
    for names in ("state_names", "action_names", "observation_names"):
        assert getattr(file, names) == getattr(model, names)


def test_list_shows_every_domain_and_the_papers_sizes(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["domains"]) == 0
    shown = capsys.readouterr().out
    assert all(domain_id in shown for domain_id in domains.ids())
    assert "801 (807)" in shown
    assert "RockSample[5,5]" in shown


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["write", "--out", str(tmp_path / "file")]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_an_unknown_command_is_refused():
    run = subprocess.run([sys.executable, "-m", "bgn", "paint"], capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "invalid choice: 'paint'" in run.stderr
