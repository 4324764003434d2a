"""The page of a folder of further trials: those of this run after those of earlier runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gaitcal.errors import InputError
from gaitcal.files.snapshot import sha256_of
from gaitcal.page import Shown, person_scene, trial_scene
from gaitcal.page.joining import after_trials
from gaitcal.page.sections import Origin
from gaitcal.page.sheet import SHEET, doubted, further_sheet, merged, only, read_sheet
from gaitcal.person.result import TrialResult
from gaitcal.results.page_files import AGAIN, OTHER_MODEL, SCENE, read_page, write_page
from gaitcal.results.saved import SavedResult
from gaitcal.verdict.verdict import Verdict


def write_further_page(
    out: Path, trials: Sequence[TrialResult], saved: SavedResult, verdict: Verdict, earlier: Shown | None
) -> None:
    """Write scene, sheet and page of these trials into a folder, those of `earlier` before them.

    Normal bands, and what is told of the model, are those of the result's own page, where it can be read.
    """
    scene = person_scene(
        saved.model,
        tuple(
            trial_scene(
                saved.model, t.name, t.role.value, t.body, t.recording, None if t.loads is None else t.loads.reactions
            )
            for t in trials
        ),
        saved.uncertainty.standard_errors,
    )
    origin = Origin(_sheet_of(saved.files.folder), edited=bool(saved.files.remarks))
    bands = origin.sheet.get("bands")
    sheet: Mapping[str, Any] = {
        **further_sheet(saved.model, trials, verdict, saved.relative_to, origin),
        "bands": bands if isinstance(bands, list) else [],
    }
    if earlier is not None and earlier.sheet is not None and (joined := after_trials(scene, earlier.scene)) is not None:
        scene, sheet = joined, merged(earlier.sheet, sheet)
    write_page(out, scene, sheet)


def earlier_page(
    folder: Path, hashes: Mapping[str, str], kept: Iterable[str], stale: Iterable[str]
) -> tuple[Shown | None, tuple[str, ...]]:
    """The page of the trials `kept` of an earlier run, and a warning on each that cannot stay in it.

    Parameters
    ----------
    hashes : file -> SHA-256 as it was written.
    stale : those that were made with another model.
    """
    names = tuple(kept)
    if not names:
        return None, ()
    fault = _fault(folder, hashes)
    shown = None
    if not fault:
        try:
            shown = read_page(folder)
        except InputError:
            fault = f"{SCENE} and {SHEET} cannot be read"
    if shown is None or shown.sheet is None:
        return None, tuple(f"{name}: {fault}: the page leaves this trial out; {AGAIN}" for name in names)
    doubts = [(name, OTHER_MODEL, AGAIN) for name in stale]
    return Shown(shown.scene, doubted(only(shown.sheet, names), doubts), shown.name), ()


def _fault(folder: Path, hashes: Mapping[str, str]) -> str:
    """What keeps an earlier page from being read; empty where nothing does."""
    for name in (SCENE, SHEET):
        if sha256_of(folder / name) != hashes.get(name):
            return f"{name} is damaged, or was edited: not as gaitcal wrote it"
    return ""


def _sheet_of(result: Path) -> Mapping[str, Any]:
    """Of the calibration's page; empty where it cannot be read."""
    try:
        return read_sheet(result / SHEET)
    except InputError:
        return {}
