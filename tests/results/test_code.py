"""What the hash of code sees: small packages for its rules, planted edits in a copy of this one for its use."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pytest

import bgn
from bgn import domains
from bgn.results import provenance
from bgn.results.code import CodeTree, Scope
from bgn.results.data import data_hash
from bgn.results.sources import CodeError

ROOT = pathlib.Path(bgn.__file__).parents[1]
SCOPES = {
    "training": provenance.TRAINING,
    "physics": provenance.TRAINING_WITH_PHYSICS,
    "planning": provenance.PLANNING,
}
TRAINED, ALL = {"training", "physics"}, set(SCOPES)
SOURCE = '''"""Docstring."""
import math
def f(x: int = 1) -> str:
    """Docstring."""
    return f"{x}" + "text" * math.ceil(x)
'''


@pytest.fixture
def package(tmp_path: pathlib.Path) -> Hasher:
    return Hasher(tmp_path)


class Hasher:
    """Writes packages ``p`` and hashes what their ``m:f`` reaches."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder

    def tree(self, source: str, **others: str) -> CodeTree:
        root = self.folder / str(len(list(self.folder.iterdir())))
        for name, text in {"__init__": "", "m": source, **others}.items():
            path = root / "p" / f"{name.replace('__in__', '/')}.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return CodeTree(root, "p")

    def hash(self, source: str, **others: str) -> str:
        return self.tree(source, **others).hash(Scope(entries=("p.m:f",)))

    def hash_without(self, without: str, source: str, **others: str) -> str:
        return self.tree(source, **others).hash(Scope(entries=("p.m:f",), without=(without,)))


def test_comments_docstrings_annotations_and_layout_do_not_count(package: Hasher) -> None:
    same = (
        '# why\n"""Other."""\nimport math\n\ndef f(x: float=1):\n    # how\n'
        "    return (f\"{x}\"\n        + 'text' * math.ceil(x))\n"
    )
    assert package.hash(same) == package.hash(SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"text"', '"test"'),
        ("= 1", "= 2"),
        ("= 1", "= True"),
        (" + ", " - "),
        ("{x}", "{x!r}"),
        ("import math", "import numpy as math"),
        ("math.ceil", "math.floor"),
    ],
)
def test_every_change_of_what_is_executed_counts(package: Hasher, old: str, new: str) -> None:
    assert old in SOURCE
    assert package.hash(SOURCE.replace(old, new)) != package.hash(SOURCE)


@pytest.mark.parametrize(
    "source",
    [
        "from p.other import g\ndef f(): return g()",
        "from p.other import g as h\ndef f(): return h()",
        "import p.other\ndef f(): return p.other.g()",
        "from p import other as o\ndef f(): return o.g()",
        "from . import other\ndef f(): return other.g()",
        "from .other import g\ndef f(): return g()",
        "def f():\n    from p.other import g\n    return g()",
        "from p.again import g\ndef f(): return g()",
    ],
)
def test_what_is_called_counts_however_it_is_imported(package: Hasher, source: str) -> None:
    one, two = (
        package.hash(source, other=f"def g(): return {n}", again="from p.other import g") for n in (1, 2)
    )
    assert one != two
    assert one == package.hash("def g(): return 1\ndef f(): return g()")


def test_a_definition_may_be_moved_and_renamed_but_not_swapped(package: Hasher) -> None:
    caller = "from p.a import g\nfrom p.b import h\ndef f(): return g() - h()"
    before = package.hash(caller, a="def g(): return 1", b="def h(): return 2")
    renamed = "from p.c import k, l\ndef f(): return k() - l()"
    assert package.hash(renamed, c="def l(): return 2\ndef k(): return 1") == before
    assert package.hash(caller, a="def g(): return 2", b="def h(): return 1") != before


def test_definitions_that_call_each_other_have_a_hash(package: Hasher) -> None:
    source = "def f(n): return g(n - 1) if n else {}\ndef g(n): return f(n)"
    assert package.hash(source.format(0)) == package.hash(source.format(0).replace("g(", "h("))
    assert package.hash(source.format(0)) != package.hash(source.format(1))


