"""Commands `view`, `report` and `compare`.

The page of a result is served from memory on the loopback interface only (MeshCat's server listens
on all interfaces). The server answers requests that

- name this machine in their Host header: a web page whose name resolves to 127.0.0.1 gets nothing;
- have the token of the address: other users of this machine get nothing.
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
from gaitcal.cli.console import Console, make_frameless_table
from gaitcal.errors import Code, InputError, UsageError, format_note
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
    """Server of one page on 127.0.0.1, at an address with a random token.

    Parameters
    ----------
    html
        The page.
    port
        Port; 0: any free one.

    Raises
    ------
    InputError
        The port cannot be used.
    """

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
            message = f"found {port}, which cannot be used ({error})"
            raise InputError(message, field="port", code=Code.OPTION) from error

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{HOST}:{self.server_port}{self.path}"


class _Handler(BaseHTTPRequestHandler):
    """Answers to GET and HEAD requests for the page."""

    server: ViewServer
    server_version = "gaitcal"
    sys_version = ""
    timeout = 30

    def do_GET(self) -> None:
        """Send the page."""
        self._send_page(with_body=True)

    def do_HEAD(self) -> None:
        """Send the headers of the page."""
        self._send_page(with_body=False)

    def _send_page(self, *, with_body: bool) -> None:
        """Send the page if host and token are right, else an error."""
        # Any port is accepted: the other end of a tunnel may have another one.
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
        """Log nothing: the terminal shows the output of the command."""


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
    html
        The page.
    port
        Port on 127.0.0.1; 0: any free one.
    open_browser
        Open the browser, if there is a display.
    ready
        Called with the address when the server answers.

    Raises
    ------
    InputError
        The port cannot be used.
    """
    try:
        with ViewServer(html, port) as server:
            if ready is not None:
                ready(server.url)
            if open_browser and _has_display():
                # In a thread: with some browsers this call returns when they are closed.
                threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
            server.serve_forever(poll_interval=0.2)
    except KeyboardInterrupt:
        pass


def _has_display() -> bool:
    """Whether there is a display; without one, a text browser would open in this terminal."""
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
    """Show or write the page of a result, or of the comparison of two results.

    Parameters
    ----------
    html
        File to write instead of showing the page.
    geometry
        Folder of bone surfaces; the installed ones unless given.

    Raises
    ------
    UsageError
        Bones are given for a comparison.
    InputError
        A result or the bones cannot be read.
    """
    if other is None:
        bones = None if geometry is None else bone_files.read_bone_folder(geometry)
        shown, lines = page_folder.read_result_page(result)
        for line in (*lines, *page_html.list_omissions(shown)):
            console.print_line(line)
        page = page_html.render_page(shown, bones)
    else:
        if geometry is not None:
            raise UsageError(
                "found with two results, whose page has no bones; allowed: with one result",
                field="--geometry",
            )
        page = render_comparison_html(compare_results(result, other), (result, other))
    if html is not None:
        with write_file_in_place(html) as path:
            write_text_atomically(path, page)
        console.print_line(f"wrote {html}")
        return
    serve(page, ready=lambda url: console.print_line(f"{url}  (Ctrl-C ends)"))


def print_report(
    console: Console,
    result: options.Result,
    other: options.Other = None,
    pdf: options.Pdf = None,
    comments: options.Comments = None,
    normal: options.Normal = None,
) -> None:
    """Write the PDF report of a result or of two sessions, with its comments.

    Raises
    ------
    UsageError
        Options do not apply to two results.
    InputError
        A result, the comments or the normal bands cannot be read.
    """
    from gaitcal.report.figures.document import ComparisonContent, ReportContent, write_pdf
    from gaitcal.report.gait_report import read_comments, read_report_content

    if other is not None and pdf is None:
        raise UsageError("found two results; needed: --pdf FILE", field="--pdf")
    if other is not None and normal is not None:
        message = (
            "found with two results, each with the norm of its result; allowed: with one result"
        )
        raise UsageError(message, field="--normal")
    default_file = result / COMMENTS
    # Comments beside a result are of that result, not of a comparison.
    file = comments or (default_file if other is None and default_file.is_file() else None)
    texts = {} if file is None else read_comments(file)
    content: ReportContent | ComparisonContent
    if other is None:
        bands = None if normal is None else (normal_bands.read_normal_bands(normal), normal.name)
        content = read_report_content(result, bands, texts)
    else:
        content = build_comparison_content(compare_results(result, other), (result, other), texts)
    target = pdf or result / REPORT
    with write_file_in_place(target) as path:
        pages = write_pdf(content, path)
    console.print_line(
        f"wrote {target}: {moments.format_count(pages, 'page')}"
        + (f", comments of {file}" if file else "")
    )


