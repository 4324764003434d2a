"""The pictures of the documentation: places of a result's page as a headless browser shows them.

    python -m scripts.tools.make_pictures [--result DIR] [--cohort DIR] [--out docs/pictures]
    [--only page-trust]

Without `--result` the demo's person is calibrated first, and without `--cohort` three made-up
people, of whom the picture of a cohort shows sixty copies with noise. The same results and browser
give the same pictures.
"""

from __future__ import annotations

import argparse
import base64
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripts.validation.cohorts import copy_people, write_many
from scripts.validation.harness import gaitcal
from tests.report.page.browser import Page, browser, chromium

ROOT = Path(__file__).resolve().parents[2]

SETTLED = "new Promise(done => setTimeout(done, 2500))"
"""The body is drawn and the curves are laid out by then."""
BOX = (
    "(() => {{ const b = {element}.getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; "
    "}})()"
)
HEADED = (
    "[...document.querySelectorAll('#sections h2, #sections h3, #sections h4')].find(h => "
    "h.textContent.startsWith"
)


COHORT = "page-cohort"
"""The picture of another page than the result's."""
PEOPLE = 60


@dataclass(frozen=True)
class Picture:
    name: str
    place: str
    """What stands behind the # of the page's address."""
    size: tuple[int, int] = (1280, 800)
    element: str = ""
    """JavaScript of the element that is cut out; the whole window unless given."""
    tall: int = 0
    """px below its upper edge, where more than the element is meant."""


BODY = "document.querySelector('#body-pane')"
AT = "&trial=gait&t=0.45"
PICTURES = (
    Picture("page-clinician", f"preset=clinician{AT}", (1440, 900)),
    Picture("page-joints", f"preset=joints{AT}"),
    Picture("page-trust", f"preset=trust{AT}"),
    Picture("model", f"preset=joints{AT}", (1280, 900), BODY),
    Picture("joint", "preset=joints&trial=gait&t=0.3&joint=knee_r", element=BODY),
    Picture(
        "error-sources",
        f"preset=trust{AT}",
        (1280, 2600),
        f"{HEADED}('Expected error of the peak'))",
        tall=475,
    ),
    Picture("page-phone", f"preset=clinician{AT}", (390, 844)),
    Picture(COHORT, "", (1280, 1000)),
)


def take(page: Page, url: str, picture: Picture) -> bytes:
    page.open("about:blank")
    page.open(f"{url}#{picture.place}", *picture.size)
    page.run(SETTLED)
    clip: dict[str, Any] = {}
    if picture.element:
        x, y, width, height = page.run(BOX.format(element=picture.element))
        clip = {
            "clip": {"x": x, "y": y, "width": width, "height": picture.tall or height, "scale": 1}
        }
    return base64.b64decode(page.send("Page.captureScreenshot", format="png", **clip)["data"])


def demo_in(folder: Path) -> Path:
    gaitcal("demo", "--quiet", "--out", folder / "demo").check_returncode()
    return folder / "demo" / "result"


def cohort_in(folder: Path) -> Path:
    for seed in (1, 2, 3):
        gaitcal(
            "synthesize",
            "-q",
            "--out",
            folder / f"people/P{seed}",
            "--seed",
            seed,
            "--noise",
            "--perturb",
        )
    gaitcal("cohort", "--quiet", folder / "people", "--out", folder / "study").check_returncode()
    return folder / "study"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--result", type=Path, help="folder of 'gaitcal demo', its part 'result'")
    parser.add_argument("--cohort", type=Path, help="folder of 'gaitcal cohort'")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures")
    parser.add_argument("--only", action="append", help="name of a picture; repeatable")
    chosen = parser.parse_args(arguments)
    binary = chromium()
    if binary is None:
        parser.error("no Chromium on the path")
    wanted = [picture for picture in PICTURES if not chosen.only or picture.name in chosen.only]
    chosen.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=chosen.cohort) as temporary:
        folder, pages = Path(temporary), {}
        if any(picture.name != COHORT for picture in wanted):
            pages["result"] = (chosen.result or demo_in(folder)) / "result.html"
        if any(picture.name == COHORT for picture in wanted):
            copy_people(chosen.cohort or cohort_in(folder), PEOPLE, folder / "many")
            write_many(folder / "many", PEOPLE)
            pages[COHORT] = folder / "many" / "cohort.html"
        with browser(folder / "profile", binary) as page:
            for picture in wanted:
                url = pages.get(picture.name, pages.get("result", Path())).resolve().as_uri()
                content = take(page, url, picture)
                (chosen.out / f"{picture.name}.png").write_bytes(content)
                print(f"{picture.name}.png: {len(content) // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
