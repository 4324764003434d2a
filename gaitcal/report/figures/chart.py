"""Charts: panels with draw functions, one legend, and a common look.

The colours are those of Okabe and Ito, distinguishable for colour-blind readers. The global state
of matplotlib is not changed, and matplotlib is loaded at the first drawing only.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

RIGHT, LEFT, WHOLE = "#0072B2", "#C62828", "#009E73"
INK, FAINT, GRID = "#222222", "#666666", "#e6e6e6"
SIDE_COLOURS = {"r": RIGHT, "l": LEFT, "": WHOLE}
SIDE_DASHES: dict[str, tuple[float, ...]] = {"r": (), "l": (5.0, 1.6), "": ()}
"""The left side is dashed too: a print in grey stays readable."""

FONT = "DejaVu Sans"  # Comes with matplotlib; an SVG needs it on the reader's machine
SMALL, NORMAL, TITLE = 6.6, 7.2, 8.2
LONGEST_NAME = 26


@dataclass(frozen=True)
class Sizes:
    """Font sizes, pt."""

    small: float = SMALL  # Numbers at axes
    normal: float = NORMAL  # Labels of axes, legends
    title: float = TITLE


SCREEN: Final = Sizes()


@dataclass(frozen=True, kw_only=True)
class Key:
    """One entry of a figure's legend."""

    label: str
    colour: str
    dashes: tuple[float, ...] = ()  # Lengths of dashes and gaps, in line widths; none: a full line
    width: float = 1.6
    kind: str = "line"  # `line` or `band`


def make_line_style(dashes: tuple[float, ...]) -> Literal["-"] | tuple[float, tuple[float, ...]]:
    """Make a matplotlib line style from dashes."""
    return (0.0, dashes) if dashes else "-"


@lru_cache(maxsize=1)
def _load_font_characters() -> frozenset[int]:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return frozenset(get_font(findfont(FontProperties(family=FONT))).get_charmap())


def clean_name(text: str, limit: int = LONGEST_NAME) -> str:
    """Clean a name from the user's data: no markup, printable characters only, limited length.

    `$` starts matplotlib's markup and is escaped. Characters without a glyph and control characters
    become a middle dot.
    """
    known = _load_font_characters()
    shown = [
        c if c == " " or (ord(c) in known and unicodedata.category(c)[0] not in "CZ") else "·"
        for c in text
    ]
    if len(shown) > limit:
        shown = shown[: limit - 1] + ["…"]
    return "".join(shown).replace("$", r"\$")


def format_axes(
    axes: Axes,
    *,
    xlabel: str = "",
    ylabel: str = "",
    title: str = "",
    senses: str = "",
    sizes: Sizes = SCREEN,
) -> None:
    """Format axes: ink labels, no frame above and at the right, light grid lines.

    `senses` is a small line below the title.
    """
    from matplotlib.ticker import MaxNLocator

    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
        axes.spines[side].set_linewidth(0.6)
    axes.tick_params(
        colors=INK,
        labelsize=sizes.small,
        labelfontfamily=FONT,
        width=0.6,
        length=2.5,
        color=FAINT,
        pad=2,
    )
    axes.grid(color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.set_facecolor("white")
    axes.set_xlabel(xlabel, fontsize=sizes.normal, family=FONT, color=INK, labelpad=2)
    axes.set_ylabel(ylabel, fontsize=sizes.normal, family=FONT, color=INK, labelpad=2)
    if title:
        axes.set_title(
            title,
            fontsize=sizes.title,
            family=FONT,
            color=INK,
            loc="left",
            y=1.0,
            fontweight="bold",
            pad=4 + (1.3 * sizes.small if senses else 0),
        )
    axes.annotate(
        senses,
        (0.0, 1.0),
        (0.0, 4.0),
        xycoords="axes fraction",
        textcoords="offset points",
        fontsize=sizes.small,
        family=FONT,
        color=FAINT,
    )
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))


MARGIN = 0.06  # of the span of all values, at either end of an axis


def compute_limits(values: list[np.ndarray], least: float) -> tuple[float, float]:
    """Compute axis limits that contain all finite `values` and span at least `least`."""
    finite = np.concatenate([v[np.isfinite(v)].ravel() for v in values] or [np.empty(0)])
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    middle, half = (low + high) / 2, max((high - low) * (0.5 + MARGIN), least / 2)
    return middle - half, middle + half


LEGEND_INCHES = 0.32
LABEL_INCHES = 0.15  # Place of the vertical label of a panel, whatever the width of its numbers


