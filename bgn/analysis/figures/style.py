"""One look for all figures: colours that most eyes tell apart, legible in grey and in print."""

from __future__ import annotations

import io
import math
import pathlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

#: Colours of Okabe and Ito, one per agent of the paper; grounded agents are warm.
COLOURS: Final = {
    "ah-ch": "#0072B2",
    "ah-ch+bgn": "#D55E00",
    "ah-cs": "#009E73",
    "ab-cb": "#CC79A7",
    "ah-cb": "#56B4E9",
    "ab-cb+bgn": "#E69F00",
}
#: Lines that differ in grey as well; those of grounded agents are unbroken.
DASHES: Final = {
    "ah-ch": (0, (5, 1.5)),
    "ah-ch+bgn": "-",
    "ah-cs": (0, (1.5, 1.2)),
    "ab-cb": (0, (6, 1.5, 1.5, 1.5)),
    "ah-cb": (0, (3, 1, 1, 1, 1, 1)),
    "ab-cb+bgn": "-",
}
MARKERS: Final = {"ah-ch": "o", "ah-ch+bgn": "D", "ah-cs": "s", "ab-cb": "^", "ah-cb": "v", "ab-cb+bgn": "P"}
_SPARE: Final = ("#7A7A7A", "#A0522D", "#5B4B8A", "#3C6E47")
INK: Final = "#2b2f38"
MUTED: Final = "#6b7280"
RULE: Final = "#d5d8de"
GROUNDED_WIDTH, PLAIN_WIDTH = 2.0, 1.3

_ENTRY_INCHES: Final = 1.5
PANEL_INCHES: Final = (3.5, 2.6)
DOTS_PER_INCH: Final = 120


def colour(agent: str, agents: Sequence[str] = ()) -> str:
    """Return an agent's colour; agents of other people's get the spare ones in their order."""
    if agent in COLOURS:
        return COLOURS[agent]
    others = [name for name in agents if name not in COLOURS] or [agent]
    return _SPARE[others.index(agent) % len(_SPARE)]


def line(agent: str, agents: Sequence[str] = ()) -> dict[str, Any]:
    """Return how an agent's curve is drawn, as matplotlib's keywords."""
    grounded = agent.endswith("+bgn")
    return {
        "color": colour(agent, agents),
        "linestyle": DASHES.get(agent, "-"),
        "linewidth": GROUNDED_WIDTH if grounded else PLAIN_WIDTH,
        "zorder": 3 if grounded else 2,
    }


def panels(
    count: int, columns: int = 4, *, panel: tuple[float, float] = PANEL_INCHES
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels, row by row, and room for a legend below."""
    columns = max(1, min(columns, count))
    rows = max(1, math.ceil(count / columns))
    figure = Figure(figsize=(columns * panel[0], rows * panel[1] + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(np.ravel(figure.subplots(rows, columns, squeeze=False)))
    for spare in axes[count:]:
        spare.set_axis_off()
    return figure, axes[:count]


def plain(axes: Axes, title: str = "", x: str = "", y: str = "") -> None:
    """Give axes their title and labels, and take away what carries nothing."""
    axes.set_title(title, fontsize=10, color=INK, loc="left", fontweight="bold")
    axes.set_xlabel(x, fontsize=8, color=INK)
    axes.set_ylabel(y, fontsize=8, color=INK)
    axes.tick_params(labelsize=8, colors=INK, length=3, color=RULE)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)
    axes.grid(axis="y", color=RULE, linewidth=0.6)
    axes.set_axisbelow(True)


def legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """Put one legend of all panels below them, every label once."""
    entries: dict[str, Artist] = {}
    for panel in axes:
        for artist, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, artist)
    if entries:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc="outside lower center",
            ncols=max(1, min(len(entries), int(figure.get_figwidth() / _ENTRY_INCHES))),
            frameon=False,
            fontsize=8,
            handlelength=2.6,
        )


def caption(figure: Figure, text: str) -> None:
    """Say, small and above all panels, what is drawn."""
    figure.suptitle(text, fontsize=8.5, color=MUTED, x=0.01, ha="left")


def logarithmic(axes: Axes) -> None:
    """Make the horizontal axis logarithmic, its ticks plain numbers with units of thousands and millions."""
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    low, high = axes.get_xlim()
    if high < 30 * low:
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_minor_formatter(NullFormatter())


def nothing(text: str) -> Figure:
    """Return a small figure that says why there is nothing to draw."""
    figure, (axes,) = panels(1, panel=(6.0, 0.6))
    axes.set_axis_off()
    axes.text(0, 0.5, text, fontsize=9, color=MUTED, va="center")
    return figure


def png(figure: Figure, dots_per_inch: int = DOTS_PER_INCH) -> bytes:
    """Return a figure as PNG, the same bytes each time."""
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=dots_per_inch, metadata={"Software": None})
    return image.getvalue()


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG, the same bytes each time."""
    image = io.BytesIO()
    with rc_context({"svg.hashsalt": "bgn", "svg.fonttype": "none"}):
        figure.savefig(image, format="svg", metadata={"Date": None, "Creator": None})
    return image.getvalue()


def save(figure: Figure, stem: pathlib.Path) -> None:
    """Write ``stem.png`` and ``stem.svg``."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    stem.with_suffix(".png").write_bytes(png(figure))
    stem.with_suffix(".svg").write_bytes(svg(figure))
