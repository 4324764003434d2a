"""`gaitcal view`, and `gaitcal report`, the same on paper."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gaitcal.cli.console import Console
from gaitcal.gait.moments import counted
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.atomic import atomic_text
from gaitcal.io.result_folder import file_in_place
from gaitcal.page.bone_files import bones_of_folder
from gaitcal.page.server import serve
from gaitcal.page.view import Shown, page_html, sentences
from gaitcal.results.calibration import result_page

REPORT, COMMENTS = "report.pdf", "comments.toml"


def view_results(
    console: Console, result: Path, other: Path | None = None, html: Path | None = None, geometry: Path | None = None
) -> None:
    """Show a result in the browser, or two side by side, or write the page.

    `geometry`: bones of this folder, else the installed ones.
    """
    results = (result,) if other is None else (result, other)
    bones = None if geometry is None else bones_of_folder(geometry)
    shown = [_read(result, console) for result in results]
    named = [replace(part, name=name) for part, name in zip(shown, _names(results), strict=True)]
    for sentence in sentences(named):
        console.line(sentence)
    page = page_html(named, bones)
    if html is not None:
        with file_in_place(html) as path:
            atomic_text(path, page)
        console.line(f"wrote {html}")
        return
    serve(page, ready=lambda url: console.line(f"{url}  (Ctrl-C ends)"))


def _read(result: Path, console: Console) -> Shown:
    shown, lines = result_page(result)
    for line in lines:
        console.line(line)
    return shown


def _names(results: tuple[Path, ...]) -> list[str]:
    """The last parts of their paths, as many as tell them apart."""
    parts = [result.resolve().parts for result in results]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-count:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{'/'.join(part[-1:])} ({k})" for k, part in enumerate(parts, start=1)]


def print_report(
    console: Console, result: Path, pdf: Path | None = None, comments: Path | None = None, normal: Path | None = None
) -> None:
    """Write the report of a result as a PDF, with the comments that somebody wrote for it."""
    from gaitcal.figures.document import write_pdf
    from gaitcal.results.gait_report import read_comments, report_content

    beside = result / COMMENTS
    file = comments or (beside if beside.is_file() else None)
    said = {} if file is None else read_comments(file)
    named = None if normal is None else (read_normal_bands(normal), normal.name)
    content = report_content(result, named, said)
    target = pdf or result / REPORT
    with file_in_place(target) as path:
        pages = write_pdf(content, path)
    console.line(f"wrote {target}: {counted(pages, 'page')}" + (f", comments of {file}" if file else ""))
