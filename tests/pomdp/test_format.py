from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn import domains
from bgn.pomdp.errors import PomdpFormatError
from bgn.pomdp.model import ModelError
from bgn.pomdp.reader import load, loads
from bgn.pomdp.writer import dumps, save
from tests.pomdp._models import models, random_model

TIGER = """\
# Kaelbling's tiger, with most forms of the format
discount: 0.95
values: reward
states: left right
actions: listen open-left open-right
observations: hear-left hear-right

start: uniform

T: listen identity
T: open-left uniform
T: open-right
uniform

O: listen
0.85 0.15
0.15 .85   # a comment after a row
O: open-left uniform
O: open-right uniform

R: listen : * : * : * -1
R: open-left : left : * : * -100
R: open-left : right : * : * 1e1
R: open-right : left : * : * +10.0
R: open-right : right : * : * -100
"""

TINY = """\
discount: 0.9
values: reward
states: a b c
actions: go stay
observations: x y
{start}
T: * identity
O: * uniform
{entries}
"""


def tiny(entries: str = "", start: str = ""):
    return loads(TINY.format(entries=entries, start=start))


def assert_equal(one, other):
    for mine, theirs in zip(one.dense(), other.dense(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(one.start, other.start)
    np.testing.assert_array_equal(one.reset, other.reset)
    assert one.discount == other.discount
    assert one.state_names == other.state_names
    assert one.action_names == other.action_names
    assert one.observation_names == other.observation_names


def test_tiger():
    model = loads(TIGER)
    T, O, R = model.dense()
    np.testing.assert_array_equal(T, [np.eye(2), np.full((2, 2), 0.5), np.full((2, 2), 0.5)])
    np.testing.assert_array_equal(O[0], [[0.85, 0.15], [0.15, 0.85]])
    np.testing.assert_array_equal(O[1:], np.full((2, 2, 2), 0.5))
    np.testing.assert_array_equal(R[:, :, 1, 1], [[-1, -1], [-100, 10], [10, -100]])
    np.testing.assert_array_equal(model.start, [0.5, 0.5])
    assert model.discount == 0.95
    assert not model.reset.any()
    assert model.action_names == ("listen", "open-left", "open-right")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("", [1 / 3, 1 / 3, 1 / 3]),
        ("start: uniform", [1 / 3, 1 / 3, 1 / 3]),
        ("start: 0.2 0.3 0.5", [0.2, 0.3, 0.5]),
        ("start:\n0.2 # a comment\n0.3\t0.5", [0.2, 0.3, 0.5]),
        ("start: b", [0, 1, 0]),
        ("start: 2", [0, 0, 1]),
        ("start include: a 2", [0.5, 0, 0.5]),
        ("start exclude: a", [0, 0.5, 0.5]),
    ],
)
def test_start_forms(line, expected):
    np.testing.assert_array_equal(tiny(start=line).start, expected)


def test_a_single_state_starts_there():
    text = (
        "discount: 1 values: reward states: 1 actions: 1 observations: 1 start: {} T: 0 identity O: 0 uniform"
    )
    for start in ("0", "1", "1.0", "uniform"):
        assert loads(text.format(start)).start == 1.0


@pytest.mark.parametrize(
    ("entries", "rows"),
    [
        ("T: go : a : b 1\nT: go : a : a 0", [0, 1, 0]),
        ("T:go:a:a .25\nT:go:a:b .75", [0.25, 0.75, 0]),
        ("T: 0 : 0 : * 0.2\nT: go : a : c 0.6", [0.2, 0.2, 0.6]),
        ("T: go : a\n0.5 0.25 0.25", [0.5, 0.25, 0.25]),
        ("T: go : * uniform", [1 / 3, 1 / 3, 1 / 3]),
        ("T: *\n0 1 0\n1 0 0\n1 0 0", [0, 1, 0]),
        ("T: go : a reset", [1 / 3, 1 / 3, 1 / 3]),
        ("T: go : a reset\nT: go : a : c 1", [0, 0, 1]),
        ("T : go # the action\n : a # the state\n : b 1\nT: go : a : a 0", [0, 1, 0]),
    ],
)
def test_transition_forms(entries, rows):
    model = tiny(entries)
    np.testing.assert_array_equal(model.dense()[0][0, 0], rows)
    assert model.reset[0, 0] == entries.endswith("reset")