def test_names_bound_together_are_told_apart(package: Hasher) -> None:
    source = "A, B = 1, 2\ndef f(): return {}"
    assert package.hash(source.format("A")) != package.hash(source.format("B"))


def test_what_is_not_reached_does_not_count(package: Hasher) -> None:
    source = "from p import other\ndef f(): return other.g()\n"
    other = "def g(): return 1\nT = 3\nclass C: pass\n"
    assert package.hash(source, other=other) == package.hash(
        source, other="def g(): return 1", unrelated="x = 1"
    )


@pytest.mark.parametrize(
    "effect",
    [
        "STATE.append({})",
        "STATE[0] = {}",
        "STATE += [{}]",
        "for i in range({}): STATE.append(i)",
        "@note\ndef g(): return {}",
        "LAST = note({})",
        "@note\nclass C: x = {}",
        "class C(Base): x = {}",
    ],
)
def test_what_an_imported_module_does_counts(package: Hasher, effect: str) -> None:
    source = "import p.other\ndef f(): return 1"
    state = (
        "STATE = [0]\ndef note(x):\n    STATE.append(x)\n    return x\n"
        "class Base:\n    def __init_subclass__(cls): note(cls)\n"
    )
    one, two = (package.hash(source, other=state + effect.format(n)) for n in (1, 2))
    assert one != two
    assert package.hash(source, other=state) == package.hash("def f(): return 1")
    scripts = f"if __name__ == '__main__':\n    {effect.splitlines()[0].format(1)}\n"
    if len(effect.splitlines()) == 1:
        assert package.hash(source, other=state + scripts) == package.hash(source)


def test_both_bindings_of_a_name_count(package: Hasher) -> None:
    source = "try:\n    from math import sqrt\nexcept ImportError:\n    def sqrt(x): return {}\ndef f(): return sqrt"
    assert package.hash(source.format(1)) != package.hash(source.format(2))


def test_a_module_handed_around_counts_as_a_whole(package: Hasher) -> None:
    source = "from p import other\ndef f(name): return getattr(other, name)"
    assert package.hash(source, other="A = 1") != package.hash(source, other="A = 2")
    assert package.hash(source, other="A = 1\nB = 1") != package.hash(source, other="A = 1")


def test_methods_of_what_is_handed_in_count(package: Hasher) -> None:
    source = "from p.other import C\ndef f(c: C): return c.g()"
    one, two = (package.hash(source, other=f"class C:\n    def g(self): return {n}") for n in (1, 2))
    assert one != two


def test_messages_of_errors_do_not_count_unless_an_error_may_be_swallowed(package: Hasher) -> None:
    source = "def f(x):\n    if x: raise {}\n    return g()\ndef g(): {}\n"
    plain = "return 1"
    caught = "\n    try: return f(2)\n    except ValueError: return 3"
    passed_on = "\n    try: return f(2)\n    except ValueError as error: raise KeyError from error"
    for rest, counts in ((plain, False), (passed_on, False), (caught, True)):
        hashes = {package.hash(source.format(error, rest)) for error in ("ValueError(1)", "KeyError(2)")}
        assert len(hashes) == (2 if counts else 1)


def test_what_is_left_out_is_not_followed(package: Hasher) -> None:
    source = "import p.other\nclass C:\n    def g(self): return p.other.h()\ndef f(): return C()"
    for without in ("p.other", "p.other:h", "p.m:C.g"):
        one, two = (package.hash_without(without, source, other=f"def h(): return {n}") for n in (1, 2))
        assert one == two
        assert one != package.hash(source, other="def h(): return 1")


def test_fields_of_data_count_only_as_data(package: Hasher) -> None:
    source = "class C:\n    a: int = {}\n    def g(self): return {}\ndef f(c: C): return c"
    scope = Scope(entries=("p.m:f",), data=("p.m:C",))
    hashes = [package.tree(source.format(*n)).hash(scope) for n in ((1, 1), (2, 1), (1, 2))]
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    "scope",
    [
        Scope(entries=("p.none",)),
        Scope(entries=("p.m:none",)),
        Scope(entries=("p.m:f",), without=("p.m:C.none",)),
        Scope(entries=("p.m:f",), data=("p.m:none",)),
    ],
)
def test_a_scope_that_names_nothing_is_refused(package: Hasher, scope: Scope) -> None:
    with pytest.raises(CodeError, match="none in"):
        package.tree("class C: pass\ndef f(): pass").hash(scope)


