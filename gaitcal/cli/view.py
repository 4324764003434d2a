"""`gaitcal view`, and `gaitcal report`, the same on paper."""

from __future__ import annotations

from pathlib import Path

from gaitcal.cli.console import Console
from gaitcal.errors import UsageError
from gaitcal.gait.moments import counted
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.atomic import atomic_text
from gaitcal.io.result_folder import file_in_place
from gaitcal.page.bone_files import bones_of_folder
from gaitcal.page.server import serve
from gaitcal.page.view import page_html, sentences
from gaitcal.results.calibration import result_page

REPORT, COMMENTS = "report.pdf", "comments.toml"


def view_result(
    result: Path, other: Path | None, html: Path | None, console: Console, geometry: Path | None = None
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
        from gaitcal.results.sessions import compare_results, comparison_html

        page = comparison_html(compare_results(result, other), (result, other))
    if html is not None:
        with file_in_place(html) as path:
            atomic_text(path, page)
        console.line(f"wrote {html}")
        return
    serve(page, ready=lambda url: console.line(f"{url}  (Ctrl-C ends)"))


def print_report(
    result: Path, other: Path | None, pdf: Path | None, comments: Path | None, normal: Path | None, console: Console
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
        from gaitcal.results.sessions import compare_results, comparison_content

        content = comparison_content(compare_results(result, other), (result, other), said)
    target = pdf or result / REPORT
    with file_in_place(target) as path:
        pages = write_pdf(content, path)
    console.line(f"wrote {target}: {counted(pages, 'page')}" + (f", comments of {file}" if file else ""))
