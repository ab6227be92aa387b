from __future__ import annotations

import dataclasses
import pathlib

import pytest

import bgn
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


def code_hash(tmp_path: pathlib.Path, source: str, **others: str) -> str:
    """Hash a package ``p`` whose module ``m`` holds ``source``, beside other modules."""
    package = tmp_path / str(len(list(tmp_path.iterdir()))) / "p"
    package.mkdir(parents=True)
    for name, text in {"__init__": "", "m": source, **others}.items():
        (package / f"{name}.py").write_text(text)
    return provenance.code_hash("p.m", without="p.skipped", root=package.parent)


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


@pytest.mark.parametrize(
    "statement",
    ["import p.other", "from p import other", "from p.other import x", "def f():\n    import p.other"],
)
def test_imported_modules_count_however_imported(tmp_path: pathlib.Path, statement: str) -> None:
    one = code_hash(tmp_path, statement, other="x = 1")
    two = code_hash(tmp_path, statement, other="x = 2")
    through_another = code_hash(tmp_path, "import p.between", between=statement, other="x = 1")
    assert len({one, two, through_another}) == 3


def test_other_modules_do_not_count(tmp_path: pathlib.Path) -> None:
    alone = code_hash(tmp_path, "import p.skipped")
    beside = code_hash(tmp_path, "import p.skipped", other="x = 1", skipped="import p.other")
    assert alone == beside


def test_scenes_beside_a_module_count(tmp_path: pathlib.Path) -> None:
    package = tmp_path / "p"
    package.mkdir()
    (package / "__init__.py").write_text("")
    hashes = set()
    for scene in ("<a/>", "<b/>"):
        (package / "scene.xml").write_text(scene)
        hashes.add(provenance.code_hash("p", root=tmp_path))
    assert len(hashes) == 2


def test_what_a_training_run_depends_on() -> None:
    root = pathlib.Path(bgn.__file__).parents[1]
    modules = set(provenance._closure(provenance.TRAINING_CODE, provenance.PHYSICS_CODE, root))
    assert {"bgn.agents.a2c", "bgn.training.learner", "bgn.simulation.table_world"} <= modules
    unrelated = (
        "bgn.results",
        "bgn.planning",
        "bgn.domains.hallway",
        "bgn.physics",
        "bgn.pictures.film",
    )
    assert not [name for name in modules if name.startswith(unrelated)]
    with_physics = set(provenance._closure(provenance.TRAINING_CODE, None, root))
    assert provenance.PHYSICS_CODE in with_physics - modules
    assert "bgn.physics.top_plate" in with_physics


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
