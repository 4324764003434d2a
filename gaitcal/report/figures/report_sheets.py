"""Pages of curves and bars of Gait Profile Scores for a printed report."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.sax.saxutils import escape

import numpy as np
from reportlab.lib.colors import Color, HexColor
from reportlab.lib.styles import ParagraphStyle
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import Flowable, Paragraph

from gaitcal.gait import moments, profile_score
from gaitcal.model.linkage import SIDES
from gaitcal.report.figures import chart
from gaitcal.report.figures.curve_panel import NORM_COLOUR, CurvePanel, make_norm_key, make_side_key

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, FAINT, GRID = (HexColor(colour) for colour in (chart.INK, chart.FAINT, chart.GRID))
SHEET_COLUMNS, SHEET_ROWS = 3, 4
LETTERS: Final = chart.Sizes(small=6.0, normal=7.0, title=7.5)
LEGEND_ROW: Final = 0.15  # inches
POINTS_PER_INCH: Final = 72.0
ROW: Final = 0.245  # Height of a row of scores, inches
NUMBERS_WIDTH: Final = 150.0  # Room for the numbers of a row of scores, pt
LONGEST_LABEL: Final = 120  # Of the legend
LINE_LETTERS: Final = 34  # Of a sentence in place of a panel
SANS, BOLD = "ReportSans", "ReportSans-Bold"


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A page of panels, in rows of three."""

    title: str
    panels: tuple[CurvePanel | str, ...]  # A sentence where there is no curve
    note: str
    without: str  # Why there is no curve in any panel, where there is none
    comment: str
    thick: str = "mean ± 1 standard error"
    thin: str = (
        "thin: strides, vertical: toe-off"  # What thick lines with their bands are, and thin ones
    )

    @property
    def has_curves(self) -> bool:
        """Whether any stride has a value in any panel."""
        panels = (panel for panel in self.panels if isinstance(panel, CurvePanel))
        return any(
            np.isfinite(stride).any()
            for p in panels
            for of_side in p.strides.values()
            for stride in of_side
        )


@cache
def register_fonts() -> None:
    """Register DejaVu Sans of matplotlib: most alphabets, the same on every machine."""
    matplotlib = Path(
        getattr(find_spec("matplotlib"), "origin", "")
    )  # found, not loaded: that takes its time
    folder = matplotlib.parent / "mpl-data" / "fonts" / "ttf"
    for name, file in ((SANS, "DejaVuSans.ttf"), (BOLD, "DejaVuSans-Bold.ttf")):
        pdfmetrics.registerFont(TTFont(name, folder / file))
    pdfmetrics.registerFontFamily(SANS, normal=SANS, bold=BOLD, italic=SANS, boldItalic=BOLD)


def _make_style(
    size: float = 8.5, *, bold: bool = False, colour: Color = INK, before: float = 0.0
) -> ParagraphStyle:
    name = BOLD if bold else SANS
    return ParagraphStyle(
        f"{size}{bold}{colour}",
        fontName=name,
        fontSize=size,
        leading=1.35 * size,
        textColor=colour,
        spaceBefore=before,
    )


def make_paragraph(text: str, size: float = 8.5, **style: Any) -> Paragraph:
    """Make a paragraph of plain text, with its line breaks, at a size in points."""
    return Paragraph(escape(text).replace("\n", "<br/>"), _make_style(size, **style))


class Picture(Flowable):  # type: ignore[misc]
    """A chart on a page of the document."""

    def __init__(self, drawn: chart.Chart) -> None:
        super().__init__()
        self.figure = chart.draw_chart(drawn, dpi=POINTS_PER_INCH)
        self.width, self.height = (float(size) for size in self.figure.bbox.size)

    def wrap(self, *_: float) -> tuple[float, float]:
        """Return the fixed size."""
        return self.width, self.height

    def draw(self) -> None:
        """Draw on the canvas of the document."""
        from gaitcal.report.figures.canvas_renderer import CanvasRenderer

        self.figure.draw(CanvasRenderer(self.canv, self.wrap(), (SANS, BOLD)))


