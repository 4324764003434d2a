"""Write the folder of further trials (`gaitcal dynamics`); each run adds its trials."""

import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import cast

from gaitcal.analysis.result import TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.osim_writer import encode_name
from gaitcal.io import atomic, result_folder, toml
from gaitcal.pipeline.write_results import write_trial
from gaitcal.quality.verdict import Verdict
from gaitcal.report.page.page_folder import read_earlier_page, write_further_page
from gaitcal.results.result_tables import RESULT
from gaitcal.results.saved_result import AGAIN, MODEL, OTHER_MODEL, SavedResult
from gaitcal.results.stride_files import STRIDE_FILES, read_earlier_strides, write_stride_files
from gaitcal.results.stride_tables import build_stride_tables
from gaitcal.results.summary import (
    SUMMARY,
    get_entries,
    get_table,
    summarise_trial,
    summarise_verdict,
)
from gaitcal.results.table_files import Json, format_json

RUN_AGAIN = f"; {AGAIN}"  # How warnings on stale trials end: a later run makes them anew, or not


def write_trials(
    trials: Sequence[TrialResult],
    saved: SavedResult,
    folder: Path,
    inputs: Sequence[Path],
    verdict: Verdict,
) -> tuple[str, ...]:
    """Write further trials, whole or not at all; trials of earlier runs with other names stay.

    Parameters
    ----------
    trials
        The new trials.
    saved
        Result with which they were analysed. Nothing is written if one of its files has changed.
        The hash of its model is stored with each trial.
    folder
        Folder of further trials.
    inputs
        Recordings and forces, which the folder must not contain.
    verdict
        On these trials; `summary.json` records it for each, with its reasons among the warnings.

    Returns
    -------
    tuple of str
        Warnings on earlier trials: of another model, or changed since they were written.

    Raises
    ------
    InputError
        The folder cannot be written, or contains files of another program; the model has changed;
        the earlier summary or manifest is damaged.
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
        earlier = _read_earlier_hashes(folder)
        summary, manifest = (
            result_folder.read_json_object(folder / SUMMARY),
            result_folder.read_json_object(folder / result_folder.MANIFEST),
        )
        digests = _drop_names(get_table(manifest, "model_sha256"), names) | dict.fromkeys(
            sorted(names), digest
        )
        # Trials of earlier runs stay, except those that are written again.
        kept = _drop_names(get_table(summary, "trials"), names)
        old_model = [name for name in kept if digests.get(name) != digest]
        tables = build_stride_tables(model, trials, relative_to)
        page, page_warnings = read_earlier_page(folder, earlier, kept, old_model)
        stale = tuple(f"{name}: {OTHER_MODEL}{RUN_AGAIN}" for name in old_model)
        stale += (*_warn_of_damaged_files(folder, earlier, kept), *page_warnings)
        write_stride_files(out, tables, read_earlier_strides(folder, earlier, kept))
        write_further_page(out, trials, tables, saved, verdict, page)
        # Warnings on stale trials are written anew.
        earlier_warnings = (
            w for w in _select_lines(kept, summary, "warnings") if not w.endswith(RUN_AGAIN)
        )
        reasons = (
            r for r in get_entries(summary, "reasons") if set(r.get("trials") or []) & set(kept)
        )
        new_summary: dict[str, Json] = {
            "trials": {**kept, **{t.name: summarise_trial(t, verdict) for t in trials}},
            "reasons": [*reasons, *cast(list[Json], summarise_verdict(verdict)["reasons"])],
            "notes": [
                *_select_lines(kept, summary, "notes"),
                *(note for t in trials for note in t.notes),
            ],
            "warnings": [*earlier_warnings, *stale, *(reason.line for reason in verdict.reasons)],
            **({"forced": True} if verdict.forced or summary.get("forced") else {}),
        }
        (out / SUMMARY).write_text(format_json(new_summary), encoding="utf-8")
        new_manifest: dict[str, Json] = {
            "gaitcal": toml.get_package_version("gaitcal"),
            "subject": model.subject.name,
            RESULT: os.path.relpath(saved.files.folder, folder),
            "model_sha256": digests,
        }
        (out / result_folder.MANIFEST).write_text(format_json(new_manifest), encoding="utf-8")
        # Files of kept trials are copied with their hashes, so that an edit stays detectable.
        owners = _map_files_to_trials(kept)
        for path in sorted(folder.glob("*/*")):
            if path.is_file() and path.stem in owners:
                name = path.relative_to(folder).as_posix()
                (out / name).parent.mkdir(exist_ok=True)
                shutil.copy2(path, out / name)
                if name in earlier:
                    carried[name] = earlier[name]
    return stale


def _read_earlier_hashes(folder: Path) -> Mapping[str, str]:
    """Read file -> SHA-256 of the earlier result; raise InputError if its summary is damaged."""
    hashes = result_folder.read_listed_hashes(folder)
    if SUMMARY in hashes and result_folder.compute_sha256(folder / SUMMARY) != hashes[SUMMARY]:
        cure = "move the folder away and run its trials again"
        message = f"is damaged, or was edited: not as gaitcal wrote it; {cure}"
        raise InputError(message, source=folder / SUMMARY, code=Code.DAMAGED_RESULT)
    return hashes


def _map_files_to_trials(trials: Iterable[str]) -> dict[str, str]:
    """Map the name of a trial's files, without folder and suffix, to the trial."""
    return {stem: trial for trial in trials for stem in (trial, encode_name(trial))}


def _warn_of_damaged_files(
    folder: Path, earlier: Mapping[str, str], kept: Iterable[str]
) -> tuple[str, ...]:
    """Warn of files of kept trials that have changed since they were written."""
    owners = _map_files_to_trials(kept)
    return tuple(
        f"{owners[stem]}: {file} is damaged, or was edited: not as gaitcal wrote it{RUN_AGAIN}"
        for file, digest in earlier.items()
        if (stem := Path(file).stem) in owners
        and result_folder.compute_sha256(folder / file) != digest
    ) + tuple(
        f"{trial}: {file} is missing, damaged or edited: its rows of this trial are left "
        f"out{RUN_AGAIN}"
        for file in STRIDE_FILES
        if earlier and result_folder.compute_sha256(folder / file) != earlier.get(file, "")
        for trial in kept
    )


def _drop_names(table: Mapping[str, Json], names: set[str]) -> dict[str, Json]:
    """Drop the entries of these names."""
    return {name: value for name, value in table.items() if name not in names}


def _select_lines(trials: Mapping[str, Json], summary: Mapping[str, object], key: str) -> list[str]:
    """Select earlier notes or warnings that begin with the name of one of these trials."""
    stored = summary.get(key)
    lines = [line for line in stored if isinstance(line, str)] if isinstance(stored, list) else []
    prefixes = tuple(f"{name}: " for name in trials)
    return [line for line in lines if line.startswith(prefixes)]