# -- this package ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    root = tmp_path_factory.mktemp("copy")
    ignored = shutil.ignore_patterns("__pycache__", "*.npz")
    shutil.copytree(ROOT / "bgn", root / "bgn", ignore=ignored)
    return root


@pytest.fixture(scope="module")
def hashes() -> dict[str, str]:
    return code_hashes(ROOT)


def code_hashes(root: pathlib.Path) -> dict[str, str]:
    tree = CodeTree(root)
    return {name: tree.hash(scope) for name, scope in SCOPES.items()}


def test_the_scopes_hold_what_runs_and_nothing_else() -> None:
    tree = CodeTree(ROOT)
    modules = {name: {one.partition(":")[0] for one in tree.reached(scope)} for name, scope in SCOPES.items()}
    core = {"bgn.agents.a2c", "bgn.simulation.table_world", "bgn.training.evaluation", "bgn.domains.domain"}
    assert core <= modules["training"] < modules["physics"]
    assert {"bgn.physics.top_plate", "bgn.physics.scene"} <= modules["physics"]
    assert {"bgn.planning.sarsop", "bgn.planning.deterministic"} <= modules["planning"]
    strangers = ("reader", "writer", "registration", "layout", "pictures", "results", "analysis", "registry")
    for name, found in modules.items():
        assert not [module for module in found if module.endswith(strangers) or ".pictures." in module]
        assert name == "physics" or not [module for module in found if module.startswith("bgn.physics")]
    assert not [
        one
        for one in tree.reached(SCOPES["physics"])
        if one.endswith(("TopPlateLayout", "top_plate:top_plate"))
    ]


