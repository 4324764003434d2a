"""The page in the browser, served on the loopback interface only.

MeshCat's own server listens on all interfaces. Ours serves a single page from memory, to requests that name this
machine (a page elsewhere that points its own name at 127.0.0.1 gets nothing) and the token in its address (nor does
another user of this machine), and nothing else. No other command loads this module and the web server below it.
"""

from __future__ import annotations

import os
import re
import secrets
import sys
import threading
import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

from gaitcal.codes import Code
from gaitcal.errors import InputError

HOST: Final = "127.0.0.1"
_THIS_MACHINE: Final = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.ASCII)


class ViewServer(ThreadingHTTPServer):
    """One page on 127.0.0.1, at an address that nobody can guess."""

    daemon_threads = True

    def __init__(self, html: str, port: int = 0) -> None:
        self.page = html.encode("utf-8")
        self.path = f"/{secrets.token_urlsafe()}/"
        in_page = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
        self.policy = f"{in_page.group(1)}; frame-ancestors 'none'" if in_page else "default-src 'none'"
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"found {port}, which cannot be listened on ({error})", field="port", code=Code.OPTION
            ) from error

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


def serve(html: str, port: int = 0, open_browser: bool = True, *, ready: Callable[[str], None] | None = None) -> None:
    """Show a page in the browser until Ctrl-C.

    Parameters
    ----------
    port : on 127.0.0.1; 0: any free one.
    ready : called with the address, token and all, once it answers.

    Raises
    ------
    InputError
        The port cannot be listened on.
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
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
