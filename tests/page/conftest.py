"""Scenes and a browser, made once for all tests of the viewer."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gaitcal.page.bone_files import bones_of_folder
from gaitcal.page.scene import Scene
from gaitcal.page.view import write_view
from tests.page.browser import Page, browser, chromium
from tests.page.made_bones import folder_of_bones
from tests.page.people import walking_scene


@pytest.fixture(scope="session")
def scene() -> Scene:
    return walking_scene()


@pytest.fixture(scope="session")
def html(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    write_view(scene, folder / "view.html", bones_of_folder(folder_of_bones(folder / "Geometry")))
    return folder / "view.html"


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


@pytest.fixture
def visit(_browser: Page) -> Iterator[Callable[..., Page]]:
    """Open a page; every console message, exception and request since is kept in it.

    It is left at the end: a walk that goes on playing would take a whole core from all later tests.
    """

    def open_page(where: Path | str, width: int = 900, height: int = 620, phone: bool = False) -> Page:
        _browser.console.clear()
        _browser.requests.clear()
        _browser.open(where.as_uri() if isinstance(where, Path) else where, width, height, phone)
        return _browser

    yield open_page
    _browser.open("about:blank")
