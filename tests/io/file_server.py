"""A file server on this machine, with the faults that a real one may have."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Served:
    """What the server has, what it does wrong, and what it was asked for."""

    files: dict[str, bytes]
    status: dict[str, int] = field(default_factory=dict)
    """Path -> HTTP status instead of the file."""
    cut: dict[str, list[int]] = field(default_factory=dict)
    """Path -> bytes after which the answers break off, one after the other; then the whole file."""
    moved: dict[str, str] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    address: str = ""


@contextmanager
def serving(served: Served) -> Iterator[Served]:
    """Serve on a free port of this machine, while inside."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            served.asked.append(self.path)
            served.headers.append(dict(self.headers))
            if target := served.moved.get(self.path):
                self.send_response(302)
                self.send_header("Location", target)
                self.end_headers()
                return
            content = served.files.get(self.path)
            status = served.status.get(self.path, 404 if content is None else 200)
            self.send_response(status)
            if status != 200 or content is None:
                self.end_headers()
                return
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            cuts = served.cut.get(self.path, [])
            self.wfile.write(content[: cuts.pop(0)] if cuts else content)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    served.address = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
