"""Write a printed gait report: A4 pages of text, tables and curves as vectors, without a browser.

`report/gait_report.py` reads its `ReportContent` from a result.
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
    Picture,
    Sheet,
    build_profile_chart,
    build_sheet_chart,
    make_paragraph,
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
"""Readable height of a sheet of curves; a comment that leaves less moves to further pages."""


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """Content of a report; all text is data, not markup."""

    person: tuple[tuple[str, str], ...]
    """Label and value: name, session, sex, age, diagnosis, mass, height, ...; the name first."""
    verdict: str
    """`trustworthy`, `doubtful` or `refused`."""
    sentence: str
    reasons: tuple[tuple[str, str], ...]
    """Reasons of the verdict and their remedies, the most severe first."""
    fit: tuple[str, ...]
    """Quality of the fit to markers and forces, in sentences."""
    walked: bool
    """Whether there is a walk among the trials."""
    walks: tuple[tuple[str, ...], ...]
    """Head, then a row for each whole-body trial and leg: strides that count."""
    steps: tuple[tuple[str, ...], ...]
    """Head, then a row for each spatiotemporal measure."""
    steps_norm: str
    """Population of their normative data; empty if there are none."""
    sheets: tuple[Sheet, ...]
    peaks: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]
    """Title, then head and rows of the peaks of each activity that is no gait."""
    norm: str
    """Population of the normative data (grey bands); empty if there are none."""
    norm_remark: str
    """Reason for these normative data, or for none."""
    profile: tuple[Score, ...]
    """Movement Analysis Profile and Gait Profile Scores; empty without normative data."""
    joints: tuple[tuple[str, ...], ...]
    """Head, then a row for each joint: its displacement by calibration."""
    undetermined: tuple[str, ...]
    """What the recordings do not determine."""
    comments: Mapping[str, str]
    """Section (`COMMENT_SECTIONS`) -> comment of the user."""
    footer: str
    """Program and version."""

    @property
    def title(self) -> str:
        """Kind of report and name of the subject."""
        return f"{'Gait' if self.walked else 'Movement'} report  ·  {self.person[0][1]}"


@dataclass(frozen=True, kw_only=True)
class ComparisonContent:
    """Content of the report of two sessions."""

    title: str
    people: tuple[
        tuple[str, ...], ...
    ]  # Head with the names of both sessions, then label and value of each
    sentences: tuple[str, ...]  # Warnings, then what differs
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


def _make_heading(text: str) -> Paragraph:
    return make_paragraph(text, 11, bold=True, before=9)


def write_pdf(content: ReportContent | ComparisonContent, path: Path) -> int:
    """Write a report as PDF; the same content gives the same bytes.

    Parameters
    ----------
    content
        What the report contains.
    path
        The file.

    Returns
    -------
    int
        Number of pages.

    Raises
    ------
    InputError
        `path` is a folder, or cannot be written.
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
        _build_comparison(content, *size)
        if isinstance(content, ComparisonContent)
        else _build_report(content, *size)
    )
    document.build([*story, total])
    write_bytes_atomically(path, out.getvalue())
    return total.pages


class _Total(Flowable):  # type: ignore[misc]
    """Last element of the document: draws the page count into the form that every page shows."""

    FORM: Final = "total"

    def __init__(self, x: float, y: float) -> None:
        super().__init__()
        self.place, self.pages = (x, y), 0

    def draw(self) -> None:
        """Draw on the last page, whose number is then known."""
        self.pages = self.canv.getPageNumber()
        self.canv.beginForm(self.FORM)
        self.canv.setFont(SANS, 7)
        self.canv.setFillColor(FAINT)
        self.canv.drawString(*self.place, f" of {self.pages}")
        self.canv.endForm()


def _build_report(content: ReportContent, width: float, height: float) -> list[Flowable]:
    register_fonts()
    out: list[Flowable] = [
        _build_person_table(content, width),
        Spacer(1, 4 * mm),
        _build_verdict_table(content, width),
    ]
    out += [make_paragraph(sentence, before=3) for sentence in content.fit]
    out += _build_comment(content, "summary")
    if len(content.walks) > 1:
        out += [
            _make_heading("What counts for moments"),
            Spacer(1, 1.5 * mm),
            _build_table(content.walks, width),
        ]
    if len(content.steps) > 1:
        out += [
            _make_heading("Steps and phases"),
            Spacer(1, 1.5 * mm),
            _build_table(content.steps, width),
        ]
        out += (
            [make_paragraph(content.steps_norm, 7, colour=FAINT, before=2)]
            if content.steps_norm
            else []
        )
    out += _build_comment(content, "spatiotemporal")
    for sheet in content.sheets:
        if not sheet.has_curves:
            out += [
                _make_heading(sheet.title),
                make_paragraph(sheet.without, before=2),
                *_build_comment(content, sheet.comment),
            ]
    profile = _build_profile(content, width)
    together = _measure_height([*out, *profile], width, height) < height
    out += profile if together else []
    for sheet in filter(lambda sheet: sheet.has_curves, content.sheets):
        out += _build_sheet(sheet, content, (width, height), content.norm)
    for title, rows in content.peaks:
        out += [
            CondPageBreak(LEAST_TABLE),
            _make_heading(title),
            Spacer(1, 1.5 * mm),
            _build_table(rows, width),
        ]
    out += [
        PageBreak(),
        *([] if together else profile),
        _make_heading("Joints: where calibration moved them"),
    ]
    stayed = make_paragraph("Joint parameters stayed as they were.")
    out += [
        Spacer(1, 1.5 * mm),
        _build_table(content.joints, width) if len(content.joints) > 1 else stayed,
    ]
    if content.undetermined:
        out += [_make_heading("Not determined by these recordings")]
        out += [make_paragraph(f"·  {line}", before=2) for line in content.undetermined]
    out += _build_comment(content, "joints")
    return [*out, Spacer(1, 14 * mm), _build_signature(width)]


