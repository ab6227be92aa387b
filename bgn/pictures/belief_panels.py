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

from bgn.domains import top_plate, two_bumps_1d, two_bumps_2d
from bgn.domains.domain import Domain

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
    figure = Figure(figsize=(width / DOTS_PER_INCH, height / DOTS_PER_INCH), dpi=DOTS_PER_INCH)
    canvas: Any = FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    panels = figure.subfigures(len(beliefs), 1, squeeze=False, hspace=0)[:, 0]
    for panel, (title, belief) in zip(panels, beliefs.items(), strict=True):
        panel.suptitle(title, fontsize=9, color=INK, y=0.98)
        _DRAW[domain.id](panel, domain, x, y, belief)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _draw_heights(panel: Any, domain: Domain, x: int, y: int, belief: Belief) -> None:
    axes: Axes = panel.add_axes((0.16, 0.14, 0.78, 0.72))
    names = domain.model.joint.state_names[: domain.model.n_hidden]
    heights = [int(name.rpartition("-")[2]) for name in names]
    levels = domain.model.n_observed // top_plate.BINS
    axes.barh(heights, belief, color="#2171b5", height=0.72)
    axes.barh(heights[y], 1, color="none", edgecolor=TRUTH, height=0.9, linewidth=1.2)
    axes.plot(0.97, x // top_plate.BINS, marker="<", color=FINGER, markersize=9, markeredgecolor=INK)
    axes.set(xlim=(0, 1), ylim=(-0.6, levels - 0.4), yticks=range(0, levels, 2), xticks=(0, 0.5, 1))
    axes.set_ylabel("level", fontsize=8, color=INK, labelpad=1)
    _plain(axes)


def _draw_pairs(panel: Any, domain: Domain, x: int, y: int, belief: Belief) -> None:
    axes: Axes = panel.add_axes((0.14, 0.15, 0.8, 0.74))
    cells = two_bumps_1d.CELLS
    heat = np.full((cells, cells), np.nan)
    for (b1, b2), p in zip(two_bumps_1d.PAIRS, belief, strict=True):
        heat[b2, b1] = p
    axes.set_facecolor("#e4e6ea")
    axes.imshow(heat, cmap=HEAT, vmin=0, vmax=max(float(belief.max()), 1e-9), origin="lower")
    b1, b2 = two_bumps_1d.PAIRS[y]
    finger = x // two_bumps_1d.BINS
    axes.plot((0, cells - 1), (0, cells - 1), color="#b9bdc6", linewidth=0.8, zorder=1)
    axes.add_patch(Rectangle((b1 - 0.5, b2 - 0.5), 1, 1, fill=False, edgecolor=TRUTH, linewidth=1.6))
    for position, colour in ((b1, LEFT_BUMP), (b2, RIGHT_BUMP), (finger, FINGER)):
        axes.plot(
            position, position, "o", color=colour, markersize=6, markeredgecolor=INK, markeredgewidth=0.6
        )
    axes.set(xlim=(-0.5, cells - 0.5), ylim=(-0.5, cells - 0.5), xticks=(0, 7, 14), yticks=(0, 7, 14))
    axes.set_xlabel("left bump", fontsize=8, color=LEFT_BUMP, labelpad=0)
    axes.set_ylabel("right bump", fontsize=8, color=RIGHT_BUMP, labelpad=0)
    _plain(axes)


def _draw_cells(panel: Any, domain: Domain, x: int, y: int, belief: Belief) -> None:
    pairs, side = np.array(two_bumps_2d.PAIRS), two_bumps_2d.SIDE
    finger = divmod(x // two_bumps_2d.FLAGS // two_bumps_2d.BINS, side)
    for bump, (left, label) in enumerate(((0.03, "large"), (0.52, "small"))):
        axes: Axes = panel.add_axes((left, 0.1, 0.45, 0.78))
        chance = np.bincount(pairs[:, bump], weights=belief, minlength=side * side).reshape(side, side)
        axes.imshow(chance, cmap=HEAT, vmin=0, vmax=max(float(chance.max()), 1e-9), origin="lower")
        row, column = divmod(int(pairs[y, bump]), side)
        axes.plot(column, row, "o", color="none", markeredgecolor=TRUTH, markersize=14, markeredgewidth=1.6)
        axes.plot(finger[1], finger[0], "o", color=FINGER, markersize=7, markeredgecolor=INK)
        axes.set(xticks=np.arange(-0.5, side), yticks=np.arange(-0.5, side), xticklabels=[], yticklabels=[])
        axes.grid(color="#d5d8de", linewidth=0.6)
        axes.set_xlabel(label, fontsize=8, color=INK, labelpad=1)
        _plain(axes)


def _plain(axes: Axes) -> None:
    axes.tick_params(length=0, labelsize=7, colors=INK, pad=2)
    for spine in axes.spines.values():
        spine.set(color="#b9bdc6", linewidth=0.8)


_DRAW: Final[dict[str, Callable[[Any, Domain, int, int, Belief], None]]] = {
    "top-plate": _draw_heights,
    "two-bumps-1d": _draw_pairs,
    "two-bumps-2d": _draw_cells,
}