@pytest.mark.parametrize(
    ("entries", "row"),
    [
        ("O: go : b : x 1\nO: go : b : y 0", [1, 0]),
        ("O: * : b 0.25 0.75", [0.25, 0.75]),
        ("O: go 1 0 0.75 0.25 0 1", [0.75, 0.25]),
        ("O: * : * : x 0\nO: * : * : 1 1", [0, 1]),
        ("O: go : b 1 0\nO: go : b uniform", [0.5, 0.5]),
    ],
)
def test_observation_forms(entries, row):
    np.testing.assert_array_equal(tiny(entries).dense()[1][0, 1], row)


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ("R: go : a : b : y 3", 3.0),
        ("R: * : * : * : * -1.5e-1", -0.15),
        ("R: go : a : b 1 2", 2.0),
        ("R: go : a 1 2 3 4 5 6", 4.0),
        ("R: go : a 1 2 3 4 5 6\nR: * : * : b : y 7", 7.0),
        ("R: * : * : b : y 7\nR: go : a 1 2 3 4 5 6", 4.0),
        ("R: stay : a : b : y 3", 0.0),
        ("", 0.0),
    ],
)
def test_reward_forms(entries, expected):
    assert tiny(entries).dense()[2][0, 0, 1, 1] == expected


def test_costs_are_negative_rewards():
    text = TINY.format(start="", entries="R: go : * : * : * 2").replace("values: reward", "values: cost")
    rewards = loads(text).dense()[2]
    assert (rewards[0] == -2).all()
    assert not np.signbit(rewards[1]).any()


def test_any_order_line_endings_and_counts():
    text = "observations: 2\r\nactions:\r\n go\r\n stay\r\nstart: 1\r\nvalues: reward\r\nstates: 3\t"
    model = loads(text + "discount: .5 T: * identity O: * uniform")
    assert model.state_names == ("0", "1", "2")
    assert model.observation_names == ("0", "1")
    assert model.start.tolist() == [0, 1, 0]


def test_a_file_of_a_windows_editor(tmp_path):
    path = tmp_path / "tiger.pomdp"
    path.write_bytes(b"\xef\xbb\xbf# caf\xe9\r\n" + TIGER.replace("\n", "\r\n").encode())
    assert_equal(load(path), loads(TIGER))


