"""A damaged policy of alpha vectors is refused in its own words."""

from __future__ import annotations

import itertools
import pathlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bgn.policies.alpha_file import PolicyFormatError, load
from tests.effort import effort
from tests.hostile.mutation import mutate, refusal
from tests.policies.test_alpha_file import DENSE

PIECES = [
    *(
        b"<",
        b">",
        b"</Vector>",
        b"<Entry>1 2</Entry>",
        b"&lt;",
        b"&x;",
        b"<!-- ",
        b'obsValue="2"',
        b" 1e999",
        b"-1 3",
    ),
    b'<!DOCTYPE a [<!ENTITY x "yyyyyyyyyy">]>',
]
BOMB = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "0 0 0 0 0 0 0 0 0 0">{}]><Policy>&{};</Policy>'


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tmp_path_factory.mktemp("alpha") / "damaged.policy"


@settings(max_examples=effort(1000, 50_000))
@given(seed=st.integers(0, 2**63))
def test_damaged_policies(path: pathlib.Path, seed: int) -> None:
    path.write_bytes(mutate(DENSE.encode(), seed, PIECES))
    refused = refusal(lambda: load(path), PolicyFormatError)
    assert refused is None or refused.startswith(str(path))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('vectorLength="2"', f'vectorLength="{"9" * 5000}"'), "needs vectorLength as a positive number"),
        (('vectorLength="2"', 'vectorLength="1000000000"'), "numbers in all; expected at most"),
        (('numObsValue="3"', 'numObsValue="1000000000"'), "numbers in all; expected at most"),
        (('action="1"', f'action="{2**70}"'), "vector 0 needs action as a number"),
        (("<Entry>1 0.5", "<Entry>-1 0.5"), "vector 1: index -1 is out of range; expected 0 to 1"),
        (("ISO-8859-1", "nothing"), "not XML"),
        (("ISO-8859-1", "shift_jis"), "not XML"),
        (("<Policy ", "<!DOCTYPE a SYSTEM 'file:///etc/passwd'><Policy "), None),
    ],
)
def test_what_must_not_get_through(path: pathlib.Path, change: tuple[str, str], message: str | None) -> None:
    path.write_text(DENSE.replace(*change))
    if message is None:
        assert load(path).actions.tolist() == [1, 3, 2]  # and nothing else was read
        return
    with pytest.raises(PolicyFormatError, match=message):
        load(path)


def test_entities_do_not_blow_up(path: pathlib.Path) -> None:
    names = [chr(ord("a") + i) for i in range(12)]
    entities = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in itertools.pairwise(names))
    path.write_text(BOMB.format(entities, names[-1]))
    with pytest.raises(PolicyFormatError, match="not XML"):
        load(path)
