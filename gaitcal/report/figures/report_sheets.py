"""Draw sheets of curves and bars of Gait Profile Scores for a printed report, as vectors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np
from reportlab.lib.colors import Color, HexColor
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import Flowable, Paragraph

from gaitcal.arrays import Array
from gaitcal.gait import moments, profile_score
from gaitcal.gait.cycles import CurveKind
from gaitcal.model.linkage import SIDES
from gaitcal.report.figures import chart
from gaitcal.report.figures.chart import SIDE_DASHES, compute_limits

SIDE_COLOURS: Final = {side: HexColor(chart.SIDE_COLOURS[side]) for side in SIDES}
INK, FAINT, GRID, NORM = (
    HexColor(colour) for colour in (chart.INK, chart.FAINT, chart.GRID, "#d9d9d9")
)
SHEET_COLUMNS, SHEET_ROWS = 3, 4
LEAST: Final = {
    CurveKind.ANGLE: 20.0,
    CurveKind.MOMENT: 0.4,
    CurveKind.POWER: 1.0,
    CurveKind.FORCE: 2.0,
}
"""Smallest range of a vertical axis, in the units of a printed report: small changes look small."""
SANS, BOLD = "ReportSans", "ReportSans-Bold"


@dataclass(frozen=True, kw_only=True)
class CurvePanel:
    """One variable over the gait cycle, in `unit` and clinical signs; NaN where not valid."""

    title: str
    unit: str
    senses: tuple[str, str]  # What positive and negative values mean
    strides: Mapping[str, tuple[Array, ...]]  # Side -> (101,) of every straight stride
    mean: Mapping[str, Array]  # Side -> (101,)
    error: Mapping[str, Array]  # Side -> (101,) standard error of the mean
    norm: tuple[Array, Array] | None  # Mean and SD (101,) of healthy people
    least: float
    thin: tuple[float, float] = (0.4, 0.35)  # Width in points and opacity of the lines of strides


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
    toe_off: Mapping[str, float] = field(default_factory=dict)  # Side -> %, the mean over strides

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


class SheetOfCurves(Flowable):  # type: ignore[misc]
    """Panels in rows of three, with one legend below."""

    def __init__(self, sheet: Sheet, norm: str, size: tuple[float, float]) -> None:
        super().__init__()
        bands = (panel.norm for panel in sheet.panels if isinstance(panel, CurvePanel))
        self.sheet, self.norm = sheet, norm if any(band is not None for band in bands) else ""
        self.width, self.height = size

    def wrap(self, *_: float) -> tuple[float, float]:
        """Return the fixed size."""
        return self.width, self.height

    def draw(self) -> None:
        """Draw on the canvas of the document."""
        legend = 10 * mm
        size = self.width / SHEET_COLUMNS, (self.height - legend) / SHEET_ROWS
        for k, panel in enumerate(self.sheet.panels):
            row, column = divmod(k, SHEET_COLUMNS)
            place = column * size[0], self.height - (row + 1) * size[1]
            if isinstance(panel, str):
                part = make_paragraph(panel, 7, colour=FAINT)
                _, high = part.wrap(size[0] - 14 * mm, size[1])
                part.drawOn(self.canv, place[0] + 8 * mm, place[1] + 0.5 * (size[1] - high))
            else:
                _Axes(self.canv, panel, place, size).draw(self.sheet.toe_off)
        self._draw_legend()

    def _draw_legend(self) -> None:
        canvas, x = self.canv, 4 * mm
        canvas.saveState()
        canvas.translate(0, 4.5 * mm)
        canvas.setFont(SANS, 7)
        for side, colour in SIDE_COLOURS.items():
            canvas.setStrokeColor(colour)
            canvas.setLineWidth(1.4)
            canvas.setDash(*([list(SIDE_DASHES[side])] if SIDE_DASHES[side] else [[]]))
            canvas.line(x, 2 * mm, x + 8 * mm, 2 * mm)
            x = _draw_word(canvas, x + 9.5 * mm, f"{moments.SIDE_WORDS[side]}, {self.sheet.thick}")
        canvas.setDash([])
        _draw_word(canvas, x, self.sheet.thin)
        canvas.restoreState()
        canvas.setFont(SANS, 7)
        if self.norm:
            canvas.setFillColor(NORM)
            canvas.rect(4 * mm, 0.8 * mm, 8 * mm, 2.6 * mm, stroke=0, fill=1)
            _draw_word(canvas, 13.5 * mm, f"{self.norm}, mean ± SD"[:150])


class ProfileBars(Flowable):  # type: ignore[misc]
    """Bars of both sides with standard errors over a grey normative bar; left bars are open."""

    ROW = 6.2 * mm
    LABEL, NUMBERS = 40 * mm, 52 * mm

    def __init__(self, scores: Sequence[profile_score.Score], width: float) -> None:
        super().__init__()
        by_variable: dict[str, list[profile_score.Score]] = {}
        for score in scores:
            by_variable.setdefault(score.variable, []).append(score)
        self.rows = list(by_variable.items())
        self.width, self.height = width, (len(self.rows) + 1) * self.ROW
        self.most = max(s.score + (s.error if np.isfinite(s.error) else 0.0) for s in scores)
        self.most = max(self.most, *(s.norm for s in scores)) * 1.05

    def wrap(self, *_: float) -> tuple[float, float]:
        """Return the fixed size."""
        return self.width, self.height

    def draw(self) -> None:
        """Draw on the canvas of the document."""
        canvas, step = self.canv, 5.0 if self.most > 12.0 else 2.0
        canvas.setStrokeColor(GRID)
        canvas.setLineWidth(0.4)
        canvas.setFont(SANS, 6)
        canvas.setFillColor(FAINT)
        for value in np.arange(0.0, self.most, step):
            canvas.line(self._at(value), self.ROW, self._at(value), self.height)
            canvas.drawCentredString(
                self._at(value), self.ROW - 3 * mm, f"{value:g}" + (" deg" if not value else "")
            )
        for k, (_, of_row) in enumerate(self.rows):
            self._draw_row(of_row, self.height - (k + 1) * self.ROW)

    def _at(self, value: float) -> float:
        return float(self.LABEL + (self.width - self.LABEL - self.NUMBERS) * value / self.most)

    def _draw_row(self, scores: Sequence[profile_score.Score], low: float) -> None:
        canvas, texts = self.canv, list[str]()
        canvas.setFillColor(NORM)
        canvas.rect(
            self._at(0),
            low + 0.5 * mm,
            self._at(scores[0].norm) - self._at(0),
            self.ROW - 1 * mm,
            0,
            1,
        )
        canvas.setFillColor(INK)
        canvas.setFont(BOLD if len(scores) > len(SIDES) else SANS, 7.5)
        canvas.drawString(0, low + 2 * mm, profile_score.make_score_title(scores[0]))
        for s in scores:
            error = f" ± {s.error:.1f}" if np.isfinite(s.error) else ""
            texts.append(f"{moments.SIDE_WORDS.get(s.side, s.side)} {s.score:.1f}{error}")
            if s.side not in SIDES:
                continue
            y = low + (3.2 * mm if s.side == "r" else 1.2 * mm)
            canvas.setStrokeColor(SIDE_COLOURS[s.side])
            canvas.setFillColor(SIDE_COLOURS[s.side])
            canvas.setLineWidth(0.8)
            canvas.rect(
                self._at(0), y, self._at(s.score) - self._at(0), 1.6 * mm, 1, int(s.side == "r")
            )
            if error:
                canvas.setStrokeColor(INK)
                ends = self._at(max(s.score - s.error, 0.0)), self._at(s.score + s.error)
                canvas.line(ends[0], y + 0.8 * mm, ends[1], y + 0.8 * mm)
        canvas.setFont(SANS, 6.5)
        canvas.setFillColor(INK)
        canvas.drawRightString(self.width, low + 2 * mm, ",  ".join(texts))


def _draw_word(canvas: Canvas, x: float, text: str) -> float:
    canvas.setFillColor(INK)
    canvas.drawString(x, 1.1 * mm, text)
    return float(x + pdfmetrics.stringWidth(text, SANS, 7) + 3.5 * mm)


class _Axes:
    """One panel on a canvas: 0 to 100 % across; vertical limits contain curves and norm."""

    def __init__(
        self,
        canvas: Canvas,
        panel: CurvePanel,
        place: tuple[float, float],
        size: tuple[float, float],
    ) -> None:
        self.canvas, self.panel = canvas, panel
        self.x0, self.y0 = place[0] + 9.5 * mm, place[1] + 6.5 * mm
        self.width, self.height = size[0] - 12 * mm, size[1] - 14 * mm
        self.low, self.high, self.step = compute_panel_limits(panel)

    def at(self, percent: float, value: float) -> tuple[float, float]:
        """Convert percent and value to points of the page."""
        up = (value - self.low) / (self.high - self.low)
        return self.x0 + self.width * percent / 100.0, self.y0 + self.height * up

    def draw(self, toe_off: Mapping[str, float]) -> None:
        """Draw grid, norm, strides, error bands and means."""
        canvas, panel = self.canvas, self.panel
        canvas.saveState()
        self._draw_frame()
        clip = canvas.beginPath()
        clip.rect(self.x0, self.y0, self.width, self.height)
        canvas.clipPath(clip, stroke=0, fill=0)
        if panel.norm is not None:
            self._draw_band(*panel.norm, NORM, 1.0)
        for side, percent in toe_off.items():
            canvas.setStrokeColor(SIDE_COLOURS[side])
            self._draw_line(
                (np.array([percent, percent]), np.array([self.low, self.high])),
                0.5,
                SIDE_DASHES[side],
            )
        at = np.arange(101.0)
        for side, strides in panel.strides.items():
            canvas.setStrokeColor(SIDE_COLOURS[side])
            canvas.setStrokeAlpha(panel.thin[1])
            for stride in strides:
                self._draw_line((at, stride), panel.thin[0], SIDE_DASHES[side])
            canvas.setStrokeAlpha(1.0)
        for side, mean in panel.mean.items():
            self._draw_band(mean, panel.error[side], SIDE_COLOURS[side], 0.18)
            canvas.setStrokeColor(SIDE_COLOURS[side])
            self._draw_line((at, mean), 1.4, SIDE_DASHES[side])
        canvas.restoreState()
        if not any(np.isfinite(mean).any() for mean in panel.mean.values()):
            canvas.setFillColor(FAINT)
            canvas.setFont(SANS, 7)
            canvas.drawCentredString(
                self.x0 + self.width / 2, self.y0 + self.height / 2, "no stride counts"
            )

    def _draw_frame(self) -> None:
        canvas, panel = self.canvas, self.panel
        top = self.y0 + self.height
        canvas.setFillColor(INK)
        canvas.setFont(BOLD, 7.5)
        canvas.drawString(self.x0 - 7 * mm, top + 4.2 * mm, f"{panel.title}, {panel.unit}")
        canvas.setFont(SANS, 6)
        canvas.setFillColor(FAINT)
        senses = (
            f"{sign} {sense}" for sign, sense in zip("+−", panel.senses, strict=True) if sense
        )
        canvas.drawString(self.x0 - 7 * mm, top + 1.4 * mm, "   ".join(senses))
        canvas.setStrokeColor(GRID)
        canvas.setLineWidth(0.4)
        for value in (
            np.arange(np.ceil(self.low / self.step), np.floor(self.high / self.step) + 1)
            * self.step
        ):
            x, y = self.at(0.0, value)
            canvas.setLineWidth(0.9 if abs(value) < 1e-9 else 0.4)
            canvas.line(x, y, x + self.width, y)
            canvas.drawRightString(
                x - 1 * mm, y - 2, f"{round(value, 9) + 0.0:.6g}".replace("-", "−")
            )
        for percent in (0, 25, 50, 75, 100):
            x, _ = self.at(percent, self.low)
            canvas.line(x, self.y0, x, self.y0 - 1 * mm)
            canvas.drawCentredString(
                x, self.y0 - 3.6 * mm, f"{percent}" + (" %" if percent == 100 else "")
            )

    def _draw_line(
        self, points: tuple[Array, Array], width: float, dashes: Sequence[float]
    ) -> None:
        self.canvas.setLineWidth(width)
        self.canvas.setDash(list(dashes))
        path, down = self.canvas.beginPath(), False
        for percent, value in zip(*points, strict=True):
            if not np.isfinite(value):
                down = False
                continue
            (path.lineTo if down else path.moveTo)(*self.at(percent, value))
            down = True
        self.canvas.drawPath(path, stroke=1, fill=0)

    def _draw_band(self, mean: Array, half: Array, colour: Color, alpha: float) -> None:
        """Draw one polygon for each run of known percents."""
        known = np.isfinite(mean) & np.isfinite(half)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
        self.canvas.setFillColor(colour)
        self.canvas.setFillAlpha(alpha)
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            at = np.arange(start, stop)
            path = self.canvas.beginPath()
            corners = [(p, mean[p] + half[p]) for p in at] + [
                (p, mean[p] - half[p]) for p in at[::-1]
            ]
            for k, corner in enumerate(corners):
                (path.lineTo if k else path.moveTo)(*self.at(*corner))
            path.close()
            self.canvas.drawPath(path, stroke=0, fill=1)
        self.canvas.setFillAlpha(1.0)


def compute_panel_limits(panel: CurvePanel) -> tuple[float, float, float]:
    """Compute limits and grid step of a panel: 1, 2 or 5 times a power of ten, about five steps."""
    values, least = [v for strides in panel.strides.values() for v in strides], panel.least
    for side, mean in panel.mean.items():
        values += [mean - panel.error[side], mean + panel.error[side]]
    if panel.norm is not None:
        values += [panel.norm[0] - panel.norm[1], panel.norm[0] + panel.norm[1]]
    low, high = compute_limits(values, least)
    rough = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(float(f * power) for f in (1.0, 2.0, 5.0, 10.0) if f * power >= rough)
    return low, high, step
