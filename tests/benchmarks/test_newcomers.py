"""An agent and domains that are not the paper's: trained, stored, and found wherever results are shown."""

from __future__ import annotations

import io
import pathlib
from collections.abc import Iterator

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from benchmarks import evidence, registry
from benchmarks.__main__ import main
from benchmarks.evidence import StoredEvidence
from benchmarks.plan import Selection
from benchmarks.registry import RegistryError
from benchmarks.tasks import Work, execute
from bgn import domains
from bgn.analysis.figures import curves, style
from bgn.results.provenance import data_hash
from bgn.results.store import Store
from tests.benchmarks import fakes, newcomers

CELLS = [
    ("example-tiger", "ah-ch+bgn"),
    ("example-tiger", "example-as-cs"),
    ("example-coin", "ah-ch+bgn"),
    ("example-coin", "example-as-cs"),
]

PRESET = registry.load().defaults.preset


@pytest.fixture(scope="module")
def added(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pathlib.Path]:
    """The registry that names the newcomers; they are forgotten when the module is over."""
    with pytest.MonkeyPatch.context() as patch:
        yield newcomers.add(tmp_path_factory.mktemp("newcomers"), patch)


@pytest.fixture(scope="module")
def results(added: pathlib.Path) -> pathlib.Path:
    """Everything trained and evaluated in this process, for a worker's knows only what is installed."""
    benchmark = registry.load(added)
    names = ("ah-ch+bgn", "example-as-cs")
    selection = Selection(
        benchmark,
        "tiny",
        PRESET,
        ("example-tiger", "example-coin"),
        names,
        ("random", "sarsop"),
        (0, 1),
    )
    folder = added.parent / "results"
    for task in selection.tasks(selection.requests(), selection.store(folder), "cpu"):
        assert execute(task, Work(), lambda progress: None) is None
    return folder


@pytest.fixture
def stored(added: pathlib.Path, results: pathlib.Path) -> StoredEvidence:
    return evidence.load(results, registry=registry.load(added))


def test_every_cell_has_its_verdict(stored: StoredEvidence) -> None:
    cells = stored.cells
    assert list(zip(cells["domain"], cells["agent"], strict=True)) == CELLS
    assert set(cells["verdict"]) == {"no reference"}
    assert set(cells["reference_kind"]) == {"none"}
    assert cells["paper_mean"].isna().all()
    assert not cells["older_runs"].any()
    for domain, best in (("example-tiger", 20.0), ("example-coin", 1.0)):
        assert cells.loc[cells["domain"] == domain, "mean"].max() <= best


def test_tables_show_them(
    added: pathlib.Path, results: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["tables", "--all", "--write", "--registry", str(added), "--results", str(results)]) == 0
    text = capsys.readouterr().out
    for title in ("All metrics", "Raw returns", "Normalised returns", "Reference policies"):
        table = text[text.index(title) :].split("\n- ")[0]  # up to its notes
        assert "Tiger" in table
        assert "Coin" in table
        assert "As-Cs" in table or title == "Reference policies"
    stored = pd.read_parquet(results / "tiny" / PRESET / "tables" / "normalised.parquet")
    ours = stored[stored["agent"] == "example-as-cs"]
    assert ours["mean"].notna().all()  # on the scale of our own reference rows
    assert not ours["borrowed"].any()
    assert set(ours.loc[ours["domain"] == "example-coin", "convention"]) == {"paper's", "consistent"}


