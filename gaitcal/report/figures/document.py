"""A printed gait report: A4 pages of text, tables and sheets of curves, drawn as vectors without a
browser.

What stands in it is `ReportContent`, which `report/gait_report.py` reads from a result folder:
person, verdict, what counts, steps; kinematics; kinetics; joints, comments, signature.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Final

from reportlab.lib.colors import HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    PageBreak,
    PageTemplate,
    Paragraph,
    Spacer,
    Table,
)

from gaitcal.gait.profile_score import Score
from gaitcal.io.atomic import write_bytes_atomically
from gaitcal.report.figures.report_sheets import (
    BOLD,
    FAINT,
    GRID,
    INK,
    SANS,
    ProfileBars,
    Sheet,
    SheetOfCurves,
    printed,
    register_fonts,
)

TONES: Final = {
    "trustworthy": HexColor("#2e7d32"),
    "doubtful": HexColor("#b26a00"),
    "refused": HexColor("#b00020"),
}
MARGIN: Final = 15.0 * mm
HEADER_COLUMNS: Final = 5
LEAST_TABLE: Final = 60.0 * mm
LEAST_SHEET: Final = 150.0 * mm
"""Height of a sheet of curves that can be read; a comment that leaves less has pages of its own."""


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """Everything that a report says; all text is data, not markup."""

    person: tuple[tuple[str, str], ...]
    """Label and value: name, session, sex, age, diagnosis, mass, height, ...; the name first."""
    verdict: str  # `trustworthy`, `doubtful` or `refused`
    sentence: str
    reasons: tuple[
        tuple[str, str], ...
    ]  # What speaks against the result, and what to do about it; the worst first
    fit: tuple[str, ...]  # How well the model follows markers and forces, a sentence each
    walked: bool  # Whether there is a walk among the trials
    walks: tuple[
        tuple[str, ...], ...
    ]  # Head, then a row for each whole-body trial and leg: which strides count
    steps: tuple[tuple[str, ...], ...]  # Head, then a row for each spatiotemporal measure
    steps_norm: str  # Whom their norm is of; empty where there is none
    sheets: tuple[Sheet, ...]
    peaks: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]
    """Title, then head and rows of the peaks of each activity that is no gait."""
    norm: str  # Whom the grey bands are of; empty where there are none
    norm_remark: str  # Why these, or why none
    profile: tuple[
        Score, ...
    ]  # Movement Analysis Profile and Gait Profile Scores; empty where no norm fits
    joints: tuple[
        tuple[str, ...], ...
    ]  # Head, then a row for each joint: how far calibration moved it
    undetermined: tuple[str, ...]  # What the recordings do not determine
    comments: Mapping[str, str]  # Section (`COMMENT_SECTIONS`) -> what somebody wrote
    footer: str  # Program and version

    @property
    def title(self) -> str:
        """Of what it is, and whose."""
        return f"{'Gait' if self.walked else 'Movement'} report  ·  {self.person[0][1]}"


@dataclass(frozen=True, kw_only=True)
class ComparisonContent:
    """What the report of two sessions says."""

    title: str
    people: tuple[
        tuple[str, ...], ...
    ]  # Head with the names of both sessions, then label and value of each
    words: tuple[str, ...]  # Warnings, then what differs
    scores: tuple[
        tuple[str, ...], ...
    ]  # Head, then a row for each angle or score: before, after, difference
    steps: tuple[tuple[str, ...], ...]  # Head, then a row for each measure
    others: tuple[
        tuple[str, ...], ...
    ]  # The same of all other figures, the largest difference first
    sheets: tuple[Sheet, ...]
    comments: Mapping[str, str]
    footer: str


COMMENT_SECTIONS: Final = ("summary", "spatiotemporal", "kinematics", "kinetics", "joints")
"""Sections that may have a comment."""


def _heading(text: str) -> Paragraph:
    return printed(text, 11, bold=True, before=9)


def write_pdf(content: ReportContent | ComparisonContent, path: Path) -> int:
    """Write the report; returns the number of its pages. The same content gives the same bytes.

    Raises InputError: `path` is a folder, or cannot be written.
    """
    width, height = A4
    size = width - 2 * MARGIN, height - 2 * MARGIN - 16 * mm
    out = BytesIO()
    document = BaseDocTemplate(
        out, pagesize=A4, title=content.title, author="", creator=content.footer, invariant=1
    )
    frame = Frame(MARGIN, MARGIN + 6 * mm, *size, 0, 0, 0, 0)

    def decorate(canvas: Canvas, _: object) -> None:
        canvas.setFillColor(INK)
        canvas.setFont(BOLD, 8)
        canvas.drawString(MARGIN, height - MARGIN, content.title[:90])
        canvas.setFont(SANS, 7)
        canvas.setFillColor(FAINT)
        canvas.drawString(MARGIN, MARGIN - 2 * mm, content.footer)
        canvas.drawRightString(
            width - MARGIN - 5.6 * mm, MARGIN - 2 * mm, f"page {canvas.getPageNumber()}"
        )
        canvas.doForm(_Total.FORM)
        canvas.setStrokeColor(GRID)
        canvas.line(MARGIN, height - MARGIN - 2.5 * mm, width - MARGIN, height - MARGIN - 2.5 * mm)

    document.addPageTemplates(PageTemplate(id="page", frames=[frame], onPage=decorate))
    total = _Total(width - MARGIN - 5.6 * mm, MARGIN - 2 * mm)
    story = (
        _of_sessions(content, *size)
        if isinstance(content, ComparisonContent)
        else _story(content, *size)
    )
    document.build([*story, total])
    write_bytes_atomically(path, out.getvalue())
    return total.pages


class _Total(Flowable):  # type: ignore[misc]
    """The last flowable: draws how many pages there are into the form that every page shows."""

    FORM: Final = "total"

    def __init__(self, x: float, y: float) -> None:
        super().__init__()
        self.place, self.pages = (x, y), 0

    def draw(self) -> None:
        """On the last page, which is known then."""
        self.pages = self.canv.getPageNumber()
        self.canv.beginForm(self.FORM)
        self.canv.setFont(SANS, 7)
        self.canv.setFillColor(FAINT)
        self.canv.drawString(*self.place, f" of {self.pages}")
        self.canv.endForm()


def _story(content: ReportContent, width: float, height: float) -> list[Flowable]:
    register_fonts()
    out: list[Flowable] = [_person(content, width), Spacer(1, 4 * mm), _verdict(content, width)]
    out += [printed(sentence, before=3) for sentence in content.fit]
    out += _comment(content, "summary")
    if len(content.walks) > 1:
        out += [
            _heading("What counts for moments"),
            Spacer(1, 1.5 * mm),
            _table(content.walks, width),
        ]
    if len(content.steps) > 1:
        out += [_heading("Steps and phases"), Spacer(1, 1.5 * mm), _table(content.steps, width)]
        out += (
            [printed(content.steps_norm, 7, colour=FAINT, before=2)] if content.steps_norm else []
        )
    out += _comment(content, "spatiotemporal")
    for sheet in content.sheets:
        if not sheet.has_curves:
            out += [
                _heading(sheet.title),
                printed(sheet.without, before=2),
                *_comment(content, sheet.comment),
            ]
    profile = _profile(content, width)
    together = _height([*out, *profile], width, height) < height
    out += profile if together else []
    for sheet in filter(lambda sheet: sheet.has_curves, content.sheets):
        out += _sheet(sheet, content, (width, height), content.norm)
    for title, rows in content.peaks:
        out += [
            CondPageBreak(LEAST_TABLE),
            _heading(title),
            Spacer(1, 1.5 * mm),
            _table(rows, width),
        ]
    out += [
        PageBreak(),
        *([] if together else profile),
        _heading("Joints: where calibration moved them"),
    ]
    stayed = printed("Joint parameters stayed as they were.")
    out += [
        Spacer(1, 1.5 * mm),
        _table(content.joints, width) if len(content.joints) > 1 else stayed,
    ]
    if content.undetermined:
        out += [_heading("Not determined by these recordings")]
        out += [printed(f"·  {line}", before=2) for line in content.undetermined]
    out += _comment(content, "joints")
    return [*out, Spacer(1, 14 * mm), _signature(width)]


def _sheet(
    sheet: Sheet,
    content: ReportContent | ComparisonContent,
    size: tuple[float, float],
    norm: str = "",
) -> list[Flowable]:
    """A page of curves with its comment, which has a page of its own where it leaves the curves too
    little.
    """
    head = [_heading(sheet.title), printed(sheet.note, 7, colour=FAINT), Spacer(1, 2 * mm)]
    comment = _comment(content, sheet.comment)
    high = size[1] - _height(head, *size)
    left = high - _height(comment, *size)
    if left < LEAST_SHEET:
        left, comment = high, [PageBreak(), _heading(sheet.title), *comment]
    return [PageBreak(), *head, SheetOfCurves(sheet, norm, (size[0], left)), *comment]


def _of_sessions(content: ComparisonContent, width: float, height: float) -> list[Flowable]:
    register_fonts()
    out: list[Flowable] = [_table(content.people, width), _heading("What differs")]
    out += [*(printed(line, before=2) for line in content.words), *_comment(content, "summary")]
    for title, rows in (
        ("Gait Profile Score and Movement Analysis Profile", content.scores),
        ("Steps and phases", content.steps),
    ):
        if len(rows) > 1:
            out += [_heading(title), Spacer(1, 1.5 * mm), _table(rows, width)]
    out += _comment(content, "spatiotemporal")
    for sheet in content.sheets:
        if sheet.has_curves:
            out += _sheet(sheet, content, (width, height))
        else:
            out += [
                _heading(sheet.title),
                printed(sheet.without, before=2),
                *_comment(content, sheet.comment),
            ]
    if len(content.others) > 1:
        out += [
            PageBreak(),
            _heading("Largest other figures"),
            Spacer(1, 1.5 * mm),
            _table(content.others, width),
        ]
    return [*out, *_comment(content, "joints"), Spacer(1, 14 * mm), _signature(width)]


def _height(parts: Sequence[Flowable], width: float, height: float) -> float:
    return float(sum(part.wrap(width, height)[1] + part.getSpaceBefore() for part in parts))


def _profile(content: ReportContent, width: float) -> list[Flowable]:
    """Gait Profile Scores; of somebody whom no norm fits, why; nothing where there are no curves at
    all.
    """
    if not content.walked or not any(sheet.has_curves for sheet in content.sheets):
        return []
    out: list[Flowable] = [
        _heading("Gait Profile Score and Movement Analysis Profile"),
        Spacer(1, 1 * mm),
    ]
    if not content.profile:
        return [
            *out,
            printed(content.norm_remark or "The norm or the strides lack an angle of the profile."),
        ]
    words = (
        "RMS distance of each angle from healthy people's mean, deg, with its standard error "
        "(Baker 2009). Grey: "
    )
    words += f"what healthy people have themselves: {content.norm}."
    return [
        *out,
        printed(words, 7, colour=FAINT),
        Spacer(1, 1 * mm),
        ProfileBars(content.profile, width),
    ]


def _comment(content: ReportContent | ComparisonContent, section: str) -> list[Flowable]:
    text = content.comments.get(section, "").strip()
    return [printed("Comment", 8.5, bold=True, before=6), printed(text, before=1)] if text else []


def _person(content: ReportContent, width: float) -> Table:
    """Labels above values, in rows of `HEADER_COLUMNS`."""
    cells = [
        [printed(label, 7, colour=FAINT), printed(value, 9, bold=True)]
        for label, value in content.person
    ]
    cells += [[]] * (-len(cells) % HEADER_COLUMNS)
    rows = [cells[k : k + HEADER_COLUMNS] for k in range(0, len(cells), HEADER_COLUMNS)]
    return Table(
        rows,
        colWidths=[width / HEADER_COLUMNS] * HEADER_COLUMNS,
        style=[
            ("LEFTPADDING", (0, 0), (-1, -1), 0),
            ("TOPPADDING", (0, 0), (-1, -1), 1),
            ("BOTTOMPADDING", (0, 0), (-1, -1), 3),
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ],
    )


def _verdict(content: ReportContent, width: float) -> Table:
    tone = TONES.get(content.verdict, INK)
    parts: list[Flowable] = [
        printed(content.verdict.capitalize(), 12, bold=True, colour=tone),
        printed(content.sentence, before=2),
    ]
    for found, cure in content.reasons:
        parts += [printed(f"·  {found}", before=3), printed(f"    {cure}", 7.5, colour=FAINT)]
    return Table(
        [[parts]],
        colWidths=[width],
        style=[
            ("LINEBEFORE", (0, 0), (0, -1), 3, tone),
            ("LEFTPADDING", (0, 0), (-1, -1), 8),
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ],
    )


def _table(rows: Sequence[Sequence[str]], width: float) -> Table:
    """The first row is the head; columns as wide as their longest texts ask for, and words up to 14
    letters whole.
    """
    letters = [max(7.0, max(len(row[k]) for row in rows) ** 0.8) for k in range(len(rows[0]))]
    words = [
        max(len(word) for row in rows for word in (*row[k].split(), ""))
        for k in range(len(rows[0]))
    ]
    longest = [
        max(of_text, min(14, 1.1 * word)) for of_text, word in zip(letters, words, strict=True)
    ]
    widths = [width * part / sum(longest) for part in longest]
    body = [[printed(cell, 7.5, bold=k == 0) for cell in row] for k, row in enumerate(rows)]
    return Table(
        body,
        colWidths=widths,
        repeatRows=1,
        style=[
            ("LINEBELOW", (0, 0), (-1, 0), 0.8, INK),
            ("LINEBELOW", (0, 1), (-1, -1), 0.25, GRID),
            ("LEFTPADDING", (0, 0), (-1, -1), 2),
            ("TOPPADDING", (0, 0), (-1, -1), 1.5),
            ("BOTTOMPADDING", (0, 0), (-1, -1), 1.5),
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ],
    )


def _signature(width: float) -> Table:
    return Table(
        [[printed(word, 7.5, colour=FAINT) for word in ("Name", "Date", "Signature")]],
        colWidths=[0.4 * width, 0.2 * width, 0.4 * width],
        style=[("LINEABOVE", (0, 0), (-1, 0), 0.6, FAINT), ("LEFTPADDING", (0, 0), (-1, -1), 2)],
    )
