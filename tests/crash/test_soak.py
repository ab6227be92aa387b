"""Random work on one store for an hour, and the same training over and over: nothing is lost, nothing piles up."""

from __future__ import annotations

import pathlib
import random

import pytest

from benchmarks import registry
from bgn.training.trainer import train_cell
from tests.crash import tiny
from tests.crash.holdings import Holdings, assert_nothing_piles_up, growth
from tests.crash.soak import Soak, repeat
from tests.effort import effort
from tests.training.test_determinism import assert_identical
from tests.training.test_trainer import cell

pytestmark = pytest.mark.skipif(not effort(False, True), reason="takes an hour: nox -s torture")

CELLS = (("ah-ch+bgn", "hallway"), ("ab-cb", "rocksample-4-4"), ("ah-cs", "top-plate"))
#: Of the time of the soak, what the trainer by itself gets.
TRAINING_SHARE = 0.1


def test_random_rounds(
    request: pytest.FixtureRequest, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = tiny.tiny_registry()
    monkeypatch.setattr(registry, "load", lambda *_: known)
    seed = request.config.getoption("--soak-seed")
    seed = random.SystemRandom().randrange(2**32) if seed is None else seed
    print(f"soak: --soak-seed {seed}")
    soak = Soak(tmp_path, seed)
    soak.prepare()
    try:
        repeat(soak.round, request.config.getoption("--soak"))
        soak.finish()
    finally:
        print(f"soak: {soak}; {growth(soak.held) if soak.held else ''}")
    assert_nothing_piles_up(soak.held)


def test_training(request: pytest.FixtureRequest) -> None:
    specs = [cell(agent, domain, updates=40) for agent, domain in CELLS]
    first = [train_cell(spec, (0, 1)) for spec in specs]
    held: list[Holdings] = []

    def work() -> None:
        for spec, results in zip(specs, first, strict=True):
            for one, other in zip(results, train_cell(spec, (0, 1)), strict=True):
                assert_identical(one, other)
        held.append(Holdings.now())

    repeat(work, TRAINING_SHARE * request.config.getoption("--soak"))
    print(f"training: {len(held)} rounds; {growth(held)}")
    assert_nothing_piles_up(held)
