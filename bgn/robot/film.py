"""A recorded episode as a film: the arm re-enacts its recorded joints in the twin, belief panels beside it.

The beliefs are computed here, afterwards, for people: the true one from the domain's model along the recorded
observations and actions, the predicted one by letting the policy look at the recorded history again. The joints are
those that were recorded; how the finger bends and objects slide is the twin's physics.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from bgn.domains.domain import Domain
from bgn.physics.tasks import task_of
from bgn.physics.world import EpisodeState
from bgn.pictures.camera import Camera, Image
from bgn.pictures.film import Film, Shot, save_gif, save_strip
from bgn.policies.saved import NetworkPolicy
from bgn.robot import lab as laboratory
from bgn.robot.entrant import ROOT, enter
from bgn.robot.errors import UsageError
from bgn.robot.kinematics import Floats
from bgn.robot.lab import Lab
from bgn.robot.moves import MOVES
from bgn.robot.recording import FINISHED, SessionFolder, read_raw, read_steps, rows
from bgn.robot.twin.plant import STEP, Plant
from bgn.simulation.belief_rules import next_belief, start_belief

FRAME_EVERY: Final = 0.25  # s of robot time between two pictures of a step
JOINTS: Final = [f"q{i}" for i in range(6)]


def film_episode(episode: Path, out: Path | None = None, lab_path: Path | None = None) -> tuple[Path, Path]:
    """Write a recorded episode as a GIF and a film strip; return both paths.

    Raises
    ------
    UsageError
        The folder holds no recorded episode with steps, or its policy is another one now.
    RenderingUnavailableError
        This machine has no OpenGL.
    """
    about = _about(episode)
    session = SessionFolder(episode.parent.parent).about()
    entry = session["policies"][about["task"]]
    entrant = enter(about["task"], ROOT / entry["path"])
    if entrant.digest != entry["sha256"]:
        raise UsageError(f"{entry['path']} is not the policy of this recording any more")
    lab = Lab.model_validate(session["lab"]) if lab_path is None else laboratory.load(lab_path)
    film = Film(entrant.domain, _shoot(lab, about, read_steps(episode), read_raw(episode), entrant.policy))
    gif = out or Path(f"{episode.name}.gif")
    strip = gif.with_name(f"{gif.stem}-strip.png")
    save_gif(film, gif)
    save_strip(film, strip)
    return gif, strip


def beliefs(domain: Domain, steps: pd.DataFrame) -> list[Floats]:
    """Return the true belief (Y,) after each recorded step, from observed parts and actions alone."""
    taken = rows(steps)
    found = [start_belief(domain, int(taken[0].observed))]
    for before, row in pairwise(taken):
        if row is taken[-1] and _ends(domain, row, len(taken) - 1):
            found.append(found[-1])  # what the last action led to is no observation
            continue
        found.append(
            next_belief(
                domain,
                found[-1],
                int(row.action),
                int(row.observation),
                x=int(before.observed),
                x_next=int(row.observed),
            )
        )
    return found


def _ends(domain: Domain, row: Any, steps: int) -> bool:
    """Whether the last recorded step ended the episode, rather than its limit."""
    return int(row.action) not in MOVES[domain.id] or steps < domain.episode_limit


def _about(episode: Path) -> dict[str, Any]:
    try:
        about: dict[str, Any] = json.loads((episode / "episode.json").read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise UsageError(f"{episode} holds no recorded episode: {error}") from error
    if about.get("kind") != "episode" or not (episode / "steps.parquet").exists():
        raise UsageError(f"{episode} is not an episode with steps")
    return about


def _shoot(
    lab: Lab, about: dict[str, Any], steps: pd.DataFrame, raw: pd.DataFrame, policy: NetworkPolicy
) -> list[Shot]:
    plant = Plant(lab, policy.domain.id)
    camera = Camera(plant, *task_of(policy.domain.id).make_scene(policy.domain).view)
    try:
        stage = _Stage(plant, camera, raw)
        return stage.shoot(about, steps, policy)
    finally:
        camera.close()


class _Stage:
    """The twin's arm, driven along a recording and photographed."""

    def __init__(self, plant: Plant, camera: Camera, raw: pd.DataFrame) -> None:
        self._plant, self._camera, self._raw = plant, camera, raw
        self._frames: list[Image] = []
        self._next = 0.0
        plant.observer = self._look

    def shoot(self, about: dict[str, Any], steps: pd.DataFrame, policy: NetworkPolicy) -> list[Shot]:
        domain, taken = policy.domain, rows(steps)
        self._plant.place(int(taken[0].hidden))
        shots = []
        policy.reset()
        wall, last = -np.inf, None
        for row, belief in zip(taken, beliefs(domain, steps), strict=True):
            action = None if row.action < 0 else int(row.action)
            self._drive(domain, action, wall, float(row.wall))
            wall, over = float(row.wall), row is taken[-1]
            state = _state(domain, about, row, belief, over=over)
            if not over:
                policy.act(int(row.observation), last if action is None else action)
            said = "start" if action is None else domain.model.joint.action_names[action]
            shots.append(Shot(state, policy.belief(), said, self._frames))
            last = action
        return shots

    def _drive(self, domain: Domain, action: int | None, after: float, until: float) -> None:
        """Re-enact what was recorded between two times of the wall clock."""
        self._frames = []
        part = self._raw[(self._raw.wall > after) & (self._raw.wall <= until)]
        gripper = self._plant.lab.gripper
        move = MOVES[domain.id].get(-1 if action is None else action)
        stiffness = gripper.stiff if move is not None and move.stiff else gripper.soft
        self._plant.set_stiffness([stiffness] * len(self._plant.station.fingers))
        path = _resample(part)
        if action is None:  # the way to the start was not felt: begin at its end
            self._plant.jump(path[-1])
        else:
            self._plant.follow(path)
            self._plant.advance(len(path))
        self._frames.append(self._camera.frame())

    def _look(self) -> None:
        if self._plant.time >= self._next:
            self._next = self._plant.time + FRAME_EVERY
            self._frames.append(self._camera.frame())


def _resample(part: pd.DataFrame) -> Floats:
    """Return recorded joints (n, 6), one row per simulated step."""
    times = part.time.to_numpy()
    ticks = np.arange(times[0], times[-1] + STEP / 2, STEP)
    return np.stack([np.interp(ticks, times, part[joint].to_numpy()) for joint in JOINTS], axis=1)


def _state(domain: Domain, about: dict[str, Any], row: Any, belief: Floats, *, over: bool) -> EpisodeState:
    outcome = str(about["outcome"])
    ended = over and outcome in FINISHED and outcome != "out-of-time"
    return EpisodeState(
        observation=int(row.observation),
        x=int(row.observed),
        y=int(about["y"]),
        belief=belief,
        angle=float(row.angle),
        ended=ended,
        truncated=over and not ended,
        success=over and outcome == "success",
        steps=int(row.step),
    )
