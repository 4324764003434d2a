"""A chart is a list of panels that know how to draw themselves.

The page places panels one by one, so that a phone shows them below each other and a desktop three in a row. For papers
the same panels stand in one figure with its legend.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gaitcal.figures.style import FONT, SCREEN, Key, Sizes, line_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

LEGEND_INCHES = 0.32
LABEL_INCHES = 0.15
"""Place of the vertical label of a panel, whatever the width of its numbers."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """Outer size of a panel and the room around its axes, inches."""

    width: float = 2.45
    height: float = 1.85
    left: float = 0.58
    right: float = 0.1
    bottom: float = 0.36
    top: float = 0.24
    label: float = LABEL_INCHES
    """From the left edge to the foot of the vertical label."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    label: str
    """What it shows, for readers who cannot see it."""
    draw: Callable[[Axes], None]
    size: Size = Size()


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Panels that belong together."""

    name: str
    """Stem of the file in `write_figures`: plain ASCII."""
    title: str
    panels: tuple[Panel, ...]
    keys: tuple[Key, ...]
    columns: int = 3
    sizes: Sizes = SCREEN
    """Of the letters of the legend."""
    legend_row: float = LEGEND_INCHES
    """Height of a row of the legend, inches."""


def panel_figure(panel: Panel) -> Figure:
    """One panel alone, as the page shows it."""
    size = panel.size
    figure = new_figure(size.width, size.height)
    _place(figure, panel, 0.0, 0.0)
    return figure


def chart_figure(chart: Chart) -> Figure:
    """All panels of a chart in one figure, for papers."""
    rows = [chart.panels[i : i + chart.columns] for i in range(0, len(chart.panels), chart.columns)]
    heights = [max(p.size.height for p in row) for row in rows]
    width = max(sum(p.size.width for p in row) for row in rows)
    columns = _legend_columns(chart, width)
    legend = chart.legend_row * -(-len(chart.keys) // columns)
    figure = new_figure(width, sum(heights) + legend)
    top = sum(heights) + legend
    for row, height in zip(rows, heights, strict=True):
        left = 0.0
        for panel in row:
            _place(figure, panel, left, top - panel.size.height)
            left += panel.size.width
        top -= height
    if chart.keys:
        _legend(figure, chart, columns)
    return figure


def _legend(figure: Figure, chart: Chart, columns: int) -> Legend:
    return figure.legend(
        handles=[_handle(key) for key in chart.keys],
        loc="lower center",
        ncols=columns,
        frameon=False,
        prop={"family": FONT, "size": chart.sizes.normal},
    )


def _legend_columns(chart: Chart, width: float) -> int:
    """As many columns as fit a figure of that width (inches)."""
    figure = new_figure(width, 1.0)
    for columns in range(len(chart.keys), 1, -1):
        legend = _legend(figure, chart, columns)
        if legend.get_window_extent().width <= figure.bbox.width:
            return columns
        legend.remove()
    return 1


def new_figure(width: float, height: float, dpi: int = 100) -> Figure:
    """An empty white figure, inches, that knows the size of its texts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _place(figure: Figure, panel: Panel, left: float, bottom: float) -> None:
    width, height = (float(v) for v in figure.get_size_inches())
    size = panel.size
    axes = figure.add_axes(
        (
            (left + size.left) / width,
            (bottom + size.bottom) / height,
            (size.width - size.left - size.right) / width,
            (size.height - size.bottom - size.top) / height,
        )
    )
    panel.draw(axes)
    axes.yaxis.set_label_coords(-(size.left - size.label) / (size.width - size.left - size.right), 0.5)


def _handle(key: Key) -> Line2D | Patch:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if key.kind in ("band", "area"):
        return Patch(facecolor=key.colour, alpha=0.25 if key.kind == "band" else 1.0, label=key.label)
    if key.kind == "line":
        return Line2D([], [], color=key.colour, linestyle=line_style(key.dashes), linewidth=key.width, label=key.label)
    shape = {"dot": "o", "ring": "o", "tick": "|"}[key.kind]
    filled = "white" if key.kind == "ring" else key.colour
    return Line2D(
        [], [], linestyle="", marker=shape, markersize=5, color=key.colour, markerfacecolor=filled, label=key.label
    )
