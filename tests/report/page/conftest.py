"""Scenes and a browser, made once for all tests of the viewer."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gaitcal.report.page.bone_files import BoneMeshes, read_bone_folder
from gaitcal.report.page.scene import Scene
from tests.report.page.browser import Page, Visit, browser, chromium
from tests.report.page.made_bones import folder_of_bones
from tests.report.page.made_page import everything_page, plain_data, written_page
from tests.report.page.people import walking_scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    return walking_scene()


@pytest.fixture(scope="session")
def bones(tmp_path_factory: pytest.TempPathFactory) -> BoneMeshes:
    return read_bone_folder(folder_of_bones(tmp_path_factory.mktemp("bones") / "Geometry"))


@pytest.fixture(scope="session")
def html(scene: Scene, bones: BoneMeshes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a scene alone."""
    return written_page(tmp_path_factory.mktemp("scene"), scene, bones=bones)


@pytest.fixture(scope="session")
def shown(scene: Scene, bones: BoneMeshes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain page of a result."""
    return written_page(tmp_path_factory.mktemp("plain"), scene, plain_data(scene), bones)


@pytest.fixture(scope="session")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with blocks of every kind."""
    path = tmp_path_factory.mktemp("everything") / "result.html"
    path.write_text(everything_page(), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def _browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    binary = chromium()
    if binary is None:
        reason = "no Chromium on this machine (its path may stand in CHROMIUM)"
        if os.environ.get("CI"):
            pytest.fail(f"{reason}; with CI set it must be there", pytrace=False)
        pytest.skip(reason)
    with browser(tmp_path_factory.mktemp("profile"), binary) as page:
        yield page


CHOSEN = (
    "result", "trial", "speed", "window", "preset", "axis", "unit", "signs", "acting", "nominal",
    "norm", "errors", "truth", "spread", "off", "joint", "second", "layers",
)  # fmt: skip
"""What a visitor chooses on a page."""
AT_OPENING = f"""if (window.gaitcal?.stage)
    window.atOpening = Object.fromEntries({list(CHOSEN)}.map(field => [field, gaitcal.state[field]]))"""
RESET = (
    "scrollTo(0, 0); gaitcal.state.set({ ...window.atOpening, seconds: 0, playing: false }); true"
)


@pytest.fixture(scope="module")
def _left_blank(_browser: Page) -> Iterator[None]:
    """No page draws on while other modules' tests run: a picture in software takes a third of a
    core.
    """
    yield
    _browser.run("location.href = 'about:blank'; true")
    _browser.shown = ()


@pytest.fixture
def visit(_browser: Page, _left_blank: None) -> Iterator[Visit]:
    """Open a page; every console message, exception and request since is kept in it.

    A page that is open already in this size is not loaded again unless `fresh`: what is chosen
    there is as it was when it opened. Nothing plays on after a test: a walk that does would take a
    whole core from all later tests.
    """

    def open_page(
        where: Path | str,
        width: int = 900,
        height: int = 620,
        phone: bool = False,
        fresh: bool = False,
    ) -> Page:
        url = where.as_uri() if isinstance(where, Path) else where
        _browser.console.clear()
        _browser.requests.clear()
        known = _browser.shown == (url, width, height, phone) and _browser.run(
            "window.atOpening !== undefined"
        )
        if fresh or not known:
            _browser.open(url, width, height, phone)
            _browser.run(AT_OPENING)
        else:
            _browser.run(RESET)
            _browser.console.clear()
        return _browser

    yield open_page
    _browser.run("if (window.gaitcal?.stage) gaitcal.state.set({ playing: false })")


@pytest.fixture
def media(_browser: Page) -> Iterator[Callable[..., None]]:
    """Media features of the browser (`prefers_color_scheme="dark"`), as they were again
    afterwards.
    """

    def put(**features: str) -> None:
        named = [
            {"name": name.replace("_", "-"), "value": value} for name, value in features.items()
        ]
        _browser.send("Emulation.setEmulatedMedia", features=named)

    yield put
    put()
