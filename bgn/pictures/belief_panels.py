"""Belief panels: what an agent could know about the hidden part of a robot domain, as a picture.

TopPlate: a bar per stack height. TwoBumps-1D: the probability of each pair of cells, left bump across and
right bump up. TwoBumps-2D: the probability of each cell, for the large and for the small bump. The truth is
ringed, the finger is yellow (paper, Figures "learned policies" and "belief reconstruction").
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from bgn.domains.domain import Domain
from bgn.domains.layout import TouchLayout
from bgn.errors import InputError

Image = NDArray[np.uint8]
Belief = NDArray[np.floating[Any]]

INK: Final = "#2b2f38"
FINGER: Final = "#f5b400"
LEFT_BUMP: Final = "#c9302c"
RIGHT_BUMP: Final = "#2f8f4e"
TRUTH: Final = "#f26419"
HEAT: Final = LinearSegmentedColormap.from_list("belief", ["#ffffff", "#9ecae8", "#2171b5", "#08306b"])
DOTS_PER_INCH: Final = 100


def draw_panels(domain: Domain, x: int, y: int, beliefs: dict[str, Belief], size: tuple[int, int]) -> Image:
    """Draw one panel per titled belief (Y,), one below the other; uint8 (height, width, 3).

    ``size`` is (width, height) in pixels.
    """
    width, height = size
    layout = _layout(domain)
    figure = Figure(figsize=(width / DOTS_PER_INCH, height / DOTS_PER_INCH), dpi=DOTS_PER_INCH)
    canvas: Any = FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    panels = figure.subfigures(len(beliefs), 1, squeeze=False, hspace=0)[:, 0]
    for panel, (title, belief) in zip(panels, beliefs.items(), strict=True):
        panel.suptitle(title, fontsize=9, color=INK, y=0.98)
        _drawing(layout)(panel, layout, x, y, belief)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def panel_size(domain: Domain) -> tuple[int, int]:
    """Return the (width, height) in pixels of one panel beside a film."""
    draw = _drawing(_layout(domain))
    if draw is _draw_levels:
        return 240, 240
    return (220, 220) if draw is _draw_pairs else (340, 204)


def _layout(domain: Domain) -> TouchLayout:
    if not isinstance(domain.layout, TouchLayout):
        raise InputError(f"{domain.id} has no hidden objects to draw a belief about")
    return domain.layout


def _drawing(layout: TouchLayout) -> Callable[[Any, TouchLayout, int, int, Belief], None]:
    """Choose how a belief is shown: by what is hidden, and on what cells."""
    if len(layout.objects) == 1:
        return _draw_levels
    return _draw_pairs if 1 in layout.shape else _draw_cells


def _draw_levels(panel: Any, layout: TouchLayout, x: int, y: int, belief: Belief) -> None:
    axes: Axes = panel.add_axes((0.16, 0.14, 0.78, 0.72))
    levels, heights = layout.shape[0], layout.places[:, 0]
    axes.barh(heights, belief, color="#2171b5", height=0.72)
    axes.barh(heights[y], 1, color="none", edgecolor=TRUTH, height=0.9, linewidth=1.2)
    axes.plot(0.97, layout.finger[x], marker="<", color=FINGER, markersize=9, markeredgecolor=INK)
    axes.set(xlim=(0, 1), ylim=(-0.6, levels - 0.4), yticks=range(0, levels, 2), xticks=(0, 0.5, 1))
    axes.set_ylabel("level", fontsize=8, color=INK, labelpad=1)
    _plain(axes)


def _draw_pairs(panel: Any, layout: TouchLayout, x: int, y: int, belief: Belief) -> None:
    axes: Axes = panel.add_axes((0.14, 0.15, 0.8, 0.74))
    cells = max(layout.shape)
    heat = np.full((cells, cells), np.nan)
    heat[layout.places[:, 1], layout.places[:, 0]] = belief
    axes.set_facecolor("#e4e6ea")
    axes.imshow(heat, cmap=HEAT, vmin=0, vmax=max(float(belief.max()), 1e-9), origin="lower")
    left, right = layout.places[y]
    axes.plot((0, cells - 1), (0, cells - 1), color="#b9bdc6", linewidth=0.8, zorder=1)
    axes.add_patch(Rectangle((left - 0.5, right - 0.5), 1, 1, fill=False, edgecolor=TRUTH, linewidth=1.6))
    for position, colour in ((left, LEFT_BUMP), (right, RIGHT_BUMP), (layout.finger[x], FINGER)):
        axes.plot(
            position, position, "o", color=colour, markersize=6, markeredgecolor=INK, markeredgewidth=0.6
        )
    ticks = (0, (cells - 1) // 2, cells - 1)
    axes.set(xlim=(-0.5, cells - 0.5), ylim=(-0.5, cells - 0.5), xticks=ticks, yticks=ticks)
    axes.set_xlabel(layout.objects[0], fontsize=8, color=LEFT_BUMP, labelpad=0)
    axes.set_ylabel(layout.objects[1], fontsize=8, color=RIGHT_BUMP, labelpad=0)
    _plain(axes)


def _draw_cells(panel: Any, layout: TouchLayout, x: int, y: int, belief: Belief) -> None:
    rows, columns = layout.shape
    finger_row, finger_column = divmod(int(layout.finger[x]), columns)
    for which, (left, label) in enumerate(zip((0.03, 0.52), layout.objects, strict=True)):
        axes: Axes = panel.add_axes((left, 0.1, 0.45, 0.78))
        chance = layout.marginal(belief, which)
        axes.imshow(chance, cmap=HEAT, vmin=0, vmax=max(float(chance.max()), 1e-9), origin="lower")
        row, column = divmod(int(layout.places[y, which]), columns)
        axes.plot(column, row, "o", color="none", markeredgecolor=TRUTH, markersize=14, markeredgewidth=1.6)
        axes.plot(finger_column, finger_row, "o", color=FINGER, markersize=7, markeredgecolor=INK)
        grid = {"xticks": np.arange(-0.5, columns), "yticks": np.arange(-0.5, rows)}
        axes.set(**grid, xticklabels=[], yticklabels=[])
        axes.grid(color="#d5d8de", linewidth=0.6)
        axes.set_xlabel(label, fontsize=8, color=INK, labelpad=1)
        _plain(axes)


def _plain(axes: Axes) -> None:
    axes.tick_params(length=0, labelsize=7, colors=INK, pad=2)
    for spine in axes.spines.values():
        spine.set(color="#b9bdc6", linewidth=0.8)
