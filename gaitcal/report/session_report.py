"""Read two results of one subject and write their comparison (`gaitcal compare A B`)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gaitcal.analysis.trial_result import estimate_axis_deviations
from gaitcal.calibration.joint_prior import combine_joint_priors
from gaitcal.errors import Code, InputError
from gaitcal.gait import cycles, moments, profile_score, spatiotemporal
from gaitcal.io.result_folder import (
    MANIFEST,
    ResultKind,
    compute_sha256,
    read_json_object,
    write_result_folder,
)
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.io.toml import get_package_version
from gaitcal.model import coordinates, linkage, model_file
from gaitcal.report import gait_report
from gaitcal.report.figures import document, report_sheets
from gaitcal.report.figures.comparison_sheets import (
    build_figure_rows,
    build_paper_panels,
    render_comparison_page,
)
from gaitcal.results import cycles_export, session_difference, stride_files, stride_sets
from gaitcal.results.cycle_tables import CYCLES, read_cycles
from gaitcal.results.saved_result import MODEL, UNCERTAINTY, load_settings, load_uncertainty
from gaitcal.results.session_comparison import CURVE_HEADER, SessionComparison, compare_sessions
from gaitcal.results.shown_labels import SHOWN_MEASURES, list_person_facts
from gaitcal.results.stride_tables import SPATIOTEMPORAL_COLUMNS
from gaitcal.results.summary import SUMMARY, get_entries, get_table
from gaitcal.results.table_files import Json, format_json, read_csv, write_csv
from gaitcal.runtime import with_one_blas_thread

DIFFERENCES, CURVES, WORDS, PAGE = (
    "differences.csv",
    "curve_differences.csv",
    "comparison.txt",
    "comparison.html",
)

PRINTED = 30  # Figures beside steps that a report on paper lists; `differences.csv` has all
SHEETS = {"Kinematics": gait_report.KINEMATICS, "Kinetics": gait_report.KINETICS}


def write_comparison(comparison: SessionComparison, folder: Path, results: Sequence[Path]) -> Path:
    """Write tables, sentences and page of a comparison, whole or not at all.

    Parameters
    ----------
    comparison
        From `compare_results`.
    folder
        The output folder.
    results
        Folders of A and B.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        The folder cannot be written, or contains something other than an earlier comparison.
    """
    warnings = tuple(_make_one_line(f"warning: {text}") for text in comparison.warnings)
    with write_result_folder(
        folder, ResultKind.COMPARISON, [result / MANIFEST for result in results]
    ) as out:
        names = tuple(map(_make_one_line, comparison.names))
        sessions = {f"session_{key}": name for key, name in zip("ab", names, strict=True)}
        hashes = {
            f"manifest_{key}_sha256": compute_sha256(path / MANIFEST)
            for key, path in zip("ab", results, strict=True)
        }
        # Manifests of both results identify them without their paths.
        content: dict[str, Json] = {
            "gaitcal": get_package_version("gaitcal"),
            **sessions,
            **hashes,
            "common": comparison.common.name.lower(),
        }
        (out / MANIFEST).write_text(format_json(content), encoding="utf-8")
        head = (*warnings, f"a: {names[0]}; b: {names[1]}; {comparison.common.description}")
        write_csv(
            comparison.differences,
            out / DIFFERENCES,
            (*head, *session_difference.DIFFERENCES_HEADER),
        )
        write_csv(comparison.curves, out / CURVES, (*head, *CURVE_HEADER))
        (out / PAGE).write_text(render_comparison_html(comparison, results), encoding="utf-8")
        (out / WORDS).write_text(
            "".join(f"{_make_one_line(line)}\n" for line in comparison.lines), encoding="utf-8"
        )
    return folder


def render_comparison_html(comparison: SessionComparison, results: Sequence[Path]) -> str:
    """Render the page of a comparison.

    Parameters
    ----------
    comparison
        From `compare_results`.
    results
        Folders of A and B.

    Returns
    -------
    str
        The content of `comparison.html`.
    """
    norms, scores = _collect_scores(results)
    return render_comparison_page(
        comparison, gait_report.CLINICAL, SHEETS, _list_people(comparison, results), scores, norms
    )


def build_comparison_content(
    comparison: SessionComparison, results: Sequence[Path], comments: Mapping[str, str]
) -> document.ComparisonContent:
    """Build the content of the printed report of two sessions.

    Parameters
    ----------
    comparison
        From `compare_results`.
    results
        Folders of A and B.
    comments
        Section -> text (`gait_report.read_comments`).

    Returns
    -------
    ComparisonContent
        Text, tables and curves.
    """
    norms, scores = _collect_scores(results)
    names, people = comparison.names, [dict(known) for known in _list_people(comparison, results)]
    labels = dict.fromkeys(label for known in people for label in known)
    head = ("figure", "unit", *names, "difference", "missed below", "times")
    steps = [d for d in comparison.found if d.kind == "spatiotemporal" and d.name in SHOWN_MEASURES]
    # Sorted by size against the detectable change, so that the first ones matter most.
    others = [d for d in comparison.found if d.kind != "spatiotemporal"]
    against = (f"{name}, against {norm}" for name, norm in zip(names, norms, strict=True))
    note = (
        f"Means over the stride of each foot: {names[0]} thin, {names[1]} thick with the band of "
        "the minimal detectable change (95 %); bars at the foot mark a larger difference. Moments "
        "and powers divided by the body mass of each session."
    )
    return document.ComparisonContent(
        title=f"Gait report  ·  {comparison.subjects[1].name}: {names[1]} against {names[0]}",
        people=(
            ("", *names),
            *((label, *(known.get(label, "–") for known in people)) for label in labels),
        ),
        sentences=comparison.lines,
        scores=(("deg, ± standard error", *against, "difference"), *scores),
        steps=(head, *build_figure_rows(steps)),
        others=(head, *build_figure_rows(others[:PRINTED])),
        sheets=tuple(
            report_sheets.Sheet(
                title=title,
                panels=tuple(build_paper_panels(comparison, gait_report.CLINICAL, variables)),
                note=note,
                without="No curves: the sessions share none.",
                comment=title.lower(),
                thick=f"{names[1]} ± what could be missed",
                thin=f"thin: {names[0]}",
            )
            for title, variables in SHEETS.items()
        ),
        comments=comments,
        footer=f"gaitcal {get_package_version('gaitcal')}: gaitcal compare has every figure and "
        "its "
        "error",
    )


def _list_people(
    comparison: SessionComparison, results: Sequence[Path]
) -> list[tuple[tuple[str, str], ...]]:
    """List for each session the data of subject and session, and the verdict."""
    verdicts = [
        str(read_json_object(result / SUMMARY).get("verdict") or "not recorded")
        for result in results
    ]
    return [
        (*list_person_facts(p), ("Verdict", v))
        for p, v in zip(comparison.subjects, verdicts, strict=True)
    ]


def _collect_scores(results: Sequence[Path]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Collect the normative data of both results and the rows of scores.

    Rows have no difference if the normative data differ.
    """
    summaries = [read_json_object(result / SUMMARY) for result in results]
    norms = tuple(
        str(get_table(summary, "norm").get("words") or "a norm not recorded")
        for summary in summaries
    )
    same = norms[0] == norms[1] and all(
        get_table(summary, "norm").get("words") for summary in summaries
    )
    return norms, tuple(
        _build_score_rows(*(get_table(summary, "gait_profile") for summary in summaries), same=same)
    )


