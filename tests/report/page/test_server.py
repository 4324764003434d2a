import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from gaitcal.cli.view_command import ViewServer
from gaitcal.errors import InputError
from gaitcal.report.page.page_html import PageContent, render_page
from gaitcal.report.page.scene import Scene
from gaitcal.report.page.scene_file import save_scene

SERVE = """
import sys
from gaitcal.report.page.scene_file import load_scene
from gaitcal.report.page.page_html import PageContent, render_page
from gaitcal.cli.view_command import serve
serve(render_page(PageContent(load_scene(sys.argv[1]))), open_browser=False, ready=lambda url: print(url, flush=True))
print("ended", flush=True)
"""


@pytest.fixture(scope="module")
def server(scene: Scene) -> Iterator[ViewServer]:
    with ViewServer(render_page(PageContent(scene))) as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.05,))
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def ask(
    server: ViewServer, method: str, path: str, host: str | None = None
) -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    try:
        connection.request(method, path, headers={"Host": host} if host else {})
        answer = connection.getresponse()
        return answer, answer.read()
    finally:
        connection.close()


def test_it_listens_on_the_loopback_interface_only(server: ViewServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing; tells which own address would
            own = probe.getsockname()[0]
        except OSError:
            pytest.skip("this machine has no other interface")
    with pytest.raises(OSError):
        socket.create_connection((own, server.server_port), timeout=60)


def test_the_page_comes_with_its_policy(server: ViewServer) -> None:
    answer, body = ask(server, "GET", server.path)
    assert answer.status == 200 and body == server.page
    policy = answer.headers["Content-Security-Policy"]
    assert (
        policy.startswith("default-src 'none'; script-src 'sha256-")
        and "frame-ancestors 'none'" in policy
    )
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    answer, body = ask(server, "HEAD", server.path)
    assert (
        answer.status == 200
        and body == b""
        and int(answer.headers["Content-Length"]) == len(server.page)
    )


ELSEWHERE = (
    "/", "", "/scene.npz", "/../../etc/passwd", "/%2e%2e/", "/static/", "/?x", "/index.html",
    "/view.html", "/%C3%A9",
)  # fmt: skip


@pytest.mark.parametrize(
    ("method", "path", "host", "status"),
    [
        *(("GET", path, None, 404) for path in ELSEWHERE),
        *(("GET", f"/TOKEN{path}", None, 404) for path in ELSEWHERE if path != "/"),
        *(
            ("GET", path, None, 404)
            for path in ("/WRONG/", "/TOKENx/", "/tOKEN/", "/x/../TOKEN/", "/?TOKEN")
        ),
        *(
            ("GET", "/TOKEN/", host, 421)
            for host in ("evil.example", "evil.example:80", "localhost.evil.example")
        ),
        *(("GET", "/TOKEN/", host, 421) for host in ("127.0.0.1:x", "127.0.0.1.evil.example:80")),
        # the far end of a tunnel
        *(("GET", "/TOKEN/", host, 200) for host in ("localhost:9000", "127.0.0.1", "[::1]:8080")),
        *((method, "/TOKEN/", None, 501) for method in ("POST", "PUT", "DELETE", "OPTIONS")),
    ],
)
def test_only_the_address_with_the_token_on_this_machine_gives_the_page(
    method: str, path: str, host: str | None, status: int, server: ViewServer
) -> None:
    token = server.path.strip("/")
    other = token[:-1] + ("A" if token[-1] != "A" else "B")
    for word, real in (("TOKEN", token), ("WRONG", other), ("tOKEN", token.swapcase())):
        path = path.replace(word, real)
    answer, body = ask(server, method, path, host)
    assert (
        answer.status == status and (len(body) < 1000) == (status != 200) and b"root:" not in body
    )


def test_the_token_is_long_and_another_each_time(server: ViewServer) -> None:
    assert len(server.path.strip("/")) > 40 and server.url.endswith(server.path)
    with ViewServer("") as other:
        assert other.path != server.path


def test_a_port_that_cannot_be_or_is_in_use(server: ViewServer) -> None:
    for port in (-1, 70_000, server.server_port):
        with pytest.raises(InputError, match="port"):
            ViewServer("", port)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to send")
def test_ctrl_c_ends_it_cleanly(scene: Scene, tmp_path: Path) -> None:
    save_scene(scene, tmp_path / "scene.npz")
    process = subprocess.Popen(
        [sys.executable, "-c", SERVE, str(tmp_path / "scene.npz")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    try:
        assert re.fullmatch(rb"http://127\.0\.0\.1:\d+/[\w-]{43}/\n", process.stdout.readline())
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
    assert (process.returncode, out, err) == (0, b"ended\n", b"")
