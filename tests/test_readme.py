"""What the README shows works as it stands there."""

from __future__ import annotations

import pathlib
import re

import pytest

from benchmarks import registry
from tests.benchmarks import newcomers

ROOT = pathlib.Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


def test_python(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    code = "\n".join(blocks("python"))
    assert "evidence.load" in code
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "ah-ch+bgn" in printed
    assert printed.splitlines()[-1] in ("success", "no success")


def test_a_registry_of_one_s_own(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    newcomers.forget_domains(monkeypatch)
    (text,) = blocks("toml")
    (tmp_path / "my.toml").write_text(
        text.replace("domains.tiger", "domains.example-tiger").replace("tiger =", "example-tiger =")
    )
    (tmp_path / "tiger.pomdp").write_text(newcomers.TIGER)
    benchmark = registry.load(tmp_path / "my.toml")
    assert "example-tiger" in benchmark.select_domains(None, budget=benchmark.defaults.budget)
