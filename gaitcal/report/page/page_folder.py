"""Write and read the files of a page in a result folder, with the pages of further trials.

No other module reads `page.json`: a page is drawn again from it, joined with that of other trials,
or supplemented. All other reports take the tables of `results/result_tables.py`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from gaitcal.analysis.result import TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.io import snapshot
from gaitcal.io.result_folder import compute_sha256, read_json_object
from gaitcal.quality.verdict import Verdict
from gaitcal.report.page.page_data import (
    PAGE_DATA,
    build_further_page_data,
    read_page_data,
    write_page_data,
)
from gaitcal.report.page.page_html import (
    PageContent,
    add_doubts,
    append_page_data,
    append_trials,
    merge_page_data,
    prepend_trials,
    rename_trials,
    render_page,
    select_trials,
)
from gaitcal.report.page.provenance import Origin
from gaitcal.report.page.scene import Scene, build_person_scene, build_trial_scene
from gaitcal.report.page.scene_file import load_scene, save_scene
from gaitcal.results import saved_result
from gaitcal.results.normal_curves import NO_NORM, read_norm_tables
from gaitcal.results.saved_result import (
    AGAIN,
    DYNAMICS,
    OTHER_MODEL,
    SavedResult,
    select_stale_trials,
)
from gaitcal.results.stride_tables import StrideTables
from gaitcal.results.summary import SUMMARY

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
        Content of the page.

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
        Content of the page.
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
    # Trials that were computed with an earlier calibration are shown with a warning.
    stale = select_stale_trials(
        folder / DYNAMICS,
        [t.name for t in further.scene.trials],
        compute_sha256(folder / saved_result.MODEL),
    )
    lines = tuple(f"{name}: {OTHER_MODEL}; {AGAIN}" for name in stale)
    taken = {trial.name for trial in shown.scene.trials}
    # Two trials of one name: the further one gets the folder after its name.
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


def write_further_page(
    out: Path,
    trials: Sequence[TrialResult],
    tables: StrideTables,
    saved: SavedResult,
    verdict: Verdict,
    earlier: PageContent | None,
) -> None:
    """Write scene, page data and page of further trials, after those of an earlier run.

    Parameters
    ----------
    out
        The folder that is being written.
    trials
        The new trials.
    tables
        Their curves and strides.
    saved
        The result that they were made with. Its normative curves are drawn; its page, if readable,
        describes the model.
    verdict
        On the new trials.
    earlier
        From `read_earlier_page`.
    """
    scenes = tuple(
        build_trial_scene(
            saved.model,
            t.name,
            t.role.value,
            t.body,
            t.recording,
            None if t.loads is None else t.loads.reactions,
        )
        for t in trials
    )
    scene = build_person_scene(saved.model, scenes, saved.uncertainty.standard_errors)
    result = saved.files.folder
    try:
        # Normative data and sections of the calibration are optional on this page.
        norm = read_norm_tables(result, read_json_object(result / SUMMARY))
    except InputError:
        norm = NO_NORM
    try:
        of_result: Mapping[str, Any] = read_page_data(result / PAGE_DATA)
    except InputError:
        of_result = {}
    origin = Origin(of_result, edited=bool(saved.files.remarks))
    page_data = build_further_page_data(saved.model, trials, tables, verdict, norm, origin)
    if (
        earlier is not None
        and earlier.data is not None
        and (joined := prepend_trials(scene, earlier.scene)) is not None
    ):
        scene, page_data = joined, merge_page_data(earlier.data, page_data)
    write_page(out, scene, page_data)


def read_earlier_page(
    folder: Path, hashes: Mapping[str, str], kept: Iterable[str], stale: Iterable[str]
) -> tuple[PageContent | None, tuple[str, ...]]:
    """Read the page of the trials `kept` of an earlier run, with warnings on those left out.

    `hashes`: file -> SHA-256 as it was written; `stale`: trials made with another model.
    """
    names = tuple(kept)
    if not names:
        return None, ()
    fault, shown = "", None
    for name in (SCENE, PAGE_DATA):
        # An edited page must not be continued as if gaitcal had written it.
        if compute_sha256(folder / name) != hashes.get(name):
            fault = fault or f"{name} is damaged, or was edited: not as gaitcal wrote it"
    if not fault:
        try:
            shown = read_page(folder)
        except InputError:
            fault = f"{SCENE} and {PAGE_DATA} cannot be read"
    if shown is None or shown.data is None:
        return None, tuple(f"{name}: {fault}: the page omits this trial; {AGAIN}" for name in names)
    doubts = [(name, OTHER_MODEL, AGAIN) for name in stale]
    return PageContent(shown.scene, add_doubts(select_trials(shown.data, names), doubts)), ()
