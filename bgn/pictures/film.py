"""Films of an episode: the scene in physics with belief panels beside it, as a GIF and as a film strip."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from bgn.domains.domain import Domain
from bgn.physics import RenderingUnavailableError
from bgn.physics.world import EpisodeState, PhysicsWorld
from bgn.pictures.belief_panels import (
    FINGER,
    LEFT_BUMP,
    RIGHT_BUMP,
    TRUTH,
    Belief,
    Image,
    draw_panels,
    panel_size,
)
from bgn.pictures.camera import Camera
from bgn.simulation.policy import Policy

FRAMES_PER_MOVE: Final = 5
FRAME_MILLISECONDS: Final = 90
LAST_MILLISECONDS: Final = 1600
STRIP_COLUMNS: Final = 6
CAPTION: Final = 26
INK: Final = (43, 47, 56)
GOOD: Final = (34, 122, 65)
BAD: Final = (178, 42, 38)


class Grounded(Protocol):
    """A policy that also reconstructs the belief."""

    def belief(self) -> NDArray[np.float32] | None:
        """Return b̂_Y (Y,) after the last ``act``."""
        ...


@dataclass(frozen=True, eq=False)
class Shot:
    """One state of an episode and how the scene moved to get there."""

    state: EpisodeState
    predicted: Belief | None
    action: str
    frames: list[Image] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Film:
    """A recorded episode."""

    domain: Domain
    shots: list[Shot]


def record(domain: Domain, policy: Policy, seed: int, *, scene: bool = True) -> Film:
    """Play one episode in physics and film it; without ``scene`` only the beliefs, which needs no OpenGL.

    Raises
    ------
    RenderingUnavailableError
        The scene is to be filmed, and this machine has no OpenGL.
    """
    world, rng = PhysicsWorld(domain), np.random.default_rng(seed)
    if not scene:
        return Film(domain, list(_shots(world, None, policy, rng)))
    camera = Camera(world.scene, *world.scene.view)
    try:
        return Film(domain, list(_shots(world, camera, policy, rng)))
    finally:
        camera.close()


def record_if_possible(domain: Domain, policy: Policy, seed: int) -> Film:
    """Play one episode in physics and film it, the scene only where this machine has OpenGL."""
    try:
        return record(domain, policy, seed)
    except RenderingUnavailableError:
        return record(domain, policy, seed, scene=False)


def _shots(
    world: PhysicsWorld, camera: Camera | None, policy: Policy, rng: np.random.Generator
) -> Iterator[Shot]:
    state = world.reset(rng)
    policy.reset(rng)
    names = world.domain.model.joint.action_names
    label, action = "start", None
    frames = [] if camera is None else [camera.frame()]
    while not (state.ended or state.truncated):
        choice = policy.act(state.observation, action)
        yield Shot(state, _predicted(policy), label, frames)
        action, label, frames = choice, names[choice], []
        if camera is not None:
            world.scene.observer = _Ticker(camera, frames).tick
        state = world.step(choice)
        if camera is not None:
            frames.append(camera.frame())
    yield Shot(state, _predicted(policy), label, frames)


class _Ticker:
    """Takes a picture every so many observer calls of a move."""

    def __init__(self, camera: Camera, frames: list[Image]) -> None:
        self._camera, self._frames, self._calls = camera, frames, 0

    def tick(self) -> None:
        self._calls += 1
        if self._calls % FRAMES_PER_MOVE == 0:
            self._frames.append(self._camera.frame())


def _predicted(policy: Policy | Grounded) -> Belief | None:
    reconstruct = getattr(policy, "belief", None)
    return None if reconstruct is None else reconstruct()


def save_gif(film: Film, path: Path) -> None:
    """Write the film as an animated GIF: the scene, beside it the predicted belief above the true one."""
    pictures: list[Pillow.Image] = []
    for number, shot in enumerate(film.shots):
        panel = _panels(film.domain, shot)
        caption, colour = _caption(number, shot)
        for frame in shot.frames:
            height = max(len(frame), len(panel)) + CAPTION
            picture = Pillow.new("RGB", (frame.shape[1] + panel.shape[1], height), "white")
            picture.paste(Pillow.fromarray(frame), (0, CAPTION + (height - CAPTION - len(frame)) // 2))
            picture.paste(Pillow.fromarray(panel), (frame.shape[1], CAPTION))
            _write(picture, (10, 4), f"{film.domain.title}   {caption}", colour)
            pictures.append(picture)
    durations = [FRAME_MILLISECONDS] * len(pictures)
    durations[-1] = LAST_MILLISECONDS
    palette = _palette(pictures)
    frames = [p.quantize(palette=palette, dither=Pillow.Dither.NONE) for p in pictures]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, loop=0)


def _palette(pictures: Sequence[Pillow.Image]) -> Pillow.Image:
    """Choose 256 colours for all pictures; the small coloured marks count as much as the large surfaces."""
    first, last = pictures[0], pictures[-1]
    swatch = 24
    sample = Pillow.new("RGB", (first.width, 2 * first.height + swatch))
    sample.paste(first, (0, 0))
    sample.paste(last, (0, first.height))
    marks: tuple[str | tuple[int, int, int], ...] = (FINGER, LEFT_BUMP, RIGHT_BUMP, TRUTH, GOOD, BAD)
    for i, colour in enumerate(marks):
        left, right = (round(k * first.width / len(marks)) for k in (i, i + 1))
        sample.paste(colour, (left, 2 * first.height, right, sample.height))
    return sample.quantize(256)


def save_strip(film: Film, path: Path, columns: int = STRIP_COLUMNS) -> None:
    """Write the picture of :func:`strip`."""
    strip(film, columns).save(path)


def strip(film: Film, columns: int = STRIP_COLUMNS) -> Pillow.Image:
    """Return up to ``columns`` moments side by side: scene (where it was filmed), predicted belief, true belief."""
    chosen = sorted({round(i) for i in np.linspace(0, len(film.shots) - 1, columns)})
    strips = [_column(film.domain, number, film.shots[number]) for number in chosen]
    width, height = strips[0].size
    gap = 8
    picture = Pillow.new("RGB", ((width + gap) * len(strips) - gap, height), "white")
    for i, column in enumerate(strips):
        picture.paste(column, (i * (width + gap), 0))
    return picture


def _column(domain: Domain, number: int, shot: Shot) -> Pillow.Image:
    panel = Pillow.fromarray(_panels(domain, shot))
    wide, scene = panel.width, None
    if shot.frames:
        wide = max(300, panel.width)
        scene = Pillow.fromarray(shot.frames[-1])
        scene = scene.resize((wide, round(scene.height * wide / scene.width)), Pillow.Resampling.LANCZOS)
    above = CAPTION + (0 if scene is None else scene.height)
    picture = Pillow.new("RGB", (wide, above + panel.height), "white")
    caption, colour = _caption(number, shot)
    _write(picture, (4, 4), caption, colour)
    if scene is not None:
        picture.paste(scene, (0, CAPTION))
    picture.paste(panel, ((wide - panel.width) // 2, above))
    return picture


def _panels(domain: Domain, shot: Shot) -> Image:
    beliefs: dict[str, Belief] = {} if shot.predicted is None else {"predicted belief": shot.predicted}
    beliefs["true belief"] = shot.state.belief
    width, height = panel_size(domain)
    return draw_panels(domain, shot.state.x, shot.state.y, beliefs, (width, height * len(beliefs)))


def _caption(number: int, shot: Shot) -> tuple[str, tuple[int, int, int]]:
    text, state = f"t = {number}   {shot.action}", shot.state
    if state.success:
        return f"{text}   success", GOOD
    if state.ended or state.truncated:
        return f"{text}   {'failure' if state.ended else 'out of time'}", BAD
    return text, INK


def _write(picture: Pillow.Image, at: tuple[int, int], text: str, colour: Sequence[int]) -> None:
    font = ImageFont.load_default(size=15)
    ImageDraw.Draw(picture).text(at, text, fill=tuple(colour), font=font)
