"""The folder of further trials (`gaitcal dynamics`): every run adds its trials to those that are
there.
"""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

from gaitcal.analysis.result import TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.osim_writer import safe_name
from gaitcal.io import atomic, result_folder, toml
from gaitcal.pipeline.write_results import write_trial
from gaitcal.quality.verdict import Verdict
from gaitcal.report.page.page_data import PAGE_DATA, further_page_data, read_page_data
from gaitcal.report.page.page_folder import SCENE, read_page, write_page
from gaitcal.report.page.page_html import Shown, after_trials, doubted, merged, only
from gaitcal.report.page.provenance import Origin
from gaitcal.report.page.scene import person_scene, trial_scene
from gaitcal.results.saved_result import AGAIN, MODEL, OTHER_MODEL, SavedResult
from gaitcal.results.stride_files import STRIDE_FILES, earlier_strides, write_stride_files
from gaitcal.results.summary import SUMMARY, entries_of, table_of, trial_summary, verdict_summary
from gaitcal.results.table_files import Json, json_text


def write_further_page(
    out: Path,
    trials: Sequence[TrialResult],
    saved: SavedResult,
    verdict: Verdict,
    earlier: Shown | None,
) -> None:
    """Write scene, page_data and page of these trials into a folder, those of `earlier` before
    them.

    Normal bands, and what is told of the model, are those of the result's own page, where it can be
    read.
    """
    scene = person_scene(
        saved.model,
        tuple(
            trial_scene(
                saved.model,
                t.name,
                t.role.value,
                t.body,
                t.recording,
                None if t.loads is None else t.loads.reactions,
            )
            for t in trials
        ),
        saved.uncertainty.standard_errors,
    )
    origin = Origin(_sheet_of(saved.files.folder), edited=bool(saved.files.remarks))
    bands = origin.data.get("bands")
    page_data: Mapping[str, Any] = {
        **further_page_data(saved.model, trials, verdict, saved.relative_to, origin),
        "bands": bands if isinstance(bands, list) else [],
    }
    if (
        earlier is not None
        and earlier.data is not None
        and (joined := after_trials(scene, earlier.scene)) is not None
    ):
        scene, page_data = joined, merged(earlier.data, page_data)
    write_page(out, scene, page_data)


def earlier_page(
    folder: Path, hashes: Mapping[str, str], kept: Iterable[str], stale: Iterable[str]
) -> tuple[Shown | None, tuple[str, ...]]:
    """The page of the trials `kept` of an earlier run, and a warning on each that cannot stay in
    it.

    `hashes`: file -> SHA-256 as it was written.
    `stale`: those that were made with another model.
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
            fault = f"{SCENE} and {PAGE_DATA} cannot be read"
    if shown is None or shown.data is None:
        return None, tuple(
            f"{name}: {fault}: the page leaves this trial out; {AGAIN}" for name in names
        )
    doubts = [(name, OTHER_MODEL, AGAIN) for name in stale]
    return Shown(shown.scene, doubted(only(shown.data, names), doubts)), ()


def _fault(folder: Path, hashes: Mapping[str, str]) -> str:
    """What keeps an earlier page from being read; empty where nothing does."""
    for name in (SCENE, PAGE_DATA):
        if result_folder.compute_sha256(folder / name) != hashes.get(name):
            return f"{name} is damaged, or was edited: not as gaitcal wrote it"
    return ""


def _sheet_of(result: Path) -> Mapping[str, Any]:
    """Of the calibration's page; empty where it cannot be read."""
    try:
        return read_page_data(result / PAGE_DATA)
    except InputError:
        return {}


RUN_AGAIN = f"; {AGAIN}"  # How warnings on stale trials end: a later run makes them anew, or not