HEAD = "discount: 0.9\nvalues: reward\nstates: a b\nactions: go\nobservations: x y\n"
BODY = "T: go identity\nO: go uniform\n"


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("", "1:1", "expected a 'discount:' declaration"),
        (HEAD.replace("discount: 0.9\n", "") + BODY, "5:1", "expected a 'discount:' declaration"),
        (
            HEAD.replace("0.9", "1.5") + BODY,
            "1:11",
            "a probability between 0 and 1 for the discount, found 1.5",
        ),
        (HEAD.replace("0.9", "0.9 0.8") + BODY, "1:11", "expected 1 number(s) for the discount, found 2"),
        (HEAD + "discount: 0.8\n" + BODY, "6:1", "'discount:' was already declared on line 1"),
        (HEAD + "states: 3\n" + BODY, "6:1", "'states:' was already declared on line 3"),
        (HEAD.replace("reward", "money") + BODY, "2:9", "expected 'cost' or 'reward', found 'money'"),
        (HEAD.replace("a b", "0") + BODY, "3:9", "expected 1 to 1000000 states, found 0"),
        (HEAD.replace("a b", "9" * 5000) + BODY, "3:9", "expected 1 to 1000000 states"),
        (HEAD.replace("a b", "1000000").replace("go", "p q") + BODY, "6:1", "found 2000000"),
        (HEAD.replace("a b", "a b a") + BODY, "3:13", "state 'a' is named twice"),
        (HEAD.replace("a b", "a uniform") + BODY, "3:11", "'uniform' is a keyword"),
        (HEAD.replace("a b", "a T") + BODY, "3:11", "'T' is a keyword"),
        (HEAD.replace("a b", "1a b") + BODY, "3:9", "expected a count or a name (a letter"),
        (HEAD.replace("a b", "-2") + BODY, "3:9", "expected a count or a name (a letter"),
        (HEAD + "start: c\n" + BODY, "6:8", "unknown state 'c'; expected one of a, b"),
        (HEAD + "start: 2\n" + BODY, "6:8", "state index 2 is out of range; expected 0 to 1"),
        (HEAD + "start: 0.5 0.6\n" + BODY, "6:8", "sums to 1, found a sum of 1.1"),
        (HEAD + "start: 1.5 -.5\n" + BODY, "6:8", "expected a probability between 0 and 1"),
        (
            HEAD + "start: .5 .25 .25\n" + BODY,
            "6:8",
            "expected 2 number(s) for the start distribution, found 3",
        ),
        (HEAD + "start: reset\n" + BODY, "6:8", "unknown state 'reset'"),
        (HEAD + "start exclude: a 1\n" + BODY, "6:18", "every one is excluded"),
        (HEAD + BODY + "start: a\n", "8:1", "expected an entry"),
        (HEAD + BODY + "E: a\n", "8:1", "expected an entry"),
        (HEAD + "T: jump identity\n", "6:4", "unknown action 'jump'; expected one of go"),
        (HEAD + BODY + "T: go : a : z 1\n", "8:13", "unknown state 'z'"),
        (HEAD + BODY + "T: go :\n  7 : a 1\n", "9:3", "state index 7 is out of range; expected 0 to 1"),
        (HEAD + BODY + "T: go # : z\n : z : a 1\n", "9:4", "unknown state 'z'"),
        (HEAD + BODY + "O: go : a : z 1\n", "8:13", "unknown observation 'z'"),
        (HEAD + BODY + "T: go : a : b -0.5\n", "8:15", "a probability between 0 and 1"),
        (HEAD + BODY + "T: go : a : b 1.5\n", "8:15", "a probability between 0 and 1"),
        (HEAD + BODY + "T: go : a\n0.5\n1.5\n", "10:1", "a probability between 0 and 1"),
        (HEAD + BODY + "T: go : a : b 0.5\n", "8:1", "row 'T: go : a' to sum to 1, found a sum of 1.5"),
        (HEAD + BODY + "O: go : b 0.5 0.4\n", "8:1", "row 'O: go : b' to sum to 1, found a sum of 0.9"),
        (HEAD + "T: go : a : a 1\nO: go uniform", "7:14", "an entry for the row 'T: go : b'"),
        (
            HEAD + BODY + "T: go\n1 0\n0\n",
            "9:1",
            "expected 4 number(s) for a matrix of T (2 rows of 2), found 3",
        ),
        (HEAD + BODY + "T: go : a 1 0 0\n", "8:11", "expected 2 number(s) for a row of T, found 3"),
        (HEAD + BODY + "T: go : a : b 0 1\n", "8:15", "expected 1 number(s) for a probability, found 2"),
        (HEAD + BODY + "T: go reset\n", "8:7", "expected 'identity' or 'uniform' or a number, found 'reset'"),
        (HEAD + BODY + "O: go : a reset\n", "8:11", "expected 'uniform' or a number, found 'reset'"),
        (HEAD + BODY + "O: go identity\n", "8:7", "expected 'uniform' or a number, found 'identity'"),
        (HEAD + BODY + "R: go : a : b : x nan\n", "8:19", "expected a number, found 'nan'"),
        (HEAD + BODY + "R: go : a : b : x -inf\n", "8:19", "expected a number, found '-inf'"),
        (HEAD + BODY + "R: go : a : b : x 1e999\n", "8:19", "expected a finite number for a reward"),
        (HEAD + BODY + "R: go : a : b 1\n", "8:15", "expected 2 number(s) for a row of R, found 1"),
        (HEAD + BODY + "R: go : a 1 2 3\n", "8:11", "expected 4 number(s) for a matrix of R"),
        (HEAD + BODY + "T: go : a :", "8:11", "found ':'"),
        (HEAD + BODY + "T: go : a", "8:10", "found the end of the file"),
        (HEAD + BODY + "T: go : a : b 0.5.5\n", "8:15", "expected a number, found '0.5.5'"),
        (HEAD + BODY + "T: go : a : b 1 ; T\n", "8:17", "found ';'"),
        (HEAD + BODY + "hello\n", "8:1", "expected an entry"),
        ("\0\0\0", "1:1", "expected"),
    ],
)
def test_a_bad_file_is_rejected_with_its_place(text, place, message):
    with pytest.raises(PomdpFormatError) as caught:
        loads(text, source="bad.pomdp")
    assert str(caught.value).startswith(f"bad.pomdp:{place}: ")
    assert message in caught.value.message


