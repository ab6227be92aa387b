"""The .pomdp reader meets damaged and hostile files: a model or PomdpFormatError, soon and in little memory."""

from __future__ import annotations

import itertools
import pathlib
import string
import subprocess
import sys
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.pomdp.errors import PomdpFormatError
from bgn.pomdp.model import POMDP
from bgn.pomdp.reader import load, loads
from tests.effort import effort
from tests.hostile.mutation import mutate

FILES = pathlib.Path(__file__).parents[2] / "data" / "pomdp_files"
PIECES = [
    *(b"\n", b" ", b":", b"*", b"#", b"T", b"O:", b"R: ", b"reset", b"uniform", b"identity", b"start:"),
    *(b"T: * identity\n", b"O: * uniform\n", b"T: * : * : * 0\n", b"R: * : * : * : * 1\n", b"states: 3\n"),
    *(b"start include: 0 1\n", b"values: cost\n", b"\r", b"discount: 1\n"),
]


def read(text: str) -> POMDP | None:
    """Return the model; None if the text is refused, at a place that exists."""
    try:
        return loads(text)
    except PomdpFormatError as caught:
        error = caught
    assert 1 <= error.line <= text.count("\n") + text.count("\r") + 1
    assert error.column >= 1
    assert len(error.message) < 2000
    return None


# ---------------------------------------------------------------- files that follow the grammar, mostly

NAMES = ("a", "b", "c")
REFERENCE = st.sampled_from([*NAMES, "*", "0", "1", "2", "3", "007", "0" * 5000 + "1", "9" * 5000, "T", "d"])
GAP = st.sampled_from(["", " ", "\n", "\t ", " # T: a : a : a 1\n", "#\n"])
NUMBER = st.sampled_from(["0", "1", "0.5", ".25", "1.", "+1", "1e-1", "-1", "1e999", "5e-324", "9" * 5000])
NUMBERS = st.lists(NUMBER, min_size=1, max_size=9).map(" ".join) | st.sampled_from(
    ["1 0 0", "0 0.5 0.5", ".5 .5", "1 0 0 0 1 0 0 0 1", "1 0 0 # row\n 0 1 0\n 0 0 1", "1 0\n0 1\n.5 .5"]
)
BODY = NUMBERS | st.sampled_from(["uniform", "identity", "reset", "1"])


@st.composite
def entries(draw: st.DrawFn) -> str:
    letter = draw(st.sampled_from("TTTOOORR"))
    count = draw(st.integers(1, 3 if letter != "R" else 4))
    head = "".join(f"{draw(GAP)}:{draw(GAP)}{draw(REFERENCE)}" for _ in range(count))
    return f"{letter}{head}{draw(st.sampled_from([' ', chr(10)]))}{draw(BODY)}\n"


SPACE = st.sampled_from(["3", "a b c", "a # b\nb c", "2", "a b a", "0", "1000000", "9" * 5000, "a T", ""])
PREAMBLE = st.tuples(
    st.sampled_from(["discount: 0.9", "discount: 1 1", "discount: 1e400"]),
    st.sampled_from(["values: reward", "values: cost", "values: gold"]),
    SPACE.map("states: {}".format),
    st.sampled_from(["a b", "2", "1", "1001"]).map("actions: {}".format),
    SPACE.map("observations: {}".format),
    st.sampled_from(
        [
            "",
            "start: uniform",
            "start: 1",
            "start: a",
            "start: .5 .25 .25",
            "start include: a 2",
            "start exclude: *",
        ]
    ),
)
COMPLETE = "T: * identity\nO: * uniform\n"


@settings(max_examples=effort(1000, 20_000))
@given(
    PREAMBLE, st.permutations(range(6)), st.lists(entries(), max_size=6), st.booleans(), st.integers(0, 20)
)
def test_files_of_the_grammar(
    preamble: tuple[str, ...], order: list[int], body: list[str], complete: bool, likely: int
) -> None:
    if likely:  # mostly a preamble that is in order, so that the entries are reached
        preamble = (
            "discount: 0.9",
            "values: reward",
            "states: a b c",
            "actions: a b",
            "observations: a b",
            preamble[5],
        )
    text = "\n".join(preamble[i] for i in order) + "\n" + (COMPLETE if complete else "") + "".join(body)
    model = read(text)
    if model is not None:
        assert model.n_states * model.n_actions <= 1_000_000


# ---------------------------------------------------------------- damaged real files


@settings(max_examples=effort(1000, 30_000))
@given(st.integers(0, 2**63), st.sampled_from(["hallway", "hallway-2", "rocksample-4-4"]), st.integers(0, 9))
def test_damaged_real_files(seed: int, name: str, size: int) -> None:
    content = (FILES / f"{name}.pomdp").read_bytes()
    if size:  # mostly a short one, a head and some entries, which takes a hundredth of the time
        head = content.index(b"\nT:") + 1
        at = content.index(b"\n", head + seed % (len(content) - head - 2000)) + 1
        content = content[:head] + content[at : at + 1500]
    read(mutate(content, seed, PIECES).decode("utf-8-sig", errors="replace"))


# ---------------------------------------------------------------- the worst a megabyte can ask for

MEGABYTE = 1_000_000
HEAD = "discount: 0.9\nvalues: reward\nstates: {}\nactions: {}\nobservations: {}\n"
BODY_OF = "T: * identity\nO: * uniform\n"