@dataclass(frozen=True, kw_only=True)
class Size:
    """Outer size of a panel and the room around its axes, inches."""

    width: float = 2.45
    height: float = 1.85
    left: float = 0.58
    right: float = 0.1
    bottom: float = 0.36
    top: float = 0.24
    label: float = LABEL_INCHES  # From the left edge to the foot of the vertical label


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    label: str  # Description for readers who cannot see it
    draw: Callable[[Axes], None]
    size: Size = Size()


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Panels that belong together."""

    name: str  # Stem of the file in `write_charts`: plain ASCII
    title: str
    panels: tuple[Panel, ...]
    keys: tuple[Key, ...]
    columns: int = 3
    sizes: Sizes = SCREEN  # Of the letters of the legend
    legend_row: float = LEGEND_INCHES  # Height of a row of the legend, inches


def draw_chart(chart: Chart, dpi: float = 100.0) -> Figure:
    """Draw all panels of a chart in one figure with that number of dots per inch."""
    rows = [chart.panels[i : i + chart.columns] for i in range(0, len(chart.panels), chart.columns)]
    heights, widths = [], []
    for row in rows:
        heights.append(max(panel.size.height for panel in row))
        widths.append(sum(panel.size.width for panel in row))
    width = max(widths)
    columns = _count_legend_columns(chart, width)
    legend = chart.legend_row * -(-len(chart.keys) // columns)
    figure = create_figure(width, sum(heights) + legend, dpi)
    top = sum(heights) + legend
    for row, height in zip(rows, heights, strict=True):
        left = 0.0
        for panel in row:
            _place_panel(figure, panel, left, top - panel.size.height)
            left += panel.size.width
        top -= height
    if chart.keys:
        _add_legend(figure, chart, columns)
    return figure


def _add_legend(figure: Figure, chart: Chart, columns: int) -> Legend:
    return figure.legend(
        handles=[_make_handle(key) for key in chart.keys],
        loc="lower center",
        ncols=columns,
        frameon=False,
        prop={"family": FONT, "size": chart.sizes.normal},
    )


def _count_legend_columns(chart: Chart, width: float) -> int:
    """Count the legend columns that fit a figure of that width (inches)."""
    figure = create_figure(width, 1.0)
    for columns in range(len(chart.keys), 1, -1):
        legend = _add_legend(figure, chart, columns)
        if legend.get_window_extent().width <= figure.bbox.width:
            return columns
        legend.remove()
    return 1


def create_figure(width: float, height: float, dpi: float = 100.0) -> Figure:
    """Create an empty white figure, inches, with a canvas that measures text."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _place_panel(figure: Figure, panel: Panel, left: float, bottom: float) -> None:
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
    axes.yaxis.set_label_coords(
        -(size.left - size.label) / (size.width - size.left - size.right), 0.5
    )


def _make_handle(key: Key) -> Line2D | Patch:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if key.kind == "band":
        return Patch(facecolor=key.colour, label=key.label)
    return Line2D(
        [],
        [],
        color=key.colour,
        linestyle=make_line_style(key.dashes),
        linewidth=key.width,
        label=key.label,
    )


DPI: Final = 300  # As journals require
FORMATS: Final = ("png", "svg", "pdf")
_UNSIGNED: Final = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""Without date and program."""


def save_chart(chart: Chart, formats: Mapping[str, Path | IO[str]]) -> None:
    """Draw a chart and save it.

    Parameters
    ----------
    chart
        Chart to draw.
    formats
        One of `FORMATS` -> file or stream.
    """
    import matplotlib as mpl

    # identifiers of an SVG are made of its content and a word, not at random; letters stay letters
    with mpl.rc_context({"svg.hashsalt": "gaitcal", "svg.fonttype": "none", "pdf.fonttype": 42}):
        figure = draw_chart(chart)
        for suffix, target in formats.items():
            figure.savefig(target, format=suffix, dpi=DPI, metadata=_UNSIGNED[suffix])


def write_charts(charts: Iterable[Chart], folder: Path | str, formats: Sequence[str]) -> list[Path]:
    """Draw every chart into a folder, one file for each format.

    Parameters
    ----------
    charts
        Chart to draw.
    folder
        Created if missing.
    formats
        Of `FORMATS`.

    Returns
    -------
    list of Path
        The files.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for chart in charts:
        files = {suffix: folder / f"{chart.name}.{suffix}" for suffix in formats}
        save_chart(chart, files)
        written += files.values()
    return written