EDITS = [
    # What a learner computes
    ("bgn/agents/a2c.py", "2 * weight", "3 * weight", TRAINED),
    ("bgn/agents/a2c.py", "DISCOUNT = 0.99", "DISCOUNT = 0.98", TRAINED),
    ("bgn/agents/layers.py", "beta=2, alpha=2", "beta=1, alpha=2", TRAINED),
    ("bgn/agents/parameters.py", "ALIGNMENT = 16", "ALIGNMENT = 32", TRAINED),
    ("bgn/agents/specs.py", 'actor="belief", critic="belief"', 'actor="belief", critic="state"', TRAINED),
    ("bgn/training/random_streams.py", "TRAINING = 0", "TRAINING = 7", TRAINED),
    ("bgn/training/recorder.py", "WINDOW = 100", "WINDOW = 50", TRAINED),
    ("bgn/training/trainer.py", "CURVE_POINTS = 240", "CURVE_POINTS = 200", TRAINED),
    # The world
    ("bgn/simulation/table_world.py", "self.steps += 1", "self.steps += 2", ALL),
    (
        "bgn/simulation/compiled_tables.py",
        "MAX_LISTED_PREDECESSORS = ",
        "MAX_LISTED_PREDECESSORS = 1 + ",
        ALL,
    ),
    ("bgn/pomdp/model.py", "SUM_TOLERANCE = 1e-5", "SUM_TOLERANCE = 1e-4", ALL),
    # The evaluation
    ("bgn/training/evaluation.py", "BATCH = 500", "BATCH = 400", TRAINED),
    ("bgn/training/evaluation.py", "(totals > 0)", "(totals >= 0)", TRAINED),
    # Physics
    ("bgn/physics/scene.py", "SOFT: Final = 0.2", "SOFT: Final = 0.3", {"physics"}),
    ("bgn/physics/top_plate.py", "PITCH: Final = 0.08", "PITCH: Final = 0.09", {"physics"}),
    ("bgn/physics/stage.xml", "<mujoco", "<mujoco ", {"physics"}),
    ("bgn/physics/world.py", "results.mean(axis=0)", "results.max(axis=0)", {"physics"}),
    ("bgn/policies/saved.py", "torch.zeros(1, 1)", "torch.ones(1, 1)", {"physics"}),
    ("bgn/training/physics_evaluation.py", "greedy=False)", "greedy=True)", {"physics"}),
    # Planning
    ("bgn/planning/reference_rows.py", "PRECISION = 1e-3", "PRECISION = 1e-4", {"planning"}),
    ("bgn/planning/bounds.py", "MAX_SWEEPS = ", "MAX_SWEEPS = 1 + ", {"planning"}),
]
#: Domain definitions (a run sees their tables), and what no run executes.
ANNOTATIONS = "from __future__ import annotations\n"
HARMLESS_EDITS = [
    ("bgn/domains/hallway.py", "episode_limit=100", "episode_limit=99"),
    ("bgn/domains/rocksample.py", "EXIT_REWARD = 10.0", "EXIT_REWARD = 9.0"),
    ("bgn/domains/grid_navigation.py", "WALL_SEEN = 0.9", "WALL_SEEN = 0.8"),
    ("bgn/domains/domain.py", "hidden_first_action: bool = False", "hidden_first_action: bool = True"),
    ("bgn/domains/layout.py", "row 0 at the top", "row 0 above"),
    ("bgn/domains/registry.py", "maxsize=32", "maxsize=33"),
    ("bgn/agents/a2c.py", '"""A head\'s loss', '"""The loss of a head'),
    ("bgn/agents/a2c.py", "# Rounded probabilities", "# Probabilities"),
    (
        "bgn/agents/a2c.py",
        "def critic_loss(advantages: Tensor, weight: float)",
        "def critic_loss(advantages, weight)",
    ),
    ("bgn/agents/specs.py", "unknown agent", "no agent"),
    ("bgn/agents/parameters.py", "is declared twice", "is declared again"),
    ("bgn/pomdp/reader.py", ANNOTATIONS, f"{ANNOTATIONS}X = 1\n"),
    ("bgn/pomdp/writer.py", "discount: ", "discount : "),
    ("bgn/pomdp/grammar.lark", "//", "// "),
    ("bgn/environments/registration.py", '"bgn/', '"bgn-'),
    ("bgn/analysis/tables.py", "_CI = 1.96", "_CI = 2.0"),
    ("bgn/analysis/paper.py", ANNOTATIONS, f"{ANNOTATIONS}X = 1\n"),
    ("bgn/analysis/figures/curves.py", ANNOTATIONS, f"{ANNOTATIONS}print(1)\n"),
    ("bgn/pictures/maps.py", ANNOTATIONS, f"{ANNOTATIONS}print(1)\n"),
    ("bgn/results/store.py", '"zstd"', '"snappy"'),
    ("bgn/results/schema.py", '"env_steps",', '"env_steps", "more",'),
    ("bgn/errors.py", "len(self.args) == 1", "len(self.args) == 2"),
    ("bgn/training/checkpoint.py", "torch.save(content", "torch.save({} or content"),
    ("bgn/training/cuda.py", "WARM_UP = 3", "WARM_UP = 4"),
]


@pytest.mark.parametrize(("file", "old", "new", "changed"), EDITS)
def test_an_edit_changes_the_keys_it_should(
    copied: pathlib.Path, hashes: dict[str, str], file: str, old: str, new: str, changed: set[str]
) -> None:
    with edited(copied, [(file, old, new)]):
        after = code_hashes(copied)
    assert {name for name in SCOPES if after[name] != hashes[name]} == changed


def test_edits_of_what_no_run_executes_change_no_key(copied: pathlib.Path, hashes: dict[str, str]) -> None:
    with edited(copied, HARMLESS_EDITS):
        assert code_hashes(copied) == hashes


@contextlib.contextmanager
def edited(root: pathlib.Path, edits: Iterable[tuple[str, str, str]]) -> Iterator[None]:
    """Plant edits, and undo them."""
    kept: dict[pathlib.Path, str] = {}
    for file, old, new in edits:
        path = root / file
        text = path.read_text(encoding="utf-8")
        kept.setdefault(path, text)
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
    yield
    for path, text in kept.items():
        path.write_text(text, encoding="utf-8")


