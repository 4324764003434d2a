"""Write and read the files of a page in a result folder, joined with those of further trials."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gaitcal.errors import Code, InputError
from gaitcal.io import snapshot
from gaitcal.io.result_folder import compute_sha256
from gaitcal.report.page.page_data import PAGE_DATA, read_page_data, write_page_data
from gaitcal.report.page.page_html import (
    Shown,
    doubted,
    followed_by,
    only,
    page_html,
    renamed,
    with_trials,
)
from gaitcal.report.page.scene import Scene
from gaitcal.report.page.scene_file import load_scene, save_scene
from gaitcal.results import saved_result
from gaitcal.results.saved_result import AGAIN, DYNAMICS, OTHER_MODEL, other_model

PAGE: Final = "result.html"
SCENE: Final = "scene.npz"


def write_page(folder: Path, scene: Scene, page_data: Mapping[str, Any]) -> None:
    """Write scene, data and page into a folder that is being written."""
    save_scene(scene, folder / SCENE)
    rewrite_page(folder, scene, page_data)


def rewrite_page(folder: Path, scene: Scene, page_data: Mapping[str, Any]) -> None:
    """Write the page with another page_data; the scene is there already."""
    write_page_data(page_data, folder / PAGE_DATA)
    (folder / PAGE).write_text(page_html(Shown(scene, page_data)), encoding="utf-8", newline="")


def read_page(folder: Path) -> Shown:
    """What a folder's page is made of.

    Raises InputError: It holds no page, or one that is damaged.
    """

    def read() -> Shown:
        page_data = read_page_data(folder / PAGE_DATA)
        shown = Shown(load_scene(folder / SCENE), page_data)
        if [t["name"] for t in page_data["trials"]] != [t.name for t in shown.scene.trials]:
            message = "tells of other trials than scene.npz; calibrate again"
            raise InputError(message, source=folder / PAGE_DATA, code=Code.DAMAGED_RESULT)
        return shown

    shown, _ = snapshot.read_whole(folder, (SCENE, PAGE_DATA), read)
    return shown


def result_page(folder: Path) -> tuple[Shown, tuple[str, ...]]:
    """A result with the further trials that `gaitcal dynamics` added, and lines on those that are
    stale or left out.

    Raises InputError: As of `read_page`; what is wrong with the further trials is such a line.
    """
    shown = read_page(folder)
    if not (folder / DYNAMICS).is_dir():
        return shown, ()
    try:
        further = read_page(folder / DYNAMICS)
    except InputError:
        return shown, (
            f"{folder / DYNAMICS}: its page is missing or damaged; run its trials again to see "
            "them",
        )
    stale = other_model(
        folder / DYNAMICS,
        [t.name for t in further.scene.trials],
        compute_sha256(folder / saved_result.MODEL),
    )
    lines = tuple(f"{name}: {OTHER_MODEL}; {AGAIN}" for name in stale)
    taken = {trial.name for trial in shown.scene.trials}
    names = {t.name: f"{t.name} ({DYNAMICS})" for t in further.scene.trials if t.name in taken}
    scene = with_trials(shown.scene, further.scene, names)
    if scene is None:
        return shown, (
            f"{folder / DYNAMICS}: another body than {folder}; run its trials again to see them",
        )
    about = only(further.data or {}, [t.name for t in further.scene.trials])
    page_data = renamed(doubted(about, [(name, OTHER_MODEL, AGAIN) for name in stale]), names)
    return Shown(scene, followed_by(shown.data or {}, page_data)), lines
