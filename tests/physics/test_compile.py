"""The shipped tables equal the definitions, are what the physics compiles to, and say when they are not."""

from __future__ import annotations

import importlib.metadata
import json
from collections import deque

import numpy as np
import pytest

from bgn.domains import outcome_table, two_bumps_1d, two_bumps_2d
from bgn.physics import compile as compiler
from bgn.physics.scene import Measurement
from bgn.physics.tasks import task_of
from bgn.physics.top_plate import TopPlateScene
from tests.domains._definitions import definition

PAIRS = {"top-plate": 374, "two-bumps-1d": 2652, "two-bumps-2d": 13616}
robots = pytest.mark.parametrize("name", sorted(PAIRS))


@robots
def test_shipped_table_equals_the_definition(name):
    table = outcome_table.load(outcome_table.SHIPPED / name)
    reading, pushed = definition(name)
    np.testing.assert_array_equal(table.reading, reading)
    np.testing.assert_array_equal(table.pushed, pushed)


@robots
def test_shipped_header_holds_the_guarantees(name):
    header = outcome_table.load(outcome_table.SHIPPED / name).header
    assert header.domain == name
    assert header.pairs == PAIRS[name]
    assert header.histories >= 4
    assert 0.25 <= header.margin < 0.5


@robots
def test_shipped_table_was_compiled_from_this_scene(name):
    header = outcome_table.load(outcome_table.SHIPPED / name).header
    version = importlib.metadata.version("mujoco")  # importing it here would fix its graphics too early
    if header.mujoco != version:
        pytest.skip(f"the table is of MuJoCo {header.mujoco}, this is {version}")
    assert compiler.key(task_of(name).scene()) == header.key


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        ("top-plate", 0),
        ("top-plate", 4),
        ("top-plate", 10),
        ("two-bumps-1d", two_bumps_1d.PAIRS.index((2, 4))),
        ("two-bumps-1d", two_bumps_1d.PAIRS.index((5, 12))),
        ("two-bumps-2d", two_bumps_2d.PAIRS.index((0, 15))),
        ("two-bumps-2d", two_bumps_2d.PAIRS.index((5, 10))),
    ],
)
def test_recompiled_sample_equals_the_table(name, hidden):
    table = outcome_table.load(outcome_table.SHIPPED / name)
    column = compiler.compile_hidden(task_of(name).scene(), hidden)
    assert column.histories >= 4
    assert column.margin >= table.header.margin - 1e-4
    reading = np.full(table.reading.shape[:2], -1)
    pushed = np.zeros_like(reading)
    for (before, action), (after, push) in column.outcomes.items():
        reading[before, action], pushed[before, action] = after, push
    np.testing.assert_array_equal(reading, table.reading[:, :, hidden])
    np.testing.assert_array_equal(pushed, table.pushed[:, :, hidden])


def test_key_depends_on_the_scene_and_its_parameters(monkeypatch):
    before = compiler.key(TopPlateScene())
    assert compiler.key(TopPlateScene(5)) == before  # lower stacks share one scene
    monkeypatch.setattr("bgn.physics.top_plate.ANGLE_EDGE", 0.05)
    assert compiler.key(TopPlateScene()) != before


class Counter:
    """A scene without physics: its third visit of reading 0 gives another outcome than the first two."""

    name, actions = "counter", 1

    def __init__(self, fickle=True, margin=0.4):
        self.queue, self.visits, self.fickle, self.margin = deque(), 0, fickle, margin

    def starts(self, hidden):
        return [0]

    def reset(self, hidden, cell):
        self.measurement = Measurement(reading=0, angle=0.0)
        return self.measurement

    def save(self):
        return self

    def restore(self, snapshot):
        self.measurement = Measurement(reading=0, angle=0.0)

    def act(self, action):
        self.visits += 1
        return Measurement(reading=int(self.fickle and self.visits == 3), angle=0.0, margin=self.margin)


def test_outcome_that_depends_on_the_history_is_refused():
    with pytest.raises(compiler.CompileError, match="depending on the history"):
        compiler.compile_hidden(Counter(), 0)


def test_outcome_close_to_its_threshold_is_refused():
    with pytest.raises(compiler.CompileError, match=r"margin of 0\.200, below 0\.25"):
        compiler.compile_hidden(Counter(fickle=False, margin=0.2), 0)


def test_reading_with_too_few_histories_is_refused():
    counter = Counter(fickle=False)
    counter.act = lambda action: counter.measurement  # every move is refused: no new history ever
    counter.starts = lambda hidden: [0] * 4
    with pytest.raises(compiler.CompileError, match="only 4 histories"):
        compiler.compile_hidden(counter, 0, histories=5)
    with pytest.raises(compiler.CompileError, match="histories >= 1"):
        compiler.compile_scene("top-plate", histories=0)


@pytest.fixture
def stored(tmp_path):
    table = outcome_table.load(outcome_table.SHIPPED / "top-plate")
    outcome_table.save(table, tmp_path / "top-plate")
    return tmp_path / "top-plate"


def test_stored_table_round_trips(stored):
    table, shipped = outcome_table.load(stored), outcome_table.load(outcome_table.SHIPPED / "top-plate")
    assert table.header == shipped.header
    np.testing.assert_array_equal(table.reading, shipped.reading)


def test_missing_table_is_a_clear_error(tmp_path):
    with pytest.raises(
        outcome_table.OutcomeTableError, match=r"no compiled table .*nothing.json; recompile it"
    ):
        outcome_table.load(tmp_path / "nothing")


def test_truncated_table_is_a_clear_error(stored):
    arrays = stored.with_suffix(".npz")
    arrays.write_bytes(arrays.read_bytes()[:100])
    with pytest.raises(outcome_table.OutcomeTableError, match=r"top-plate is damaged .*recompile it"):
        outcome_table.load(stored)


def test_table_of_another_header_is_a_clear_error(stored):
    header = json.loads(stored.with_suffix(".json").read_text()) | {"digest": "0" * 64}
    stored.with_suffix(".json").write_text(json.dumps(header))
    with pytest.raises(outcome_table.OutcomeTableError, match="not the one of its header"):
        outcome_table.load(stored)