def _build_score_rows(
    a: Mapping[str, Any], b: Mapping[str, Any], *, same: bool
) -> Iterator[tuple[str, ...]]:
    """Build the rows of scores that both sessions have; errors are taken as independent."""
    for side in ("both", *linkage.SIDES):
        # Scores against different norms cannot be subtracted.
        of_a, of_b = get_table(a, side), get_table(b, side)
        for name in sorted(
            of_a.keys() & of_b.keys(), key=lambda n: (n != profile_score.GPS, list(of_a).index(n))
        ):
            score = [float(scores[name].get("score", np.nan)) for scores in (of_a, of_b)]
            se = [float(scores[name].get("se", np.nan)) for scores in (of_a, of_b)]
            title = (
                "Gait Profile Score"
                if name == profile_score.GPS
                else coordinates.describe_coordinate(name).title
            )
            missed = (
                f" (missed below {session_difference.MDC * np.hypot(se[0], se[1]):.1f})"
                if np.isfinite(se).all()
                else ""
            )
            yield (
                f"{title}, {moments.SIDE_WORDS.get(side, 'both sides')}",
                *(
                    f"{s:.1f} ± {e:.1f}" if np.isfinite(e) else f"{s:.1f}"
                    for s, e in zip(score, se, strict=True)
                ),
                f"{score[1] - score[0]:+.1f}{missed}" if same else "other norm",
            )


