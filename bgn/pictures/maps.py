"""Pictures of a grid domain: the map, the true state and, shaded, the belief."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from bgn.domains.layout import Cell, GridLayout

Colour = tuple[int, int, int]
Point = tuple[float, float]

CELL = 48
"""Side of a cell in pixels."""
_FINE = 4  # drawn this much larger, then scaled down: smooth edges
_UNIT = CELL * _FINE

WALL: Colour = (52, 58, 70)
FLOOR: Colour = (250, 250, 247)
GRID: Colour = (206, 208, 212)
BELIEF: Colour = (31, 111, 180)
AGENT: Colour = (214, 69, 35)
GOAL: Colour = (233, 175, 26)
GOOD: Colour = (56, 142, 60)
BAD: Colour = (166, 46, 46)
UNKNOWN: Colour = (196, 196, 196)

ARROWS = "^>v<"


def draw(layout: GridLayout, state: int, belief: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3): cells bluer where the belief is, the agent in red.

    A cell's four triangles are the headings, where there are any. A rock's filling says how probably it is
    good (green, grey, red), its rim what it really is.
    """
    rows, columns = layout.shape
    image = Image.new("RGB", ((columns + 1) * _UNIT, (rows + 1) * _UNIT), WALL)
    canvas = ImageDraw.Draw(image)
    marginal = layout.marginal(belief)
    for cell in layout.cells:
        _draw_cell(canvas, cell, marginal[cell], is_goal=cell == layout.goal)
    good = belief @ layout.qualities
    for i, rock in enumerate(layout.rocks):
        _draw_rock(canvas, rock, float(good[i]), is_good=bool(layout.qualities[state, i]))
    if layout.positions[state, 0] >= 0:
        heading = None if layout.headings is None else int(layout.headings[state])
        _draw_agent(canvas, layout.positions[state], heading)
    size = (columns + 1) * CELL, (rows + 1) * CELL
    return np.asarray(image.resize(size, Image.Resampling.LANCZOS)).copy()


def text(layout: GridLayout, state: int) -> str:
    """Return the map in characters: ``#`` wall, ``+`` goal, ``o`` good rock, ``x`` bad rock, the agent."""
    rows, columns = layout.shape
    lines = [["#"] * (columns + 2) for _ in range(rows + 2)]

    def put(cell: Cell, character: str) -> None:
        lines[cell[0] + 1][cell[1] + 1] = character

    for cell in layout.cells:
        put(cell, "+" if cell == layout.goal else " ")
    for rock, good in zip(layout.rocks, layout.qualities[state], strict=True):
        put(rock, "o" if good else "x")
    row, column = layout.positions[state]
    if row >= 0:
        put((row, column), "@" if layout.headings is None else ARROWS[layout.headings[state]])
    return "\n".join(map("".join, lines))


def _draw_cell(
    canvas: ImageDraw.ImageDraw, cell: Cell, belief: NDArray[np.float64], *, is_goal: bool
) -> None:
    left, top = _corner(cell)
    middle = left + _UNIT / 2, top + _UNIT / 2
    corners = [(left, top), (left + _UNIT, top), (left + _UNIT, top + _UNIT), (left, top + _UNIT)]
    if len(belief) == 1:
        canvas.polygon(corners, fill=_shade(belief[0]))
    else:
        for heading, p in enumerate(belief):  # north is the triangle between the first two corners
            canvas.polygon([corners[heading], corners[(heading + 1) % 4], middle], fill=_shade(p))
    canvas.rectangle((*corners[0], *corners[2]), outline=GRID, width=_FINE)
    if is_goal:
        canvas.polygon(_star(middle, 0.36 * _UNIT), fill=GOAL, outline=WALL, width=_FINE)


def _draw_rock(canvas: ImageDraw.ImageDraw, cell: Cell, good: float, *, is_good: bool) -> None:
    x, y = _centre(cell)
    r = 0.3 * _UNIT
    filling = _blend(UNKNOWN, GOOD, 2 * good - 1) if good > 0.5 else _blend(BAD, UNKNOWN, 2 * good)
    rim = GOOD if is_good else BAD
    canvas.ellipse((x - r, y - r, x + r, y + r), fill=filling, outline=rim, width=5 * _FINE)


def _draw_agent(canvas: ImageDraw.ImageDraw, cell: NDArray[np.int64], heading: int | None) -> None:
    x, y = _centre((int(cell[0]), int(cell[1])))
    r = 0.26 * _UNIT
    if heading is None:
        r = 0.16 * _UNIT
        canvas.ellipse((x - r, y - r, x + r, y + r), fill=AGENT, outline=FLOOR, width=2 * _FINE)
        return
    angles = (heading * pi / 2 + turn for turn in (0, 0.8 * pi, 1.2 * pi))  # clockwise from north
    canvas.polygon([(x + r * sin(a), y - r * cos(a)) for a in angles], fill=AGENT, outline=FLOOR, width=_FINE)


def _corner(cell: Cell) -> Point:
    """Return the top left corner of a cell; a rim of half a cell surrounds the map."""
    return (cell[1] + 0.5) * _UNIT, (cell[0] + 0.5) * _UNIT


def _centre(cell: Cell) -> Point:
    return (cell[1] + 1.0) * _UNIT, (cell[0] + 1.0) * _UNIT


def _star(centre: Point, radius: float) -> list[Point]:
    """Return the ten corners of a five-pointed star."""
    x, y = centre
    lengths = (radius if i % 2 == 0 else 0.42 * radius for i in range(10))
    return [(x + r * sin(i * pi / 5), y - r * cos(i * pi / 5)) for i, r in enumerate(lengths)]


def _shade(p: float) -> Colour:
    """Return the floor's colour under belief p; the square root shows small beliefs too."""
    return _blend(FLOOR, BELIEF, float(np.sqrt(min(p, 1.0))))


def _blend(one: Colour, other: Colour, weight: float) -> Colour:
    red, green, blue = (round(a + (b - a) * weight) for a, b in zip(one, other, strict=True))
    return red, green, blue
