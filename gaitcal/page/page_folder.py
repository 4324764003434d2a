"""Write and read the files of a page in a result folder, joined with those of further trials."""

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
import numpy as np
from gaitcal.errors import Code, InputError
from gaitcal.export import osim, other_formats
from gaitcal.gait.normal_bands import Bands, Norm, norm_for, own_norm
from gaitcal.gait.profile_score import profile_scores
from gaitcal.io import opensim_files, snapshot, toml
from gaitcal.io.result_folder import MANIFEST, ResultKind, atomic_directory, read_object, sha256_of
from gaitcal.model import model_file, parameters
from gaitcal.model.marker_set import marker_set_text
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.page_data import PAGE_DATA, calibration_page_data, read_page_data, write_page_data
from gaitcal.page.scene import Scene, scene_of
from gaitcal.page.scene_file import load_scene, save_scene
from gaitcal.page.view import Shown, doubted, followed_by, only, page_html, renamed, with_trials
from gaitcal.results import saved, stride_files
from gaitcal.results.cycles import Json, columns_of, refused_lines, write_csv
from gaitcal.results.summary import subject_summary, summary, table_of, write_kinetics, write_truth
from gaitcal.runtime import with_one_blas_thread
from gaitcal.session import tables
from gaitcal.session.result import Calibration, Loads, TrialResult
from gaitcal.results.saved import AGAIN, DYNAMICS, MODEL, OTHER_MODEL, other_model

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
    """A result with the further trials that `gaitcal dynamics` added, and lines on those that are stale or left out.

    Raises InputError: As of `read_page`; what is wrong with the further trials is such a line.
    """
    shown = read_page(folder)
    if not (folder / DYNAMICS).is_dir():
        return shown, ()
    try:
        further = read_page(folder / DYNAMICS)
    except InputError:
        return shown, (f"{folder / DYNAMICS}: its page is missing or damaged; run its trials again to see them",)
    stale = other_model(folder / DYNAMICS, [t.name for t in further.scene.trials], sha256_of(folder / saved.MODEL))
    lines = tuple(f"{name}: {OTHER_MODEL}; {AGAIN}" for name in stale)
    taken = {trial.name for trial in shown.scene.trials}
    names = {t.name: f"{t.name} ({DYNAMICS})" for t in further.scene.trials if t.name in taken}
    scene = with_trials(shown.scene, further.scene, names)
    if scene is None:
        return shown, (f"{folder / DYNAMICS}: another body than {folder}; run its trials again to see them",)
    about = only(further.data or {}, [t.name for t in further.scene.trials])
    page_data = renamed(doubted(about, [(name, OTHER_MODEL, AGAIN) for name in stale]), names)
    return Shown(scene, followed_by(shown.data or {}, page_data)), lines