def test_the_source_is_the_path(tmp_path):
    path = tmp_path / "empty.pomdp"
    path.write_text("")
    with pytest.raises(PomdpFormatError, match=r"empty\.pomdp:1:1: "):
        load(path)


def test_sums_may_be_off_by_printed_decimals():
    tiny("T: go : a 0.333333 0.333333 0.333333")
    with pytest.raises(PomdpFormatError, match=r"sum of 0\.99996"):
        tiny("T: go : a 0.33332 0.33332 0.33332")


@settings(max_examples=100, deadline=None)
@given(models())
def test_round_trip(model):
    assert_equal(loads(dumps(model, comment="two\nlines")), model)


def test_round_trip_of_a_file(tmp_path):
    model = random_model(np.random.default_rng(1), 30, 4, 5)
    save(model, tmp_path / "model.pomdp", comment="Random.")
    assert_equal(load(tmp_path / "model.pomdp"), model)


def test_names_that_the_format_lacks_are_refused():
    model = random_model(np.random.default_rng(1), 2, 1, 2)
    for names in (("a b", "c"), ("uniform", "b"), ("a", "a"), ("1", "0")):
        object.__setattr__(model, "state_names", names)
        with pytest.raises(ModelError, match="name"):
            dumps(model)


def test_a_reset_row_other_than_the_start_is_refused():
    model = random_model(np.random.default_rng(1), 2, 1, 2)
    object.__setattr__(model, "start", np.array([0.25, 0.75]))
    model.reset[:] = True
    with pytest.raises(ModelError, match=r"reset row of \(a0, s-0_\) is not the start"):
        dumps(model)


def corpus():
    return [TIGER, TINY.format(start="start: 0.2 0.3 0.5", entries="T: go : a reset\nR: go : a 1 2 3 4 5 6")]


PIECES = [
    "\n",
    " ",
    ":",
    "*",
    "#",
    "T",
    "O:",
    "R: ",
    "reset",
    "uniform",
    "identity",
    "0",
    "9",
    "-1",
    "1e9",
    ".",
    "nan",
]


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_a_damaged_file_loads_or_is_rejected(data):
    """Whatever happens to a file, it is read or refused in its own words: no other exception, no hang."""
    text = data.draw(
        st.sampled_from([*corpus(), *map(dumps, [random_model(np.random.default_rng(2), 3, 2, 2)])])
    )
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(text)))
        j = data.draw(st.sampled_from([i, i, min(i + 1, len(text)), min(i + 9, len(text)), len(text)]))
        text = text[:i] + data.draw(st.sampled_from(PIECES) | st.text(max_size=3)) + text[j:]
    try:
        loads(text)
    except PomdpFormatError as caught:
        error = caught
    else:
        return
    assert 1 <= error.line <= text.count("\n") + text.count("\r") + 1
    assert error.column >= 1


@pytest.mark.parametrize(
    "text",
    [
        "T" + " " * 100_000,
        "discount: " + "1" * 200_000 + "x",
        "T: a" + " # b" * 50_000,
        HEAD + "R: go : a : a : x " + "1 " * 100_000,
    ],
)
def test_pathological_text_is_rejected_quickly(text):
    with pytest.raises(PomdpFormatError):
        loads(text)


@pytest.mark.parametrize("domain_id", ["hallway", "rocksample-4-4"])
def test_domains_round_trip(domain_id):
    model = domains.get(domain_id).model.joint
    assert_equal(loads(dumps(model)), model)
