from __future__ import annotations

import dataclasses
import pathlib

import pytest

from bgn import domains
from bgn.agents.hyperparameters import Hyperparameters
from bgn.results import provenance
from bgn.results.provenance import Origin
from bgn.training.cell import CellSpec

SPEC = CellSpec(domain="hallway", agent="ah-ch", hyperparameters=Hyperparameters(), env_steps=100)
SOURCE = '''"""Docstring."""
def f(x: int = 1) -> str:
    """Docstring."""
    return f"{x}" + "text"
'''


def code_hash(tmp_path: pathlib.Path, source: str, name: str = "m.py") -> str:
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    (folder / "agents").mkdir(parents=True)
    (folder / "agents" / name).write_text(source)
    return provenance.code_hash(["agents"], root=folder)


def test_comments_docstrings_and_layout_do_not_count(tmp_path: pathlib.Path) -> None:
    same = (
        '# why\n"""Other."""\n\ndef f(x: int=1) -> str:\n    # how\n    return (f"{x}"\n        + \'text\')\n'
    )
    assert code_hash(tmp_path, same) == code_hash(tmp_path, SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"text"', '"test"'),
        ("= 1", "= 2"),
        ("= 1", "= True"),
        ("+", "-"),
        ("{x}", "{x!r}"),
        ("x: int", "x: float"),
    ],
)
def test_every_change_of_meaning_counts(tmp_path: pathlib.Path, old: str, new: str) -> None:
    assert old in SOURCE
    assert code_hash(tmp_path, SOURCE.replace(old, new)) != code_hash(tmp_path, SOURCE)


def test_strings_that_are_no_docstrings_count(tmp_path: pathlib.Path) -> None:
    assert code_hash(tmp_path, "x = ['a']\n") != code_hash(tmp_path, "x = ['b']\n")


def test_module_names_count(tmp_path: pathlib.Path) -> None:
    assert code_hash(tmp_path, SOURCE, "n.py") != code_hash(tmp_path, SOURCE)


def test_spec_hash_sees_every_field() -> None:
    others = [
        dataclasses.replace(SPEC, env_steps=101),
        dataclasses.replace(SPEC, hyperparameters=Hyperparameters(learning_rate=1e-3)),
        dataclasses.replace(SPEC, variant={"n": 5}),
    ]
    hashes = {provenance.spec_hash(spec) for spec in (SPEC, *others)}
    assert len(hashes) == 4
    assert provenance.spec_hash(dataclasses.replace(SPEC)) in hashes


def test_spec_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(TypeError, match="set"):
        provenance.spec_hash(dataclasses.replace(SPEC, variant={"n": {1}}))  # type: ignore[dict-item]


def test_data_hash_sees_a_changed_table_or_rule() -> None:
    domain = domains.get("hallway")
    joint = domain.model.joint
    rewards = joint.rewards.copy()
    rewards.flat[0] += 1e-9
    changed = dataclasses.replace(domain.model, joint=dataclasses.replace(joint, rewards=rewards))
    others = [
        dataclasses.replace(domain, model=changed),
        dataclasses.replace(domain, episode_limit=99),
        domains.get("hallway-2"),
    ]
    assert len({provenance.data_hash(one) for one in (domain, *others)}) == 4
    assert provenance.data_hash(dataclasses.replace(domain)) == provenance.data_hash(domain)


def test_key_depends_on_all_three() -> None:
    keys = {Origin(*parts).key for parts in ("abc", "xbc", "axc", "abx")}
    assert len(keys) == 4


def test_environment_names_versions_and_machine() -> None:
    environment = provenance.environment()
    assert environment["version_torch"]
    assert environment["machine"]


def test_outside_a_repository_there_is_no_commit(tmp_path: pathlib.Path) -> None:
    assert provenance._git_state(tmp_path) == (None, None)
