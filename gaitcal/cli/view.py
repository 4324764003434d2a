"""`gaitcal view`, and `gaitcal report`, the same on paper.

`gaitcal compare`: two sessions of one person, or an OpenSim model beside ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.text import Text

from gaitcal.cli.console import Console, frameless_table
from gaitcal.compare.comparison import compare, osim_words
from gaitcal.compare.difference import numbers_of, subject
from gaitcal.compare.opensim_motion import compare_motion
from gaitcal.compare.sessions import SessionComparison
from gaitcal.errors import UsageError
from gaitcal.findings import note_of
from gaitcal.gait.moments import counted
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.atomic import atomic_text
from gaitcal.io.result_folder import MANIFEST, ResultKind, file_in_place, require_room
from gaitcal.page.bone_files import bones_of_folder
from gaitcal.page.server import serve
from gaitcal.page.view import page_html, sentences
from gaitcal.results.calibration import result_page
from gaitcal.results.saved import load_result_model, our_trials
from gaitcal.results.sessions import compare_results, comparison_content, comparison_html, write_comparison
from gaitcal.results.shared_model import compare_with_shared_model

REPORT, COMMENTS = "report.pdf", "comments.toml"


def view_result(
    console: Console, result: Path, other: Path | None = None, html: Path | None = None, geometry: Path | None = None
) -> None:
    """Show the page of a result in the browser, or write it; with another one, that of their comparison.

    `geometry`: bones of this folder, else the installed ones.
    """
    if other is None:
        bones = None if geometry is None else bones_of_folder(geometry)
        shown, lines = result_page(result)
        for line in (*lines, *sentences(shown)):
            console.line(line)
        page = page_html(shown, bones)
    else:
        if geometry is not None:
            raise UsageError("found two results, whose page has no bones; allowed: with one result", field="--geometry")
        page = comparison_html(compare_results(result, other), (result, other))
    if html is not None:
        with file_in_place(html) as path:
            atomic_text(path, page)
        console.line(f"wrote {html}")
        return
    serve(page, ready=lambda url: console.line(f"{url}  (Ctrl-C ends)"))


def print_report(
    console: Console,
    result: Path,
    other: Path | None = None,
    pdf: Path | None = None,
    comments: Path | None = None,
    normal: Path | None = None,
) -> None:
    """Write the report of a result, or of two sessions, as a PDF, with the comments that somebody wrote for it."""
    from gaitcal.figures.document import ComparisonContent, ReportContent, write_pdf
    from gaitcal.results.gait_report import read_comments, report_content

    if other is not None and pdf is None:
        raise UsageError("found two results; needed: --pdf FILE", field="--pdf")
    if other is not None and normal is not None:
        raise UsageError(
            "found two results, each held against its own norm; allowed: with one result", field="--normal"
        )
    beside = result / COMMENTS
    file = comments or (beside if other is None and beside.is_file() else None)
    said = {} if file is None else read_comments(file)
    content: ReportContent | ComparisonContent
    if other is None:
        named = None if normal is None else (read_normal_bands(normal), normal.name)
        content = report_content(result, named, said)
    else:
        content = comparison_content(compare_results(result, other), (result, other), said)
    target = pdf or result / REPORT
    with file_in_place(target) as path:
        pages = write_pdf(content, path)
    console.line(f"wrote {target}: {counted(pages, 'page')}" + (f", comments of {file}" if file else ""))


SHOWN = 30
"""Rows of the table on the screen; the file has all."""
WIDTH = 40
"""Characters of a figure's name, at least."""


def compare_sessions_or_models(
    console: Console,
    result: Path,
    other: Path | None = None,
    *,
    osim: Path | None = None,
    out: Path | None = None,
    shared_model: bool = False,
    motion: bool = False,
    study: Sequence[Path] | None = None,
) -> None:
    """Compare two results, or one with an OpenSim model."""
    if osim is not None and (other is not None or out is not None or shared_model):
        message = "found a second result, --out or --shared-model beside it; allowed: one result and --osim FILE"
        raise UsageError(message, field="--osim")
    if motion and osim is None:
        raise UsageError("found without --osim, whose model it is for", field="--motion")
    if study and not shared_model:
        raise UsageError("found without --shared-model, which alone needs them", field="--study")
    if osim is not None:
        compare_models(result, osim, console)
        if motion:
            compare_motions(result, osim, console)
        return
    if other is None:
        raise UsageError("found one result; allowed: two results, or one and --osim FILE", field="compare")
    if out is not None:
        require_room(out, ResultKind.COMPARISON, [folder / MANIFEST for folder in (result, other)])
    shared = None
    if shared_model:
        with console.working() as step:
            comparison, shared = compare_with_shared_model(result, other, study or (), step)
    else:
        comparison = compare_results(result, other)
    tell(comparison, console)
    if out is not None:
        write_comparison(comparison, out, (result, other), shared)
        console.line(f"wrote {out}")


def tell(comparison: SessionComparison, console: Console) -> None:
    """Warnings and words first, then the table of what differs most."""
    for line in comparison.lines:
        console.line(line)
    if not comparison.found:
        return
    table = frameless_table(("figure", "unit"), (*comparison.names, "difference", "missed below", "times"))
    table.columns[0].min_width = WIDTH
    for d in comparison.found[:SHOWN]:
        table.add_row(Text(subject(d)), d.unit, *numbers_of(d))
    console.line()
    console.out.print(table)
    if (rest := len(comparison.found) - SHOWN) > 0:
        console.line(f"and {rest} more: --out FOLDER writes all")


def compare_models(result: Path, osim: Path, console: Console) -> None:
    """Say in words what an OpenSim model differs in, then print its joint axes, masses and lengths beside ours."""
    table = frameless_table(("quantity", "unit"), ("ours", "theirs", "difference"))
    model, read, doubts = load_result_model(result)
    for text in (*read.remarks, *map(note_of, doubts)):
        console.line(f"warning: {text}")
    rows = compare(model, osim)
    for line in osim_words(rows):
        console.line(line)
    for row in rows:
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    console.line()
    console.out.print(table)


def compare_motions(result: Path, osim: Path, console: Console) -> None:
    """Coordinates and moments of an OpenSim model in the recordings of a result, by OpenSim, beside ours."""
    with console.working() as step:
        step("inverse kinematics and dynamics in OpenSim")
        trials = our_trials(result)
        found = compare_motion(load_result_model(result)[0], osim, trials)
    table = frameless_table(("coordinate", "unit"), ("ours, range", "offset", "rest, RMS", "correlation"))
    for curve in found.curves:
        numbers = (float(np.ptp(curve.ours)), curve.offset, curve.rest)
        r = "" if np.isnan(curve.correlation) else f"{curve.correlation:.3f}"
        table.add_row(Text(curve.coordinate), curve.unit, *(f"{v:.1f}" for v in numbers), r)
    console.line()
    console.line(f"in {', '.join(t.name for t in trials)}, by OpenSim; theirs - ours = offset + rest:")
    console.out.print(table)
    ours, theirs = (f"{1e3 * missed:.1f}" for missed in found.missed)
    console.line(f"markers are missed by {ours} mm RMS in our model, by {theirs} in theirs")
    for note in found.notes:
        console.line(f"note: {note}")
