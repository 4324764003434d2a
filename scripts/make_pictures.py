"""The pictures of the documentation: places of a result's page as a headless browser shows them.

    python scripts/make_pictures.py [--result DIR] [--out docs/pictures] [--only page-trust]

Without `--result` the demo's person is calibrated first. The same result and browser give the same pictures.
"""

from __future__ import annotations

import argparse
import base64
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.page.browser import Page, browser, chromium  # noqa: E402

SETTLED = "new Promise(done => setTimeout(done, 2500))"
"""The body is drawn and the curves are laid out by then."""
BOX = "(() => {{ const b = {element}.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; }})()"
HEADED = "[...document.querySelectorAll('#sections h2, #sections h3, #sections h4')].find(h => h.textContent.startsWith"


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One picture."""

    name: str
    place: str
    """What stands behind the # of the page's address."""
    size: tuple[int, int] = (1280, 800)
    element: str = ""
    """JavaScript of the element that is cut out; the whole window unless given."""
    wide: int = 0
    """px that are kept of the element, where it is wider."""
    tall: int = 0
    """px below its upper edge, where more than the element is meant."""


PICTURES = (
    Picture(name="page-clinician", place="preset=clinician&trial=gait&t=0.45"),
    Picture(name="page-joints", place="preset=joints&trial=gait&t=0.45"),
    Picture(name="page-trust", place="preset=trust&trial=gait&t=0.45"),
    Picture(
        name="model",
        place="preset=joints&trial=gait&t=0.45",
        element="document.querySelector('#body-pane')",
        size=(1280, 900),
    ),
    Picture(
        name="joint",
        place="preset=joints&trial=gait&t=0.3&joint=knee_r",
        element="document.querySelector('#body-pane')",
    ),
    Picture(
        name="error-sources",
        place="preset=trust&trial=gait&t=0.45",
        size=(1280, 2600),
        element=f"{HEADED}('What makes the error bar'))",
        tall=475,
    ),
    Picture(name="page-phone", place="preset=clinician&trial=gait&t=0.45", size=(390, 844)),
)


def take(page: Page, url: str, picture: Picture) -> bytes:
    """One picture as PNG."""
    page.open("about:blank")
    page.open(f"{url}#{picture.place}", *picture.size)
    page.run(SETTLED)
    clip: dict[str, Any] = {}
    if picture.element:
        x, y, width, height = page.run(BOX.format(element=picture.element))
        width, height = picture.wide or width, picture.tall or height
        clip = {"clip": {"x": x, "y": y, "width": width, "height": height, "scale": 1}}
    return base64.b64decode(page.send("Page.captureScreenshot", format="png", **clip)["data"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--result", type=Path, help="folder of 'gaitcal demo', its part 'result'")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures")
    parser.add_argument("--only", action="append", help="name of a picture; repeatable")
    chosen = parser.parse_args(arguments)
    binary = chromium()
    if binary is None:
        parser.error("no Chromium on the path")
    with tempfile.TemporaryDirectory() as temporary:
        result = chosen.result
        if result is None:
            command = [sys.executable, "-m", "gaitcal.cli", "demo", "--quiet", "--out", f"{temporary}/demo"]
            subprocess.run(command, check=True, cwd=ROOT)
            result = Path(temporary) / "demo" / "result"
        chosen.out.mkdir(parents=True, exist_ok=True)
        url = (result / "result.html").resolve().as_uri()
        with browser(Path(temporary) / "profile", binary) as page:
            for picture in PICTURES:
                if chosen.only and picture.name not in chosen.only:
                    continue
                content = take(page, url, picture)
                (chosen.out / f"{picture.name}.png").write_bytes(content)
                print(f"{picture.name}.png: {len(content) // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