def test_renaming_every_module_changes_no_key(tmp_path: pathlib.Path, hashes: dict[str, str]) -> None:
    shutil.copytree(ROOT / "bgn", tmp_path / "bgn", ignore=shutil.ignore_patterns("__pycache__", "*.npz"))
    modules = [
        path for path in (tmp_path / "bgn").rglob("*.py") if path.stem[0] != "_" or path.stem[1] != "_"
    ]
    names = [".".join(path.relative_to(tmp_path).with_suffix("").parts) for path in modules]
    for path in [*modules, *(tmp_path / "bgn").rglob("__init__.py")]:
        path.write_text(rename_imports(path.read_text(encoding="utf-8"), names), encoding="utf-8")
    for path in modules:
        path.rename(path.with_stem(f"{path.stem}_moved"))
    tree = CodeTree(tmp_path)
    for name, scope in SCOPES.items():
        moved = {
            part: tuple(rename_dotted(path, names) for path in getattr(scope, part))
            for part in ("entries", "without", "data")
        }
        assert tree.hash(replace(scope, **moved)) == hashes[name]


def test_moving_a_package_or_a_definition_changes_no_key(
    tmp_path: pathlib.Path, hashes: dict[str, str]
) -> None:
    shutil.copytree(ROOT / "bgn", tmp_path / "bgn", ignore=shutil.ignore_patterns("__pycache__", "*.npz"))
    (tmp_path / "bgn" / "simulation").rename(tmp_path / "bgn" / "worlds")
    for path in (tmp_path / "bgn").rglob("*.py"):
        text = path.read_text(encoding="utf-8").replace("bgn.simulation", "bgn.worlds")
        path.write_text(text, encoding="utf-8")
    evaluation = tmp_path / "bgn" / "training" / "evaluation.py"
    text, _, summary = evaluation.read_text(encoding="utf-8").partition("def _summary(")
    evaluation.write_text(
        text.replace("_summary(", "summary_of(", 1).replace(
            "import torch\n", "import torch\nfrom bgn.training.summaries import summary_of\n", 1
        )
    )
    head = "import math\nimport torch\nfrom torch import Tensor\n\n\n"
    (evaluation.parent / "summaries.py").write_text(f"{head}def summary_of({summary}")
    assert code_hashes(tmp_path) == hashes


def rename_dotted(text: str, names: Iterable[str]) -> str:
    """Append ``_moved`` to the dotted names of modules."""
    pattern = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    return re.sub(rf"\b({pattern})(?![\w])", r"\1_moved", text)


def rename_imports(text: str, names: Iterable[str]) -> str:
    """Rename modules in import statements, ``from package import module`` included."""
    known = set(names)

    def rename(line: re.Match[str]) -> str:
        package, imported = line["package"], re.split(r",\s*", line["names"].strip())
        renamed = []
        for one in imported:
            name, _, alias = one.partition(" as ")
            moved = f"{name}_moved as {alias or name}" if f"{package}.{name}" in known else one
            renamed.append(moved)
        return f"from {package} import {', '.join(renamed)} "

    text = re.sub(r"from (?P<package>bgn[\w.]*) import (?P<names>\w[\w ,]*)", rename, text)
    return rename_dotted(text, names)


def test_an_edited_domain_has_other_data_and_no_other_domain_does(copied: pathlib.Path) -> None:
    edits = [
        ("bgn/domains/hallway.py", "episode_limit=100", "episode_limit=99"),
        ("bgn/domains/rocksample.py", "EXIT_REWARD = 10.0", "EXIT_REWARD = 9.0"),
        ("bgn/domains/two_bumps_1d.py", 'title="', 'title="The '),  # for people
    ]
    for table in (ROOT / "bgn" / "domains" / "tables").glob("*.npz"):
        shutil.copy(table, copied / "bgn" / "domains" / "tables")
    script = (
        "import json; from bgn import domains; from bgn.results.data import data_hash;"
        "print(json.dumps({name: data_hash(domains.get(name)) for name in domains.ids()}))"
    )
    environment = {**os.environ, "PYTHONPATH": str(copied)}
    command = [sys.executable, "-c", script]
    with edited(copied, edits):
        printed = subprocess.run(command, env=environment, capture_output=True, check=True, cwd=copied)
    after = json.loads(printed.stdout)
    changed = {name for name in domains.ids() if data_hash(domains.get(name)) != after[name]}
    assert changed == {"hallway", "rocksample-4-4", "rocksample-5-5"}