def repeated(head: str, piece: str, tail: str = "") -> str:
    return head + piece * ((MEGABYTE - len(head) - len(tail)) // len(piece)) + tail


def many_names() -> str:
    words = map("".join, itertools.product(string.ascii_lowercase[:6], repeat=7))
    return HEAD.format(" ".join(itertools.islice(words, MEGABYTE // 8 - 20)), 1, 1) + BODY_OF


WORST: dict[str, Callable[[], str]] = {
    "names": many_names,
    "start-include": lambda: repeated(HEAD.format(5, 2, 2) + "start include: ", "0 ", "\n" + BODY_OF),
    "single-T": lambda: repeated(HEAD.format(5, 2, 2) + BODY_OF, "T:0:0:0 1\n"),
    "single-R": lambda: repeated(HEAD.format(5, 2, 2) + BODY_OF, "R:0:0:0:0 1\n"),
    "rows-R": lambda: repeated(HEAD.format(5, 2, 2) + BODY_OF, "R:0:0:0 1 1\n"),
    "resets": lambda: repeated(HEAD.format(5, 2, 2) + BODY_OF, "T:0:0 reset\n"),
    "numbers": lambda: repeated(HEAD.format(5, 2, 2) + BODY_OF + "T: 0\n", "1 "),
    "numbers-and-comments": lambda: repeated(HEAD.format(5, 2, 2) + BODY_OF + "T: 0\n", "0 #\n"),
    "one-long-number": lambda: repeated(
        HEAD.format(5, 2, 2) + BODY_OF + "R: * : * ", "1 ", "9" * 5000 + "\n"
    ),
    "many-states": lambda: HEAD.format(1_000_000, 1, 1) + BODY_OF,
    "many-of-all": lambda: HEAD.format(1_000_000, 1, 1_000_000) + "T: * identity\nO: * : * : 0 1\n",
    "stars-one-by-one": lambda: repeated(HEAD.format(1000, 10, 2) + BODY_OF, "T: * : * : 0 1\n"),
    "stars-by-row": lambda: repeated(HEAD.format(1_000_000, 1, 2) + BODY_OF, "T: * : * reset\n"),
    "wide-rows": lambda: repeated(HEAD.format(2, 2, 400_000) + BODY_OF, "O: 0 : 0 uniform\n"),
    "wide-constants": lambda: (
        HEAD.format(2, 2, 1_000_000) + BODY_OF + "".join(f"O: 0 : 0 : * .{i}\n" for i in range(50_000))
    ),
    "dense-T": lambda: HEAD.format(2400, 1, 1) + "T: * uniform\nO: * uniform\n",
    "rewards": lambda: repeated(HEAD.format(60, 60, 50) + BODY_OF + "R:0:0:0:0 1\n", "R:*:*:*:* 1\n"),
    "declarations": lambda: repeated("", "discount: 1\n"),
    "comments": lambda: repeated(HEAD.format(3, 1, 2) + BODY_OF, "#\n"),
    "one-long-index": lambda: repeated(HEAD.format(3, 1, 2) + BODY_OF + "R: ", "0", " : 0 : 0 : 0 1"),
    "blanks": lambda: repeated("T", " "),
    "unfinished": lambda: repeated(HEAD.format(3, 1, 2) + BODY_OF + "T: 0", " # b"),
}
IN_TESTS = ("rows-R", "many-of-all", "rewards", "one-long-index")
SECONDS = 2.0

MEASURE = """
import sys, time
from bgn.pomdp.errors import PomdpFormatError
from bgn.pomdp.reader import _parser, loads
from tests.hostile.test_pomdp_files import WORST
_parser()
text = WORST[sys.argv[1]]()
began = time.process_time()
try:
    loads(text)
except PomdpFormatError as error:
    assert len(error.message) < 2000
# Not ru_maxrss, which a process inherits from the one that started it.
(peak,) = (line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM:"))
print(time.process_time() - began, peak)
"""


@pytest.mark.parametrize("name", effort(IN_TESTS, tuple(WORST)))
def test_the_worst_a_megabyte_can_ask_for(name: str) -> None:
    """512 MB and a second of a core; on one that others share, a second counts for up to two."""
    assert len(WORST[name]()) <= MEGABYTE
    command = [sys.executable, "-c", MEASURE, name]
    tries = []
    while not tries or (min(tries) > SECONDS and len(tries) < 3):
        measured = subprocess.run(command, capture_output=True, text=True, check=True, cwd=FILES.parents[1])
        seconds, kilobytes = map(float, measured.stdout.split())
        tries.append(seconds)
    print(f"{name}: {min(tries):.2f} s, {kilobytes / 1024:.0f} MB")
    assert kilobytes < 512 * 1024
    assert min(tries) < SECONDS


@pytest.mark.parametrize("what", ["states", "actions", "observations"])
def test_huge_declarations_are_refused_at_once(what: str) -> None:
    text = "discount: 1\nvalues: reward\n" + "".join(
        f"{kind}: {10**9 if kind == what else 2}\n" for kind in ("states", "actions", "observations")
    )
    with pytest.raises(PomdpFormatError, match=f"expected 1 to 1000000 {what}, found 1000000000"):
        loads(text + COMPLETE)


@pytest.mark.parametrize("index", ["9" * 5000, "0" * 5000 + "2"])
def test_an_index_of_thousands_of_digits(index: str) -> None:
    text = HEAD.format(2, 1, 1) + BODY_OF
    with pytest.raises(PomdpFormatError, match=r"state index [09]{40}… is out of range; expected 0 to 1"):
        loads(f"{text}T: 0 : {index} : 0 1\n")
    assert loads(f"{text}T: 0 : {'0' * 5000}1 : 0 1\nT: 0 : 1 : 1 0\n").transitions[0].toarray()[1, 0] == 1


def test_a_file_too_long_is_not_read(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "long.pomdp"
    with path.open("wb") as file:
        file.truncate((1 << 29) + 1)  # a hole, which takes no space
    with pytest.raises(PomdpFormatError, match=r"long\.pomdp:1:1: expected at most 536870912 bytes"):
        load(path)
