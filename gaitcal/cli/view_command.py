"""`gaitcal view`, and `gaitcal report`, the same on paper.

`gaitcal compare`: two sessions of one person, or an OpenSim model beside ours.

The page is served on the loopback interface only. MeshCat's own server listens on all interfaces.
Ours serves a single page from memory, to requests that name this machine (a page elsewhere that
points its own name at 127.0.0.1 gets nothing) and the token in its address (nor does another user
of this machine), and nothing else.
"""

import os
import re
import secrets
import sys
import threading
import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, frameless_table
from gaitcal.errors import Code, InputError, UsageError, note_of
from gaitcal.export.opensim import motion_comparison
from gaitcal.export.opensim.model_comparison import compare_with_osim, describe_osim_differences
from gaitcal.gait import moments, normal_bands
from gaitcal.io.atomic import write_text_atomically
from gaitcal.io.result_folder import MANIFEST, ResultKind, check_output_folder, write_file_in_place
from gaitcal.report.page import bone_files, page_folder, page_html
from gaitcal.report.session_report import (
    build_comparison_content,
    compare_results,
    render_comparison_html,
    write_comparison,
)
from gaitcal.results import saved_result, session_comparison, session_difference
from gaitcal.results.opensim_motions import load_compared_trials

HOST: Final = "127.0.0.1"
_THIS_MACHINE: Final = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.ASCII)


class ViewServer(ThreadingHTTPServer):
    """One page on 127.0.0.1, at an address that nobody can guess."""

    daemon_threads = True

    def __init__(self, html: str, port: int = 0) -> None:
        self.page = html.encode("utf-8")
        self.path = f"/{secrets.token_urlsafe()}/"
        in_page = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
        self.policy = (
            f"{in_page.group(1)}; frame-ancestors 'none'" if in_page else "default-src 'none'"
        )
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            message = f"found {port}, which cannot be listened on ({error})"
            raise InputError(message, field="port", code=Code.OPTION) from error

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_port}{self.path}"


class _Handler(BaseHTTPRequestHandler):
    server: ViewServer
    server_version = "gaitcal"
    sys_version = ""
    timeout = 30

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def _answer(self, *, with_body: bool) -> None:
        # Any port: the far end of a tunnel may have another one than we listen on.
        if not _THIS_MACHINE.fullmatch(self.headers.get("Host", "")):
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            return
        if self.path == "/favicon.ico":
            self.send_response(HTTPStatus.NO_CONTENT)
            self.end_headers()
            return
        if not secrets.compare_digest(self.path.encode(), self.server.path.encode()):
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        for name, value in {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Length": str(len(self.server.page)),
            "Content-Security-Policy": self.server.policy,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }.items():
            self.send_header(name, value)
        self.end_headers()
        if with_body:
            self.wfile.write(self.server.page)

    def log_message(self, format: str, *args: Any) -> None:
        """Silent: the terminal belongs to the command."""


