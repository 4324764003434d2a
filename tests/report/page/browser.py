"""A headless Chromium, driven through its DevTools protocol over two pipes: no driver, no extra
package.
"""

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--no-sandbox",
    "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-extensions", "--disable-background-networking",
    "--mute-audio", "--hide-scrollbars", "--force-device-scale-factor=1",
)  # fmt: skip
TIMEOUT = 90.0
"""s until an answer, or a page whose figure stands: software rendering on a busy machine is slow,
and a hung browser must not hang the tests."""
READY = """document.getElementById('pane') === null || !document.getElementById('failure').hidden
    || window.gaitcal?.stage?.figure !== undefined"""
"""Nothing is to be drawn in space, or cannot be, or the figure stands."""

Visit = Callable[..., "Page"]
"""The fixture `visit` of the tests."""
DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
STEADY = "new Promise(done => setTimeout(() => requestAnimationFrame(() => done(true)), 150))"
"""Curves are drawn when they are seen, and follow what is chosen."""
SETTLED = "new Promise(done => requestAnimationFrame(() => setTimeout(done, 300)))"

# The browser reads commands from descriptor 3 and answers on descriptor 4.
_LAUNCH = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(fd), fcntl.F_DUPFD, 10) for fd in sys.argv[1:3]]
for fd, end in zip((3, 4), ends):
    os.dup2(end, fd)
os.execv(sys.argv[3], sys.argv[3:])
"""


def chromium() -> str | None:
    """The browser on this machine, if there is one."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """One tab. Console messages, exceptions and requests are kept."""

    def __init__(self, to: int, answers: int) -> None:
        self._to, self._answers = to, answers
        self._buffer = b""
        self._count = 0
        self.session: str | None = None
        self.console: list[str] = []
        self.requests: list[str] = []
        self.loaded = False
        self.shown: tuple[object, ...] = ()
        """What is open: address, width, height, whether as on a phone."""

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + TIMEOUT
        while True:
            answer = self._next(deadline)
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])

    def _next(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select(
                [self._answers], [], [], max(0.0, deadline - time.monotonic())
            )
            if not ready:
                raise TimeoutError("the browser does not answer")
            chunk = os.read(self._answers, 1 << 20)
            if not chunk:
                raise RuntimeError("the browser has ended")
            self._buffer += chunk
        text, self._buffer = self._buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        self._note(message.get("method"), message.get("params", {}))
        return message

    def _note(self, method: str | None, params: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled":
            values = [str(a.get("value", a.get("description"))) for a in params["args"]]
            self.console.append(f"{params['type']}: {' '.join(values)}")
        elif method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.console.append(
                f"exception: {details.get('exception', {}).get('description', details['text'])}"
            )
        elif method == "Log.entryAdded":
            self.console.append(f"{params['entry']['level']}: {params['entry']['text']}")
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Page.loadEventFired":
            self.loaded = True

    def open(self, url: str, width: int = 1280, height: int = 800, phone: bool = False) -> None:
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")
        self.send("Network.emulateNetworkConditions", offline=url.startswith("file:"), latency=0,
                  downloadThroughput=-1, uploadThroughput=-1)  # fmt: skip
        self.size(width, height, phone)
        self.loaded = False
        self.send("Page.navigate", url=url)
        deadline = time.monotonic() + TIMEOUT
        while not self.loaded:
            self._next(deadline)
        while not self.run(READY):
            if time.monotonic() > deadline:
                raise TimeoutError(f"no figure after {TIMEOUT:g} s")
            time.sleep(0.02)
        self.shown = (url, width, height, phone)

    def size(self, width: int, height: int, phone: bool = False) -> None:
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=2 if phone else 1,
                  mobile=phone)  # fmt: skip

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression; promises are awaited."""
        out = self.send(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in out:
            raise RuntimeError(out["exceptionDetails"].get("exception", {}).get("description", out))
        return out["result"].get("value")

    def until(self, condition: str) -> None:
        """Wait until the JavaScript condition holds, however slow the machine; in the end it is a
        timeout.
        """
        self.run(
            f"new Promise(done => {{ const look = () => {condition} ? done() : setTimeout(look, "
            f"20); look(); }})"
        )

    def texts(self, selector: str) -> list[str]:
        """What every element says that a CSS selector finds."""
        found = f"[...document.querySelectorAll({json.dumps(selector)})]"
        return list(self.run(f"{found}.map(e => e.textContent.trim())"))

    def click(self, selector: str) -> None:
        self.run(f"document.querySelector({json.dumps(selector)}).click()")

    def box(self, element: str) -> tuple[float, float, float, float]:
        """Left, top, width and height of a JavaScript element, px."""
        left, top, width, height = self.run(
            f"(r => [r.left, r.top, r.width, r.height])({element}.getBoundingClientRect())"
        )
        return left, top, width, height

    def drag(self, start: tuple[float, float], *ways: tuple[float, float]) -> None:
        """With the left button, from place to place; without ways it is a click."""
        kinds = ("mousePressed", *["mouseMoved"] * len(ways), "mouseReleased")
        for kind, (x, y) in zip(kinds, (start, *ways, (start, *ways)[-1]), strict=True):
            self.send(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x,
                y=y,
                button="left",
                buttons=1,
                clickCount=1,
            )

    def picture(self, path: Path | None = None) -> bytes:
        content = base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(content)
        return content

    def press(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.send(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key if key != " " else "Space",
                text="",
            )

    def move(self, x: float, y: float) -> None:
        self.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)


@contextlib.contextmanager
def browser(folder: Path, binary: str) -> Iterator[Page]:
    """A browser with one empty tab; `folder` holds its profile, into which nobody writes any more
    afterwards.
    """
    command_read, command_write = os.pipe()
    answer_read, answer_write = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-c", _LAUNCH, str(command_read), str(answer_write), binary, *FLAGS,
         f"--user-data-dir={folder}", "about:blank"],
        pass_fds=(command_read, answer_write),
        start_new_session=True,  # so that its many processes can be told from others
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(command_read)
    os.close(answer_write)
    try:
        page = Page(command_write, answer_read)
        target = next(
            t for t in page.send("Target.getTargets")["targetInfos"] if t["type"] == "page"
        )
        page.session = page.send(
            "Target.attachToTarget", targetId=target["targetId"], flatten=True
        )["sessionId"]
        yield page
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(15)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(
                process.pid, signal.SIGKILL
            )  # the first of a browser's processes does not wait for the others
        process.wait()
        os.close(command_write)
        os.close(answer_read)
