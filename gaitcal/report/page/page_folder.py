"""Write and read the files of a page in a result folder, with the pages of further trials."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gaitcal.errors import Code, InputError
from gaitcal.io import snapshot
from gaitcal.io.result_folder import compute_sha256
from gaitcal.report.page.page_data import PAGE_DATA, read_page_data, write_page_data
from gaitcal.report.page.page_html import (
    PageContent,
    add_doubts,
    append_page_data,
    append_trials,
    rename_trials,
    render_page,
    select_trials,
)
from gaitcal.report.page.scene import Scene
from gaitcal.report.page.scene_file import load_scene, save_scene
from gaitcal.results import saved_result
from gaitcal.results.saved_result import AGAIN, DYNAMICS, OTHER_MODEL, select_stale_trials

PAGE: Final = "result.html"
SCENE: Final = "scene.npz"


def write_page(folder: Path, scene: Scene, page_data: Mapping[str, Any]) -> None:
    """Write scene, page data and page.

    Parameters
    ----------
    folder
        The result folder that is being written.
    scene
        Body in motion.
    page_data
        Curves and tables.
    """
    save_scene(scene, folder / SCENE)
    rewrite_page(folder, scene, page_data)


def rewrite_page(folder: Path, scene: Scene, page_data: Mapping[str, Any]) -> None:
    """Write the page with changed page data; the scene file exists already.

    Parameters
    ----------
    folder
        A result folder.
    scene
        Body in motion.
    page_data
        Curves and tables.
    """
    write_page_data(page_data, folder / PAGE_DATA)
    (folder / PAGE).write_text(
        render_page(PageContent(scene, page_data)), encoding="utf-8", newline=""
    )


def read_page(folder: Path) -> PageContent:
    """Read scene and page data of a folder.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    PageContent
        What the page consists of.

    Raises
    ------
    InputError
        The folder contains no page, or a damaged one.
    """

    def read() -> PageContent:
        page_data = read_page_data(folder / PAGE_DATA)
        shown = PageContent(load_scene(folder / SCENE), page_data)
        if [t["name"] for t in page_data["trials"]] != [t.name for t in shown.scene.trials]:
            message = "has other trials than scene.npz; calibrate again"
            raise InputError(message, source=folder / PAGE_DATA, code=Code.DAMAGED_RESULT)
        return shown

    shown, _ = snapshot.read_whole(folder, (SCENE, PAGE_DATA), read)
    return shown


def read_result_page(folder: Path) -> tuple[PageContent, tuple[str, ...]]:
    """Read the page of a result with the further trials of `gaitcal dynamics`.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    PageContent
        What the page consists of.
    tuple of str
        One line for each further trial that is stale or left out.

    Raises
    ------
    InputError
        As of `read_page`, for the result itself.
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
    stale = select_stale_trials(
        folder / DYNAMICS,
        [t.name for t in further.scene.trials],
        compute_sha256(folder / saved_result.MODEL),
    )
    lines = tuple(f"{name}: {OTHER_MODEL}; {AGAIN}" for name in stale)
    taken = {trial.name for trial in shown.scene.trials}
    names = {t.name: f"{t.name} ({DYNAMICS})" for t in further.scene.trials if t.name in taken}
    scene = append_trials(shown.scene, further.scene, names)
    if scene is None:
        return shown, (
            f"{folder / DYNAMICS}: another body than {folder}; run its trials again to see them",
        )
    about = select_trials(further.data or {}, [t.name for t in further.scene.trials])
    page_data = rename_trials(
        add_doubts(about, [(name, OTHER_MODEL, AGAIN) for name in stale]), names
    )
    return PageContent(scene, append_page_data(shown.data or {}, page_data)), lines