def _build_sheet(
    sheet: Sheet,
    content: ReportContent | ComparisonContent,
    size: tuple[float, float],
    norm: str = "",
) -> list[Flowable]:
    """Build a page of curves with its comment, on a further page if it leaves too little room."""
    head = [
        _make_heading(sheet.title),
        make_paragraph(sheet.note, 7, colour=FAINT),
        Spacer(1, 2 * mm),
    ]
    comment = _build_comment(content, sheet.comment)
    high = size[1] - _measure_height(head, *size)
    left = high - _measure_height(comment, *size)
    if left < LEAST_SHEET:
        left, comment = high, [PageBreak(), _make_heading(sheet.title), *comment]
    return [PageBreak(), *head, Picture(build_sheet_chart(sheet, norm, (size[0], left))), *comment]


def _build_comparison(content: ComparisonContent, width: float, height: float) -> list[Flowable]:
    register_fonts()
    out: list[Flowable] = [_build_table(content.people, width), _make_heading("What differs")]
    out += [
        *(make_paragraph(line, before=2) for line in content.sentences),
        *_build_comment(content, "summary"),
    ]
    for title, rows in (
        ("Gait Profile Score and Movement Analysis Profile", content.scores),
        ("Steps and phases", content.steps),
    ):
        if len(rows) > 1:
            out += [_make_heading(title), Spacer(1, 1.5 * mm), _build_table(rows, width)]
    out += _build_comment(content, "spatiotemporal")
    for sheet in content.sheets:
        if sheet.has_curves:
            out += _build_sheet(sheet, content, (width, height))
        else:
            out += [
                _make_heading(sheet.title),
                make_paragraph(sheet.without, before=2),
                *_build_comment(content, sheet.comment),
            ]
    if len(content.others) > 1:
        out += [
            PageBreak(),
            _make_heading("Largest other figures"),
            Spacer(1, 1.5 * mm),
            _build_table(content.others, width),
        ]
    return [*out, *_build_comment(content, "joints"), Spacer(1, 14 * mm), _build_signature(width)]


def _measure_height(parts: Sequence[Flowable], width: float, height: float) -> float:
    return float(sum(part.wrap(width, height)[1] + part.getSpaceBefore() for part in parts))


def _build_profile(content: ReportContent, width: float) -> list[Flowable]:
    """Build the Gait Profile Scores, or the reason why there are none; nothing without curves."""
    if not content.walked or not any(sheet.has_curves for sheet in content.sheets):
        return []
    out: list[Flowable] = [
        _make_heading("Gait Profile Score and Movement Analysis Profile"),
        Spacer(1, 1 * mm),
    ]
    if not content.profile:
        return [
            *out,
            make_paragraph(
                content.norm_remark or "The norm or the strides lack an angle of the profile."
            ),
        ]
    explanation = (
        "RMS distance of each angle from healthy people's mean, deg, with its standard error "
        "(Baker 2009). Grey: "
    )
    explanation += f"what healthy people have themselves: {content.norm}."
    return [
        *out,
        make_paragraph(explanation, 7, colour=FAINT),
        Spacer(1, 1 * mm),
        Picture(build_profile_chart(content.profile, width)),
    ]


def _build_comment(content: ReportContent | ComparisonContent, section: str) -> list[Flowable]:
    text = content.comments.get(section, "").strip()
    return (
        [make_paragraph("Comment", 8.5, bold=True, before=6), make_paragraph(text, before=1)]
        if text
        else []
    )


def _build_person_table(content: ReportContent, width: float) -> Table:
    """Build labels above values, in rows of `HEADER_COLUMNS`."""
    cells = [
        [make_paragraph(label, 7, colour=FAINT), make_paragraph(value, 9, bold=True)]
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


def _build_verdict_table(content: ReportContent, width: float) -> Table:
    tone = TONES.get(content.verdict, INK)
    parts: list[Flowable] = [
        make_paragraph(content.verdict.capitalize(), 12, bold=True, colour=tone),
        make_paragraph(content.sentence, before=2),
    ]
    for found, cure in content.reasons:
        parts += [
            make_paragraph(f"·  {found}", before=3),
            make_paragraph(f"    {cure}", 7.5, colour=FAINT),
        ]
    return Table(
        [[parts]],
        colWidths=[width],
        style=[
            ("LINEBEFORE", (0, 0), (0, -1), 3, tone),
            ("LEFTPADDING", (0, 0), (-1, -1), 8),
            ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ],
    )


def _build_table(rows: Sequence[Sequence[str]], width: float) -> Table:
    """Build a table with a head; column widths follow the longest texts.

    Words of up to 14 letters are not broken.
    """
    parts = []
    for column in zip(*rows, strict=True):
        longest_text = max(map(len, column))
        longest_word = max(map(len, " ".join(column).split()), default=0)
        # longer texts get less than their share, as they are broken into lines
        parts.append(max(7.0, longest_text**0.8, min(14, 1.1 * longest_word)))
    widths = [width * part / sum(parts) for part in parts]
    head, *others = rows
    body = [[make_paragraph(cell, 7.5, bold=True) for cell in head]]
    for row in others:
        body.append([make_paragraph(cell, 7.5) for cell in row])
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


def _build_signature(width: float) -> Table:
    return Table(
        [[make_paragraph(word, 7.5, colour=FAINT) for word in ("Name", "Date", "Signature")]],
        colWidths=[0.4 * width, 0.2 * width, 0.4 * width],
        style=[("LINEABOVE", (0, 0), (-1, 0), 0.6, FAINT), ("LEFTPADDING", (0, 0), (-1, -1), 2)],
    )