def serve(
    html: str,
    port: int = 0,
    open_browser: bool = True,
    *,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Show a page in the browser until Ctrl-C.

    Parameters
    ----------
    port : on 127.0.0.1; 0: any free one.
    ready : called with the address, token and all, once it answers.

    Raises InputError: The port cannot be listened on.
    """
    try:
        with ViewServer(html, port) as server:
            if ready is not None:
                ready(server.url)
            if open_browser and _has_display():
                # From a thread: some browsers keep this call until they are closed.
                threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
            server.serve_forever(poll_interval=0.2)
    except KeyboardInterrupt:
        pass


def _has_display() -> bool:
    """Without one, a browser for text terminals would be opened, in this very terminal."""
    return sys.platform != "linux" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


REPORT, COMMENTS = "report.pdf", "comments.toml"


def view_result(
    console: Console,
    result: options.Result,
    other: options.Other = None,
    html: options.Html = None,
    geometry: options.Geometry = None,
) -> None:
    """Show the page of a result in the browser, or write it; with another one, that of their
    comparison.

    `geometry`: bones of this folder, else the installed ones.
    """
    if other is None:
        bones = None if geometry is None else bone_files.read_bone_folder(geometry)
        shown, lines = page_folder.read_result_page(result)
        for line in (*lines, *page_html.list_omissions(shown)):
            console.line(line)
        page = page_html.render_page(shown, bones)
    else:
        if geometry is not None:
            raise UsageError(
                "found two results, whose page has no bones; allowed: with one result",
                field="--geometry",
            )
        page = render_comparison_html(compare_results(result, other), (result, other))
    if html is not None:
        with write_file_in_place(html) as path:
            write_text_atomically(path, page)
        console.line(f"wrote {html}")
        return
    serve(page, ready=lambda url: console.line(f"{url}  (Ctrl-C ends)"))


def print_report(
    console: Console,
    result: options.Result,
    other: options.Other = None,
    pdf: options.Pdf = None,
    comments: options.Comments = None,
    normal: options.Normal = None,
) -> None:
    """Write the report of a result, or of two sessions, as a PDF, with the comments that somebody
    wrote for it.
    """
    from gaitcal.report.figures.document import ComparisonContent, ReportContent, write_pdf
    from gaitcal.report.gait_report import read_comments, read_report_content

    if other is not None and pdf is None:
        raise UsageError("found two results; needed: --pdf FILE", field="--pdf")
    if other is not None and normal is not None:
        message = "found two results, each held against its own norm; allowed: with one result"
        raise UsageError(message, field="--normal")
    beside = result / COMMENTS
    file = comments or (beside if other is None and beside.is_file() else None)
    said = {} if file is None else read_comments(file)
    content: ReportContent | ComparisonContent
    if other is None:
        named = None if normal is None else (normal_bands.read_normal_bands(normal), normal.name)
        content = read_report_content(result, named, said)
    else:
        content = build_comparison_content(compare_results(result, other), (result, other), said)
    target = pdf or result / REPORT
    with write_file_in_place(target) as path:
        pages = write_pdf(content, path)
    console.line(
        f"wrote {target}: {moments.format_count(pages, 'page')}"
        + (f", comments of {file}" if file else "")
    )


SHOWN = 30  # Rows of the table on the screen; the file has all
WIDTH = 40  # Characters of a figure's name, at least


def compare_sessions_or_models(
    console: Console,
    result: options.Result,
    other: options.OtherResult = None,
    osim: Annotated[
        Path | None, typer.Option(help="An OpenSim model of the same person, instead of OTHER.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the tables; nothing is written unless given.")
    ] = None,
    motion: Annotated[
        bool,
        typer.Option(
            help="With --osim: its coordinates and moments in the recordings, by OpenSim, too."
        ),
    ] = False,
) -> None:
    """Compare two results, or one with an OpenSim model."""
    if osim is not None and (other is not None or out is not None):
        message = "found a second result or --out beside it; allowed: one result and --osim FILE"
        raise UsageError(message, field="--osim")
    if motion and osim is None:
        raise UsageError("found without --osim, whose model it is for", field="--motion")
    if osim is not None:
        compare_models(result, osim, console)
        if motion:
            compare_motions(result, osim, console)
        return
    if other is None:
        raise UsageError(
            "found one result; allowed: two results, or one and --osim FILE", field="compare"
        )
    if out is not None:
        check_output_folder(
            out, ResultKind.COMPARISON, [folder / MANIFEST for folder in (result, other)]
        )
    comparison = compare_results(result, other)
    tell(comparison, console)
    if out is not None:
        write_comparison(comparison, out, (result, other))
        console.line(f"wrote {out}")


def tell(comparison: session_comparison.SessionComparison, console: Console) -> None:
    """Warnings and words first, then the table of what differs most."""
    for line in comparison.lines:
        console.line(line)
    if not comparison.found:
        return
    table = frameless_table(
        ("figure", "unit"), (*comparison.names, "difference", "missed below", "times")
    )
    table.columns[0].min_width = WIDTH
    for d in comparison.found[:SHOWN]:
        table.add_row(
            Text(session_difference.name_figure(d)), d.unit, *session_difference.format_numbers(d)
        )
    console.line()
    console.out.print(table)
    if (rest := len(comparison.found) - SHOWN) > 0:
        console.line(f"and {rest} more: --out FOLDER writes all")


def compare_models(result: Path, osim: Path, console: Console) -> None:
    """Say in words what an OpenSim model differs in, then print its joint axes, masses and lengths
    beside ours.
    """
    table = frameless_table(("quantity", "unit"), ("ours", "theirs", "difference"))
    model, read, doubts = saved_result.load_result_model(result)
    for text in (*read.remarks, *map(note_of, doubts)):
        console.line(f"warning: {text}")
    rows = compare_with_osim(model, osim)
    for line in describe_osim_differences(rows):
        console.line(line)
    for row in rows:
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    console.line()
    console.out.print(table)


def compare_motions(result: Path, osim: Path, console: Console) -> None:
    """Coordinates and moments of an OpenSim model in the recordings of a result, by OpenSim, beside
    ours.
    """
    with console.working() as step:
        step("inverse kinematics and dynamics in OpenSim")
        trials = load_compared_trials(result)
        found = motion_comparison.compare_motion(
            saved_result.load_result_model(result)[0], osim, trials
        )
    table = frameless_table(
        ("coordinate", "unit"), ("ours, range", "offset", "rest, RMS", "correlation")
    )
    for curve in found.curves:
        numbers = (float(np.ptp(curve.ours)), curve.offset, curve.residual)
        r = "" if np.isnan(curve.correlation) else f"{curve.correlation:.3f}"
        table.add_row(Text(curve.coordinate), curve.unit, *(f"{v:.1f}" for v in numbers), r)
    console.line()
    console.line(
        f"in {', '.join(t.name for t in trials)}, by OpenSim; theirs - ours = offset + rest:"
    )
    console.out.print(table)
    ours, theirs = (f"{1e3 * missed:.1f}" for missed in found.marker_errors)
    console.line(f"markers are missed by {ours} mm RMS in our model, by {theirs} in theirs")
    for note in found.notes:
        console.line(f"note: {note}")