MAX_PRINTED_ROWS = 30
"""Rows of the printed table; the file has all."""
MIN_NAME_WIDTH = 40
"""Minimal width (characters) of the column of names."""


def compare_sessions_or_models(
    console: Console,
    result: options.Result,
    other: options.OtherResult = None,
    osim: Annotated[
        Path | None, typer.Option(help="OpenSim model of the same person, instead of OTHER.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the tables. Default: none is written.")
    ] = None,
    motion: Annotated[
        bool,
        typer.Option(
            help="With --osim: also compare coordinates and moments, computed by OpenSim."
        ),
    ] = False,
) -> None:
    """Compare two results, or a result with an OpenSim model.

    Raises
    ------
    UsageError
        Options exclude each other.
    InputError
        A result or the model cannot be read, or the results are not of one person.
    """
    if osim is not None and (other is not None or out is not None):
        message = "found with a second result or --out; allowed: with one result"
        raise UsageError(message, field="--osim")
    if motion and osim is None:
        raise UsageError("found without --osim; allowed: with --osim", field="--motion")
    if osim is not None:
        _compare_models(result, osim, console)
        if motion:
            _compare_motions(result, osim, console)
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
    _print_comparison(comparison, console)
    if out is not None:
        write_comparison(comparison, out, (result, other))
        console.print_line(f"wrote {out}")


def _print_comparison(comparison: session_comparison.SessionComparison, console: Console) -> None:
    """Print warnings and summary, then a table of the largest differences."""
    for line in comparison.lines:
        console.print_line(line)
    if not comparison.found:
        return
    table = make_frameless_table(
        ("figure", "unit"), (*comparison.names, "difference", "missed below", "times")
    )
    table.columns[0].min_width = MIN_NAME_WIDTH
    for d in comparison.found[:MAX_PRINTED_ROWS]:
        table.add_row(
            Text(session_difference.name_figure(d)), d.unit, *session_difference.format_numbers(d)
        )
    console.print_line()
    console.out.print(table)
    remaining = len(comparison.found) - MAX_PRINTED_ROWS
    if remaining > 0:
        console.print_line(f"and {remaining} more: --out FOLDER writes all")


def _compare_models(result: Path, osim: Path, console: Console) -> None:
    """Print how an OpenSim model differs from the result: joint axes, masses and lengths.

    Raises InputError: the result or the model cannot be read.
    """
    table = make_frameless_table(("quantity", "unit"), ("ours", "theirs", "difference"))
    model, read, doubts = saved_result.load_result_model(result)
    for text in (*read.remarks, *map(format_note, doubts)):
        console.print_line(f"warning: {text}")
    rows = compare_with_osim(model, osim)
    for line in describe_osim_differences(rows):
        console.print_line(line)
    for row in rows:
        numbers = (f"{v:.2f}" for v in (row.ours, row.theirs, row.difference))
        table.add_row(Text(row.quantity), Text(row.unit), *numbers)
    console.print_line()
    console.out.print(table)


def _compare_motions(result: Path, osim: Path, console: Console) -> None:
    """Print how coordinates and moments of an OpenSim model, computed by OpenSim, differ from ours.

    Raises InputError: the result or the model cannot be read, or OpenSim is not installed.
    """
    with console.show_progress() as step:
        step("inverse kinematics and dynamics in OpenSim")
        trials = load_compared_trials(result)
        found = motion_comparison.compare_motion(
            saved_result.load_result_model(result)[0], osim, trials
        )
    table = make_frameless_table(
        ("coordinate", "unit"), ("our range", "offset", "rest, RMS", "correlation")
    )
    for curve in found.curves:
        numbers = (float(np.ptp(curve.ours)), curve.offset, curve.residual)
        r = "" if np.isnan(curve.correlation) else f"{curve.correlation:.3f}"
        table.add_row(Text(curve.coordinate), curve.unit, *(f"{v:.1f}" for v in numbers), r)
    console.print_line()
    console.print_line(
        f"in {', '.join(t.name for t in trials)}, by OpenSim; theirs - ours = offset + rest:"
    )
    console.out.print(table)
    ours, theirs = (f"{1e3 * missed:.1f}" for missed in found.marker_errors)
    console.print_line(f"marker error, RMS: {ours} mm in our model, {theirs} mm in theirs")
    for note in found.notes:
        console.print_line(f"note: {note}")
