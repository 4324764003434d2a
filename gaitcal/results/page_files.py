"""The page of a result folder: `result.html`, and what it is made of again, `scene.npz` and `page.json`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.result_folder import MANIFEST, read_object, sha256_of
from gaitcal.io.snapshot import read_whole
from gaitcal.page.page_data import PAGE_DATA, doubted, followed_by, only, read_page_data, renamed, write_page_data
from gaitcal.page.scene import Scene
from gaitcal.page.scene_file import load_scene, save_scene
from gaitcal.page.view import BodyText, Shown, body_texts, data_text, joined_page, with_trials
from gaitcal.results.saved import MODEL
from gaitcal.results.verdict import table_of

PAGE: Final = "result.html"
SCENE: Final = "scene.npz"
DYNAMICS: Final = "dynamics"
"""Folder of a result that `gaitcal dynamics` writes."""
OTHER_MODEL: Final = f"made by an earlier run with another model than {MODEL} now is"
AGAIN: Final = "run it again"


def write_body(folder: Path, scene: Scene) -> BodyText:
    """Write the scene into a folder that is being written; returns what its page has of it."""
    save_scene(scene, folder / SCENE)
    (body,) = body_texts([scene])
    return body


def write_told(folder: Path, sheet: Mapping[str, Any]) -> str:
    """Write the sheet into a folder that is being written; returns what its page has of it."""
    write_page_data(sheet, folder / PAGE_DATA)
    return data_text(sheet)


def write_joined_page(folder: Path, body: BodyText, told: str) -> None:
    """Write the page of what `write_body` and `write_told` have written."""
    (folder / PAGE).write_text(joined_page([("", body, told)]), encoding="utf-8", newline="")


def write_page(folder: Path, scene: Scene, sheet: Mapping[str, Any]) -> None:
    """Write the page and its data into a folder that is being written."""
    write_joined_page(folder, write_body(folder, scene), write_told(folder, sheet))


def rewrite_page(folder: Path, scene: Scene, sheet: Mapping[str, Any]) -> None:
    """Write the page with another sheet; the scene is there already."""
    (body,) = body_texts([scene])
    write_joined_page(folder, body, write_told(folder, sheet))


def read_page(folder: Path) -> Shown:
    """What a folder's page is made of.

    Raises
    ------
    InputError
        It holds no page, or one that is damaged.
    """

    def read() -> Shown:
        sheet = read_page_data(folder / PAGE_DATA)
        shown = Shown(load_scene(folder / SCENE), sheet, folder.resolve().name)
        if [t["name"] for t in sheet["trials"]] != [t.name for t in shown.scene.trials]:
            raise InputError(
                "tells of other trials than scene.npz; calibrate again",
                source=folder / PAGE_DATA,
                code=Code.DAMAGED_RESULT,
            )
        return shown

    shown, _ = read_whole(folder, (SCENE, PAGE_DATA), read)
    return shown


def result_page(folder: Path) -> tuple[Shown, tuple[str, ...]]:
    """A result with the further trials that `gaitcal dynamics` added, and lines on those that are stale or left out.

    Raises
    ------
    InputError
        As of `read_page`; what is wrong with the further trials is such a line.
    """
    shown = read_page(folder)
    if not (folder / DYNAMICS).is_dir():
        return shown, ()
    try:
        further = read_page(folder / DYNAMICS)
    except InputError:
        return shown, (f"{folder / DYNAMICS}: its page is missing or damaged; run its trials again to see them",)
    stale = other_model(folder / DYNAMICS, [t.name for t in further.scene.trials], sha256_of(folder / MODEL))
    lines = tuple(f"{name}: {OTHER_MODEL}; {AGAIN}" for name in stale)
    taken = {trial.name for trial in shown.scene.trials}
    names = {t.name: f"{t.name} ({DYNAMICS})" for t in further.scene.trials if t.name in taken}
    scene = with_trials(shown.scene, further.scene, names)
    if scene is None:
        return shown, (f"{folder / DYNAMICS}: another body than {folder}; run its trials again to see them",)
    about = only(further.data or {}, [t.name for t in further.scene.trials])
    sheet = renamed(doubted(about, [(name, OTHER_MODEL, AGAIN) for name in stale]), names)
    return Shown(scene, followed_by(shown.data or {}, sheet), shown.name), lines


def other_model(folder: Path, trials: list[str], digest: str | None) -> tuple[str, ...]:
    """Those of these trials in a folder of further trials that were made with another model than that of `digest`."""
    digests = table_of(read_object(folder / MANIFEST), "model_sha256")
    return tuple(name for name in trials if digests.get(name) != digest)
