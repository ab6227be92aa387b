"""The architecture of a grounded agent (paper, Figure 1), drawn: history in, policy, value and beliefs out."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from bgn.analysis.figures import style

GROUNDED = "#D55E00"
_FILL = "#f5f6f8"
_BOX = (1.5, 0.62)  # width, height


def architecture() -> Figure:
    """Return the two networks of Ah-Ch+BGN; what grounding adds is in colour."""
    figure, (axes,) = style.panels(1, panel=(7.4, 3.1))
    axes.set_axis_off()
    axes.set(xlim=(-0.9, 9.6), ylim=(-0.2, 4.1))
    _text(axes, 0.0, 3.0, "observation\nand own last action\n" + r"$(a_{t-1}, o_{t-1})$")
    _text(axes, 0.0, 0.9, "the same")
    rows = ((3.0, "actor", r"policy $\pi(a\,|\,\hat{h})$", "a"), (0.9, "critic", r"value $V(\hat{h})$", "c"))
    for y, name, output, superscript in rows:
        _box(axes, 2.3, y, "GRU(256)", style.INK)
        _box(axes, 4.5, y, "FC(256) + tanh", style.INK)
        _text(axes, 3.4, y + 0.66, name, size=9, weight="bold")
        _box(axes, 6.7, y + 0.45, "FC", style.INK)
        _box(axes, 6.7, y - 0.45, "FC + softmax", GROUNDED)
        _text(axes, 8.6, y + 0.45, output)
        _text(axes, 8.6, y - 0.45, "belief " + rf"$\hat{{b}}^{{({superscript})}}$", colour=GROUNDED)
        for start, end, colour in (
            ((0.95, y), (1.5, y), style.INK),
            ((3.1, y), (3.7, y), style.INK),
            ((5.3, y), (5.9, y + 0.45), style.INK),
            ((5.3, y), (5.9, y - 0.45), GROUNDED),
            ((7.5, y + 0.45), (7.85, y + 0.45), style.INK),
            ((7.5, y - 0.45), (7.85, y - 0.45), GROUNDED),
        ):
            _arrow(axes, start, end, colour)
        axes.add_patch(
            FancyArrowPatch(
                (2.75, y - 0.33),
                (1.85, y - 0.33),
                connectionstyle="arc3,rad=-0.55",
                arrowstyle="-|>",
                mutation_scale=9,
                color=style.INK,
            )
        )
    loss = r"loss $=$ A2C $+\; H(b, \hat{b}^{(a)}) + H(b, \hat{b}^{(c)})$"
    source = "$b$ comes from the simulator, and only while training"
    _text(axes, 4.35, -0.05, f"{loss};  {source}", colour=GROUNDED, size=9)
    return figure


def _box(axes: Axes, x: float, y: float, text: str, colour: str) -> None:
    width, height = _BOX
    axes.add_patch(
        FancyBboxPatch(
            (x - width / 2, y - height / 2),
            width,
            height,
            boxstyle="round,pad=0.03,rounding_size=0.1",
            facecolor=_FILL,
            edgecolor=colour,
            linewidth=1.2,
        )
    )
    _text(axes, x, y, text, colour=colour)


def _text(
    axes: Axes,
    x: float,
    y: float,
    text: str,
    *,
    colour: str = style.INK,
    size: float = 8.5,
    weight: str = "normal",
) -> None:
    axes.text(x, y, text, ha="center", va="center", fontsize=size, color=colour, fontweight=weight)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    axes.add_patch(
        FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=10, color=colour, linewidth=1.1)
    )