def build_sheet_chart(sheet: Sheet, norm: str, size: tuple[float, float]) -> chart.Chart:
    """Build the chart of a page of curves.

    Parameters
    ----------
    sheet
        Its panels.
    norm
        Name of the normative data.
    size
        Width and height of the page, pt.

    Returns
    -------
    Chart
        Panels in rows of three, and the legend.
    """
    keys = [make_side_key(side, f"{moments.SIDE_WORDS[side]}, {sheet.thick}") for side in SIDES]
    keys.append(chart.Key(label=sheet.thin, colour=chart.FAINT, width=0.0))
    if any(panel.norms for panel in sheet.panels if isinstance(panel, CurvePanel)):
        keys.append(make_norm_key(norm))
    # names of sessions and norms are the user's
    keys = [replace(key, label=chart.clean_name(key.label, LONGEST_LABEL)) for key in keys]
    width, height = (length / POINTS_PER_INCH for length in size)
    place = chart.Size(
        width=width / SHEET_COLUMNS,
        height=(height - len(keys) * LEGEND_ROW) / SHEET_ROWS,
        left=0.5,
        right=0.08,
        bottom=0.38,
        top=0.34,
        label=0.13,
    )
    return chart.Chart(
        name="",
        title=sheet.title,
        panels=tuple(
            _make_sentence_panel(panel, place)
            if isinstance(panel, str)
            else panel.make_panel(place, LETTERS, panel.title)
            for panel in sheet.panels
        ),
        keys=tuple(keys),
        columns=SHEET_COLUMNS,
        sizes=LETTERS,
        legend_row=LEGEND_ROW,
    )


def _make_sentence_panel(sentence: str, size: chart.Size) -> chart.Panel:
    def draw(axes: "Axes") -> None:
        axes.set_axis_off()
        axes.text(
            0.0,
            0.5,
            textwrap.fill(sentence, LINE_LETTERS),
            va="center",
            family=chart.FONT,
            fontsize=LETTERS.normal,
            color=chart.FAINT,
        )

    return chart.Panel(sentence, draw, size)


def build_profile_chart(scores: Sequence[profile_score.Score], width: float) -> chart.Chart:
    """Build the chart of Gait Profile Scores: bars of both sides over a grey bar of the norm.

    Parameters
    ----------
    scores
        With their standard errors.
    width
        pt.

    Returns
    -------
    Chart
        One panel; left bars are open.
    """
    by_variable: dict[str, list[profile_score.Score]] = {}
    for score in scores:
        by_variable.setdefault(score.variable, []).append(score)

    def draw(axes: "Axes") -> None:
        chart.format_axes(axes, xlabel="deg", sizes=LETTERS)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0, labelsize=LETTERS.normal)
        axes.set_yticks(
            range(len(by_variable)),
            [profile_score.make_score_title(row[0]) for row in by_variable.values()],
        )
        for y, row in enumerate(by_variable.values()):
            axes.barh(y, row[0].norm, 0.8, color=NORM_COLOUR)
            texts = []
            for s in row:
                known = np.isfinite(s.error)
                error = f" ± {s.error:.1f}" if known else ""
                texts.append(f"{moments.SIDE_WORDS.get(s.side, s.side)} {s.score:.1f}{error}")
                if s.side in SIDES:
                    colour = chart.SIDE_COLOURS[s.side]
                    axes.barh(
                        y + (-0.17 if s.side == "r" else 0.17),
                        s.score,
                        0.26,
                        facecolor=colour if s.side == "r" else "none",
                        edgecolor=colour,
                        linewidth=0.8,
                        xerr=s.error if known else None,
                        error_kw={"ecolor": chart.INK, "elinewidth": 0.8},
                    )
            axes.annotate(
                ",  ".join(texts),
                (1.0, y),
                (NUMBERS_WIDTH, 0.0),
                xycoords=axes.get_yaxis_transform(),
                textcoords="offset points",
                ha="right",
                va="center",
                family=chart.FONT,
                fontsize=LETTERS.small,
                color=chart.INK,
            )
        axes.set_xlim(left=0.0)
        axes.set_ylim(len(by_variable) - 0.5, -0.5)

    size = chart.Size(
        width=width / POINTS_PER_INCH,
        height=ROW * len(by_variable) + 0.4,
        left=1.6,
        right=NUMBERS_WIDTH / POINTS_PER_INCH,
        bottom=0.36,
        top=0.04,
    )
    label = "Gait Profile Score and Movement Analysis Profile"
    return chart.Chart(
        name="", title=label, panels=(chart.Panel(label, draw, size),), keys=(), columns=1
    )
