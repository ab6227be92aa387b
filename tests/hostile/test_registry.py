"""A damaged registry is refused in its own words."""

from __future__ import annotations

import pathlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import registry
from benchmarks.registry import RegistryError
from tests.effort import effort
from tests.hostile.mutation import mutate, refusal

CONTENT = registry.DEFAULT_PATH.read_bytes()
PIECES = [
    *(
        b"\n",
        b"=",
        b'"',
        b"[",
        b"]",
        b"{",
        b"}",
        b".",
        b",",
        b"[presets]\n",
        b"extends = 1\n",
        b"[[presets]]\n",
    ),
    *(
        b'extends = "paper-text"\n',
        b"all = 3\n",
        b"domains = []\n",
        b"presets = 1\n",
        b"inf",
        b"true",
        b"1979-05-27",
    ),
]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tmp_path_factory.mktemp("registry") / "registry.toml"


@settings(max_examples=effort(300, 20_000))
@given(seed=st.integers(0, 2**63))
def test_damaged_registries(path: pathlib.Path, seed: int) -> None:
    path.write_bytes(mutate(CONTENT, seed, PIECES))
    refused = refusal(lambda: registry.load(path), RegistryError)
    assert refused is None or refused.startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: "x = " + "9" * 5000 + "\n" + text, "not valid TOML: Exceeds the limit"),
        (lambda text: "x = " + "[" * 100_000 + "\n" + text, "not valid TOML: "),
        (lambda text: "x = '\udc80'\n" + text, "not valid TOML: 'utf-8' codec can't decode"),
        (lambda text: "presets = 3\n", "presets: expected a table of presets"),
        (lambda text: "[presets]\na = 1\nb = {extends = 'a'}", "presets.a: expected a table"),
        (lambda text: "[presets]\na = {}\nb = {extends = 7}", "presets.b.extends: expected the name"),
        (lambda text: "[presets]\na = {all = 3}\nb = {extends = 'a'}", "presets.a.all: expected a table"),
        (
            lambda text: "[presets]\na = {domains = {hallway = 1}}\nb = {extends = 'a'}",
            "domains.hallway: expected",
        ),
        (lambda text: text.replace("tolerance = 0.05", "tolerance = inf", 1), "domains.hallway.tolerance"),
        (lambda text: text.replace("seeds = ", "seeds = 1000000000", 1), "seeds: Input should be less than"),
    ],
)
def test_what_must_not_get_through(path: pathlib.Path, damage, message: str) -> None:
    path.write_bytes(damage(CONTENT.decode()).encode(errors="surrogateescape"))
    with pytest.raises(RegistryError) as caught:
        registry.load(path)
    assert message in str(caught.value)