def write_trials(
    trials: Sequence[TrialResult],
    saved: SavedResult,
    folder: Path,
    inputs: Sequence[Path],
    verdict: Verdict,
) -> tuple[str, ...]:
    """Write further trials into `folder`, whole or not at all; those of earlier runs stay, but for
    the same names.

    `saved`: what the trials were made with. Nothing is written where one of its files has changed
    since; the model's hash tells later whether an earlier trial was made with it. `inputs`:
    recordings and forces, which the folder must not hold. `verdict`: on these trials;
    `summary.json` tells it for each, with its reasons among the warnings.

    Returns
    -------
    Warnings on earlier trials that are kept: made with another model, or no longer as they were
    written.

    Raises InputError: The folder cannot be written, or holds files that are not ours; the model has
    changed; the earlier summary or manifest is damaged.
    """
    names = {trial.name for trial in trials}
    model, relative_to = saved.model, saved.relative_to
    digest = str(saved.files.sha256[MODEL])
    carried: dict[str, str] = {}
    with (
        ExitStack() as until_done,
        result_folder.write_result_folder(
            folder, result_folder.ResultKind.DYNAMICS, inputs, carried
        ) as out,
    ):
        for trial in trials:
            write_trial(trial, model, out, relative_to)
        with atomic.convert_disk_errors(folder):
            until_done.enter_context(result_folder.lock_result(folder))
        saved.files.require_unchanged()
        earlier = _earlier(folder)
        summary, manifest = (
            result_folder.read_json_object(folder / SUMMARY),
            result_folder.read_json_object(folder / result_folder.MANIFEST),
        )
        digests = _others(table_of(manifest, "model_sha256"), names) | dict.fromkeys(
            sorted(names), digest
        )
        kept = _others(table_of(summary, "trials"), names)
        aged = [name for name in kept if digests.get(name) != digest]
        page, unseen = earlier_page(folder, earlier, kept, aged)
        stale = tuple(f"{name}: {OTHER_MODEL}{RUN_AGAIN}" for name in aged)
        stale += (*_damaged(folder, earlier, kept), *unseen)
        write_stride_files(out, model, trials, relative_to, earlier_strides(folder, earlier, kept))
        write_further_page(out, trials, saved, verdict, page)
        earlier_warnings = (
            w for w in _lines_about(kept, summary, "warnings") if not w.endswith(RUN_AGAIN)
        )
        reasons = (
            r for r in entries_of(summary, "reasons") if set(r.get("trials") or []) & set(kept)
        )
        new_summary: dict[str, Json] = {
            "trials": {**kept, **{t.name: trial_summary(t, verdict) for t in trials}},
            "reasons": [*reasons, *cast(list[Json], verdict_summary(verdict)["reasons"])],
            "notes": [
                *_lines_about(kept, summary, "notes"),
                *(note for t in trials for note in t.notes),
            ],
            "warnings": [*earlier_warnings, *stale, *(reason.line for reason in verdict.reasons)],
        }
        (out / SUMMARY).write_text(json_text(new_summary), encoding="utf-8")
        new_manifest: dict[str, Json] = {
            "gaitcal": toml.get_package_version("gaitcal"),
            "subject": model.subject.name,
            "model_sha256": digests,
        }
        (out / result_folder.MANIFEST).write_text(json_text(new_manifest), encoding="utf-8")
        owners = _owners(kept)
        for path in sorted(folder.glob("*/*")):
            if path.is_file() and path.stem in owners:
                name = path.relative_to(folder).as_posix()
                (out / name).parent.mkdir(exist_ok=True)
                shutil.copy2(path, out / name)
                if name in earlier:
                    carried[name] = earlier[name]
    return stale


def _earlier(folder: Path) -> Mapping[str, str]:
    """File -> SHA-256 of the earlier result; InputError where what is read of it is damaged."""
    hashes = result_folder.read_listed_hashes(folder)
    if SUMMARY in hashes and result_folder.compute_sha256(folder / SUMMARY) != hashes[SUMMARY]:
        cure = "move the folder away and run its trials again"
        message = f"is damaged, or was edited: not as gaitcal wrote it; {cure}"
        raise InputError(message, source=folder / SUMMARY, code=Code.DAMAGED_RESULT)
    return hashes


def _owners(trials: Iterable[str]) -> dict[str, str]:
    """Name of a trial's files, without folder and ending -> the trial."""
    return {stem: trial for trial in trials for stem in (trial, safe_name(trial))}


def _damaged(folder: Path, earlier: Mapping[str, str], kept: Iterable[str]) -> tuple[str, ...]:
    """Warnings on files of kept trials that are not as they were written."""
    owners = _owners(kept)
    return tuple(
        f"{owners[stem]}: {file} is damaged, or was edited: not as gaitcal wrote it{RUN_AGAIN}"
        for file, digest in earlier.items()
        if (stem := Path(file).stem) in owners
        and result_folder.compute_sha256(folder / file) != digest
    ) + tuple(
        f"{trial}: {file} is damaged, or was edited: its rows of this trial are left out{RUN_AGAIN}"
        for file in STRIDE_FILES
        if file in earlier and result_folder.compute_sha256(folder / file) != earlier[file]
        for trial in kept
    )


def _others(table: Mapping[str, Json], names: set[str]) -> dict[str, Json]:
    return {name: value for name, value in table.items() if name not in names}


def _lines_about(trials: Mapping[str, Json], summary: Mapping[str, object], key: str) -> list[str]:
    """Notes or warnings of an earlier summary that begin with the name of one of these trials."""
    stored = summary.get(key)
    lines = [line for line in stored if isinstance(line, str)] if isinstance(stored, list) else []
    return [line for line in lines if any(line.startswith(f"{name}: ") for name in trials)]
