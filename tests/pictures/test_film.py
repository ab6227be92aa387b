from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from bgn import domains
from bgn.__main__ import main
from bgn.physics.tasks import task_of
from bgn.pictures import film
from bgn.pictures.belief_panels import draw_panels
from bgn.policies.scripted import scripted_policy
from tests.pictures._graphics import needs_graphics

ROBOTS = ("top-plate", "two-bumps-1d", "two-bumps-2d")


class Grounded:
    """A scripted policy that also predicts a belief."""

    def __init__(self, domain):
        self._scripted, self._size = scripted_policy(domain), domain.model.n_hidden
        self.reset, self.act = self._scripted.reset, self._scripted.act

    def belief(self):
        return np.full(self._size, 1 / self._size, dtype=np.float32)


@pytest.mark.parametrize("name", ROBOTS)
def test_panels_show_the_belief_the_truth_and_the_finger(name):
    domain = domains.get(name)
    x, y = divmod(int(np.flatnonzero(domain.model.joint.start)[5]), domain.model.n_hidden)
    sure, even = np.zeros(domain.model.n_hidden), np.full(domain.model.n_hidden, 1 / domain.model.n_hidden)
    sure[0] = 1

    def draw(belief, x=x, y=y):
        return draw_panels(domain, x, y, {"predicted belief": belief, "true belief": even}, (200, 300))

    picture = draw(sure)
    assert picture.shape == (300, 200, 3)
    assert picture.dtype == np.uint8
    above, below = draw(even)[:150] != picture[:150], draw(even)[150:] != picture[150:]
    assert above.any()
    assert not below.any()
    assert (draw(sure, y=y + 1) != picture).any()
    step = 3 if name != "two-bumps-2d" else 20
    assert (draw(sure, x=x + step) != picture).any()


@pytest.fixture
def small(monkeypatch):
    needs_graphics()
    monkeypatch.setattr(film, "panel_size", lambda domain: (100, 60))
    for name in ROBOTS:
        monkeypatch.setattr(task_of(name).scene, "view", (64, 48))
    monkeypatch.setattr(film, "FRAMES_PER_MOVE", 20)


@pytest.mark.parametrize(("name", "seed"), [("top-plate", 3), ("two-bumps-1d", 43), ("two-bumps-2d", 31)])
def test_film_of_an_episode(small, name, seed, tmp_path):
    domain = domains.get(name)
    recorded = film.record(domain, Grounded(domain), seed)
    assert recorded.shots[0].action == "start"
    assert recorded.shots[-1].state.success
    assert [shot.state.steps for shot in recorded.shots] == list(range(len(recorded.shots)))
    film.save_gif(recorded, tmp_path / "film.gif")
    film.save_strip(recorded, tmp_path / "strip.png", columns=3)
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames > len(recorded.shots)  # type: ignore[attr-defined]
        assert gif.width == 64 + 100
    with Image.open(tmp_path / "strip.png") as strip:
        assert strip.width == 3 * 300 + 2 * 8


def test_the_same_seed_films_the_same_episode(small):
    domain = domains.get("top-plate")
    first, again = (film.record(domain, scripted_policy(domain), seed=3) for _ in range(2))
    assert first.shots[0].predicted is None  # a scripted policy predicts nothing
    for one, other in zip(first.shots, again.shots, strict=True):
        np.testing.assert_array_equal(np.stack(one.frames), np.stack(other.frames))


def test_render_command(small, tmp_path, capsys):
    out = tmp_path / "plate.gif"
    assert (
        main(["render", "top-plate", "--policy", "random", "--plates", "5", "--seed", "2", "--out", str(out)])
        == 0
    )
    assert capsys.readouterr().out.split() == [str(out), str(tmp_path / "plate-strip.png")]
    assert out.stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", "hallway"], "'hallway' is not a robot domain; those are top-plate, two-bumps-1d"),
        (["render", "top-plate", "--policy", "lost.safetensors"], "lost.safetensors: no such policy file"),
        (["render", "top-plate", "--plates", "0"], "top-plate has 1 to 10 plates, not 0"),
        (["render", "two-bumps-2d", "--variant", "new"], "unknown variant 'new'; known: paper, authors"),
        (["render", "top-plate", "--policy", "a.safetensors", "--plates", "5"], "brings its own variant"),
        (["render", "top-plate", "--out", "nowhere/film.gif"], "no folder nowhere to write film.gif into"),
        (["render", "top-plate", "--out", "film.txt"], "film.txt: a film is a .gif file"),
        (["compile", "hallway"], "'hallway' is not a robot domain"),
        (["compile", "top-plate", "--histories", "0", "--force"], "histories >= 1, not 0"),
        (["compile", "top-plate", "--jobs", "0"], "--jobs 0: expected at least 1 process"),
    ],
)
def test_commands_explain_bad_input(arguments, message, capsys):
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def test_compile_command(tmp_path, capsys):
    arguments = ["compile", "top-plate", "--tables", str(tmp_path), "--jobs", "1"]
    assert main(arguments) == 0
    assert "374 pairs, one outcome each from 4 histories, margin 46%" in capsys.readouterr().out.replace(
        "\n", " "
    )
    assert main(arguments) == 0
    assert "top-plate: up to date" in capsys.readouterr().out


def test_tables_need_no_physics():
    code = "import sys; from bgn import domains; domains.get('two-bumps-2d'); print('mujoco' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