def _make_one_line(text: str) -> str:
    """Replace line breaks and control characters, as names are data."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


FURTHER = (
    "model_sha256"  # Entry of the manifest of further trials, whose model lies in the folder above
)


@with_one_blas_thread
def compare_results(a: Path | str, b: Path | str) -> SessionComparison:
    """Compare two results of one subject: before and after, or test and retest.

    Parameters
    ----------
    a, b
        Result folders of `gaitcal calibrate`, or the `dynamics` folders in them.

    Returns
    -------
    SessionComparison
        Differences b - a of angles, moments, powers, spatiotemporal measures and joint parameters
        with their errors, as tables (`differences`, `curves`) and in sentences (`lines`).

    Raises
    ------
    InputError
        One is not a result, is damaged, or is of another subject by the lengths of its legs.
    """
    one, other = (load_session(Path(folder))[0] for folder in (a, b))
    return compare_sessions(*_rename_equal_sessions(one, other))


def load_session(folder: Path) -> tuple[stride_sets.RecordedSession, tuple[Snapshot, ...]]:
    """Load one result, or one folder of further trials, and the snapshots of its files.

    Raises InputError: the folder is not a result, or is damaged.
    """
    manifest = read_json_object(folder / MANIFEST)
    if not manifest:
        message = (
            "is no result of 'gaitcal calibrate': found no manifest.json in it"
            if folder.is_dir()
            else "not found"
        )
        raise InputError(message, source=folder, code=Code.NO_RESULT)
    resolved = folder.resolve()
    # Further trials have their model in the folder of the calibration.
    calibrated = folder / ".." if FURTHER in manifest else folder
    tables = (CYCLES, stride_files.SPATIOTEMPORAL, SUMMARY)
    (strides, measures, summary), read = read_whole(
        folder,
        tables,
        lambda: (read_cycles(folder), _read_measures(folder), read_json_object(folder / SUMMARY)),
    )
    needed = (MODEL, UNCERTAINTY, SUMMARY)
    (model, uncertainty), of_model = read_whole(
        calibrated,
        needed,
        lambda: (
            model_file.load_model(calibrated / MODEL),
            load_uncertainty(calibrated / UNCERTAINTY),
        ),
        (MODEL,),
    )
    settings = load_settings(calibrated)
    stale = (
        ()
        if calibrated is folder
        else cycles_export.list_stale_trials(folder, of_model.sha256[MODEL])
    )
    other = (
        (f"made with another model than the present one: {', '.join(stale)}; run dynamics again",)
        if stale
        else ()
    )
    session = stride_sets.RecordedSession(
        name=resolved.name if calibrated is folder else f"{resolved.parent.name}/{resolved.name}",
        model=model,
        model_key=str(of_model.sha256[MODEL]),
        statics=_list_recordings(calibrated, moving=False),
        recordings=frozenset(
            _list_recordings(calibrated, moving=True) if calibrated is folder else ()
        ),
        influence=uncertainty.joint,
        strides=cycles.validate_stride_table(strides, folder / CYCLES),
        measures=measures,
        verdict=str(summary.get("verdict") or ""),
        reasons=_list_reasons(summary),
        remarks=(*of_model.remarks, *other),
        axis_deviations=estimate_axis_deviations(settings, model),
        error_shares=_average_shares(summary),
        prior=combine_joint_priors(settings.joint_prior, noise=model.noise),
        relative=settings.angles == "relative",
    )
    return session, (read, of_model)


def _rename_equal_sessions(
    a: stride_sets.RecordedSession, b: stride_sets.RecordedSession
) -> tuple[stride_sets.RecordedSession, stride_sets.RecordedSession]:
    """Rename two sessions to A and B if their folders have the same name."""
    return (replace(a, name="A"), replace(b, name="B")) if a.name == b.name else (a, b)


def _read_measures(folder: Path) -> pd.DataFrame:
    source = folder / stride_files.SPATIOTEMPORAL
    try:
        table, _ = read_csv(source)
        if missing := [name for name in SPATIOTEMPORAL_COLUMNS if name not in table]:
            message = f"is no table of measures: found no column {', '.join(missing)}"
            raise InputError(message, source=source, code=Code.DAMAGED_RESULT)
        numbers = {
            name: pd.to_numeric(table[name]) for name in ("stride", "value", "valid", "turn")
        }
    except (OSError, UnicodeError, ValueError) as error:
        message = f"cannot be read as a table of measures: {error}"
        raise InputError(message, source=source, code=Code.DAMAGED_RESULT) from None
    whole = table.assign(**numbers)
    return whole[
        whole["variable"].isin(list(spatiotemporal.MEASURES)) & np.isfinite(whole["value"])
    ]


def _list_recordings(folder: Path, *, moving: bool) -> tuple[str, ...]:
    """List the SHA-256 of the files of moving trials, or of static ones."""
    moving_trials, hashes = (
        get_table(read_json_object(folder / n), key)
        for n, key in ((SUMMARY, "trials"), (MANIFEST, "inputs_sha256"))
    )
    files = (
        files.get("file", "")
        for trial, files in cycles_export.read_trial_files(folder).items()
        if (trial in moving_trials) is moving
    )
    return tuple(sorted(str(hashes[file]) for file in files if file in hashes))


def _list_reasons(summary: Mapping[str, object]) -> tuple[str, ...]:
    found = get_entries(summary, "reasons")
    return tuple(
        f"{', '.join(map(str, r.get('trials') or ['study']))}: {r.get('cause')}" for r in found
    )


def _average_shares(summary: Mapping[str, object]) -> dict[str, dict[str, float]]:
    """Average torque -> source -> part of its variance over trials."""
    found: dict[str, list[dict[str, float]]] = {}
    for entry in get_table(summary, "trials").values():
        for torque, shares in get_table(entry, "torque_error_sources").items():
            found.setdefault(torque, []).append(shares)
    out: dict[str, dict[str, float]] = {}
    for torque, shares_of_trials in found.items():
        out[torque] = {}
        for source in dict.fromkeys(source for shares in shares_of_trials for source in shares):
            # a source that a trial does not list has no part there
            parts = [shares.get(source, 0.0) for shares in shares_of_trials]
            out[torque][source] = float(np.mean(parts))
    return out