def test_status_counts_them(
    added: pathlib.Path, results: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["status", "--registry", str(added), "--results", str(results)]
    assert main([*command, "--agent", "ah-ch+bgn", "example-as-cs", "--reference", "random", "sarsop"]) == 0
    text = capsys.readouterr().out
    (tiger,) = (line for line in text.splitlines() if "example-tiger" in line)
    (coin,) = (line for line in text.splitlines() if "example-coin" in line)
    assert tiger.count("2/2") == 3  # two agents, and random and SARSOP from a clean start
    assert coin.count("2/2") == 2
    assert coin.count("4/4") == 1
    assert "hallway" not in text  # it is not part of the budget


def test_figures_draw_them(stored: StoredEvidence) -> None:
    figure = curves.training_curves(stored.scores, stored.agent_titles)
    picture = Image.open(io.BytesIO(style.png(figure))).convert("RGB")
    colours = np.asarray(picture).reshape(-1, 3) / 255
    further = to_rgb(style.colour("example-as-cs", tuple(stored.agent_titles)))
    assert (np.abs(colours - further).max(axis=1) < 0.02).sum() > 50  # a line, not an edge


def test_their_policies_act(stored: StoredEvidence) -> None:
    policy = stored.policy("example-tiger/ah-ch+bgn/seed-1")
    assert policy.act(2, None) in (0, 1, 2)
    assert policy.domain.title == "Tiger"


def test_workers_know_domains_of_files(
    added: pathlib.Path,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With the command itself: its workers are other processes."""
    newcomers.forget_domains(monkeypatch)
    path = newcomers.write_registry(tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(
        text[: text.index("[domains.example-coin]")]
        + text[text.index("[budgets.tiny]") :].replace(", example-coin = 480", "")
    )
    chosen = [
        "--domain",
        "example-tiger",
        "--agent",
        "ah-ch",
        "--reference",
        "random",
        "--seeds",
        "0",
        "--jobs",
        "1",
    ]
    command = ["run", "--registry", str(path), "--results", str(tmp_path / "results"), *chosen]
    assert main(command) == 0
    runs = Store(tmp_path / "results" / "tiny" / PRESET).read("runs")
    assert list(runs["run"]) == ["example-tiger/ah-ch/seed-0"]
    assert list(runs["data_hash"]) == [data_hash(domains.get("example-tiger"))]
    assert main(command, work=fakes.BREAKING) == 0  # nothing is left to do

    file = tmp_path / "tiger.pomdp"
    file.write_text(file.read_text().replace("0.85", "0.75").replace("0.15", "0.25"))
    assert main(["status", *command[1:-2]]) == 0
    printed = capsys.readouterr().out
    assert "0/1 (1 older)" in printed
    assert "2 stored results are older: other domain tables" in printed


def test_a_domain_outside_a_budget(
    added: pathlib.Path, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["status", "--registry", str(added), "--results", str(tmp_path)]
    assert main([*command, "--domain", "hallway"]) == 2
    said = capsys.readouterr().err
    assert (
        "budget 'tiny' does not include domain 'hallway'; give it steps, budgets.tiny.env_steps.hallway"
        in said
    )
    assert "choose of example-tiger, example-coin" in said
    with pytest.raises(RegistryError, match="does not include"):
        registry.load(added).cell("example-tiger", "ah-ch", budget="laptop", preset=PRESET)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"tiger.pomdp"', '"lion.pomdp"', r"my\.toml: domains\.example-tiger\.file: cannot read .*lion\.pomdp.*No"),
        ('"tiger.pomdp"', '"ti\\u0000ger"', r"my\.toml: domains\.example-tiger\.file: cannot read .*null"),
        ('"tiger.pomdp"', '"."', r"my\.toml: domains\.example-tiger\.file: cannot read .*directory"),
        ("episode_limit = 20\n", "", r"my\.toml: domains\.example-tiger\.episode_limit: Field required"),
        ("episode_limit = 20", "episode_limit = 0", r"example-tiger\.episode_limit: .*greater than or equal to 1"),
        ("episode_limit = 20", "episode_limit = 20\nreport_discount = 2.0", r"tiger\.report_discount: .*less than"),
        ("episode_limit = 20", "episode_limits = 20", r"domains\.example-tiger\.episode_limits: unknown key"),
        ("[domains.example-tiger]", "[domains.hallway]", r"domains\.hallway\.file: .*built by a module"),
    ],
)  # fmt: skip
def test_wrong_entries_name_file_and_key(
    added: pathlib.Path, tmp_path: pathlib.Path, old: str, new: str, message: str
) -> None:
    path = newcomers.write_registry(tmp_path)
    text = path.read_text(encoding="utf-8").replace(old, new, 1)
    path.write_text(
        text.replace("example-tiger = 480", f"{'hallway' if 'hallway' in new else 'example-tiger'} = 480")
    )
    with pytest.raises(RegistryError, match=message):
        registry.load(path)


def test_a_wrong_file_is_named_with_its_line(added: pathlib.Path, tmp_path: pathlib.Path) -> None:
    path = newcomers.write_registry(tmp_path)
    file = tmp_path / "tiger.pomdp"
    file.write_text(file.read_text().replace("0.85 0.15", "0.85 0.25", 1))
    with pytest.raises(RegistryError, match=r"my\.toml: domains\.example-tiger\.file: .*tiger\.pomdp"):
        registry.load(path)


def test_an_unknown_registry(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--registry", "no/such.toml"]) == 2
    assert "no/such.toml: cannot read the registry" in capsys.readouterr().err
