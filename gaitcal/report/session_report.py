"""Two result folders of one person, read for `gaitcal compare A B`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gaitcal.analysis.trial_result import axis_deviations
from gaitcal.calibration.joint_prior import prior_of_study
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
from gaitcal.report.figures.comparison_sheets import comparison_page, figure_rows, paper_panels
from gaitcal.report.page.page_data import SHOWN_MEASURES, person_facts
from gaitcal.results import cycles_export, session_difference, stride_files, stride_sets
from gaitcal.results.cycle_tables import CYCLES, read_cycles
from gaitcal.results.saved_result import MODEL, UNCERTAINTY, load_uncertainty, settings_of
from gaitcal.results.session_comparison import CURVE_HEADER, SessionComparison, compare_sessions
from gaitcal.results.summary import SUMMARY, entries_of, table_of
from gaitcal.results.table_files import Json, json_text, read_csv, write_csv
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
    """Write the tables and the words of a comparison of two `results`, whole or not at all. Returns
    the folder.

    Raises InputError: The folder cannot be written, or holds something else than an earlier
    comparison.
    """
    told = tuple(one_line(f"warning: {text}") for text in comparison.warnings)
    with write_result_folder(
        folder, ResultKind.COMPARISON, [result / MANIFEST for result in results]
    ) as out:
        names = tuple(map(one_line, comparison.names))
        sessions = {f"session_{key}": name for key, name in zip("ab", names, strict=True)}
        hashes = {
            f"manifest_{key}_sha256": compute_sha256(path / MANIFEST)
            for key, path in zip("ab", results, strict=True)
        }
        content: dict[str, Json] = {
            "gaitcal": get_package_version("gaitcal"),
            **sessions,
            **hashes,
            "common": comparison.common.name.lower(),
        }
        (out / MANIFEST).write_text(json_text(content), encoding="utf-8")
        head = (*told, f"a: {names[0]}; b: {names[1]}; {comparison.common.words}")
        write_csv(
            comparison.differences,
            out / DIFFERENCES,
            (*head, *session_difference.DIFFERENCES_HEADER),
        )
        write_csv(comparison.curves, out / CURVES, (*head, *CURVE_HEADER))
        (out / PAGE).write_text(comparison_html(comparison, results), encoding="utf-8")
        (out / WORDS).write_text(
            "".join(f"{one_line(line)}\n" for line in comparison.lines), encoding="utf-8"
        )
    return folder


def comparison_html(comparison: SessionComparison, results: Sequence[Path]) -> str:
    """The page of a comparison of two `results`: `comparison.html`."""
    norms, scores = _scores(results)
    return comparison_page(
        comparison, gait_report.CLINICAL, SHEETS, _people(comparison, results), scores, norms
    )


def comparison_content(
    comparison: SessionComparison, results: Sequence[Path], comments: Mapping[str, str]
) -> document.ComparisonContent:
    """The report on paper of two `results`; `comments` as of `report_content`."""
    norms, scores = _scores(results)
    names, people = comparison.names, [dict(known) for known in _people(comparison, results)]
    labels = dict.fromkeys(label for known in people for label in known)
    head = ("figure", "unit", *names, "difference", "missed below", "times")
    steps = [d for d in comparison.found if d.kind == "spatiotemporal" and d.name in SHOWN_MEASURES]
    others = [d for d in comparison.found if d.kind != "spatiotemporal"]
    against = (f"{name}, against {norm}" for name, norm in zip(names, norms, strict=True))
    note = (
        f"Means over the stride of each foot: {names[0]} thin, {names[1]} thick in the band within "
        "which a difference "
        "could have been missed (95 %). Moments and powers by each session's own body mass."
    )
    return document.ComparisonContent(
        title=f"Gait report  ·  {comparison.subjects[1].name}: {names[1]} against {names[0]}",
        people=(
            ("", *names),
            *((label, *(known.get(label, "–") for known in people)) for label in labels),
        ),
        words=comparison.lines,
        scores=(("deg, ± standard error", *against, "difference"), *scores),
        steps=(head, *figure_rows(steps)),
        others=(head, *figure_rows(others[:PRINTED])),
        sheets=tuple(
            report_sheets.Sheet(
                title=title,
                panels=tuple(paper_panels(comparison, gait_report.CLINICAL, variables)),
                note=note,
                without="No curves: the sessions share none.",
                comment=title.lower(),
                thick=f"{names[1]} ± what could be missed",
                thin=f"thin: {names[0]}",
            )
            for title, variables in SHEETS.items()
        ),
        comments=comments,
        footer=f"gaitcal {get_package_version('gaitcal')}: gaitcal compare has every figure and its "
        "error",
    )


def _people(
    comparison: SessionComparison, results: Sequence[Path]
) -> list[tuple[tuple[str, str], ...]]:
    """Of each session, label and value of what is known of person and day, and the verdict of its
    result.
    """
    verdicts = [
        str(read_json_object(result / SUMMARY).get("verdict") or "not told") for result in results
    ]
    return [
        (*person_facts(p), ("Verdict", v))
        for p, v in zip(comparison.subjects, verdicts, strict=True)
    ]


def _scores(results: Sequence[Path]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Whom both results are held against, and the rows of scores; without a difference where these
    are not the same.
    """
    summaries = [read_json_object(result / SUMMARY) for result in results]
    norms = tuple(
        str(table_of(summary, "norm").get("words") or "not told whom") for summary in summaries
    )
    same = norms[0] == norms[1] and all(
        table_of(summary, "norm").get("words") for summary in summaries
    )
    return norms, tuple(
        _score_rows(*(table_of(summary, "gait_profile") for summary in summaries), same=same)
    )


def _score_rows(
    a: Mapping[str, Any], b: Mapping[str, Any], *, same: bool
) -> Iterator[tuple[str, ...]]:
    """Gait Profile Scores and their angles, where both have them; errors as if independent."""
    for side in ("both", *linkage.SIDES):
        of_a, of_b = table_of(a, side), table_of(b, side)
        for name in sorted(
            of_a.keys() & of_b.keys(), key=lambda n: (n != profile_score.GPS, list(of_a).index(n))
        ):
            score, se = (
                [float(of[name].get(key, np.nan)) for of in (of_a, of_b)] for key in ("score", "se")
            )
            title = (
                "Gait Profile Score"
                if name == profile_score.GPS
                else coordinates.coordinate_words(name).title
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


def one_line(text: str) -> str:
    """Names are data: what would begin a new line of a file, or moves a cursor, becomes a blank."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


FURTHER = (
    "model_sha256"  # Entry of the manifest of further trials, whose model lies in the folder above
)


@with_one_blas_thread
def compare_results(a: Path | str, b: Path | str) -> SessionComparison:
    """Set two results of one person side by side: before and after, or test and retest.

    Parameters
    ----------
    a, b : result folders of `gaitcal calibrate`, or the `dynamics` folders in them.

    Returns
    -------
    Differences b - a of angles, moments, powers, spatiotemporal measures and joint parameters with
    their error bars, as tables (`differences`, `curves`), and in words (`lines`).

    Raises
    ------
    InputError
        One is no result, damaged, or of another person by the lengths of its legs.
    """
    one, other = (load_session(Path(folder))[0] for folder in (a, b))
    return compare_sessions(*named_apart(one, other))


def load_session(folder: Path) -> tuple[stride_sets.RecordedSession, tuple[Snapshot, ...]]:
    """Read one result folder, or one of further trials; and what was read.

    Raises InputError: It is none, or damaged.
    """
    manifest = read_json_object(folder / MANIFEST)
    if not manifest:
        message = (
            "is no result of 'gaitcal calibrate': found no manifest.json in it"
            if folder.is_dir()
            else "not found"
        )
        raise InputError(message, source=folder, code=Code.NO_RESULT)
    whole = folder.resolve()
    calibrated = folder / ".." if FURTHER in manifest else folder
    tables = (CYCLES, stride_files.SPATIOTEMPORAL, SUMMARY)
    (strides, measures, summary), read = read_whole(
        folder,
        tables,
        lambda: (read_cycles(folder), _measures(folder), read_json_object(folder / SUMMARY)),
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
    settings = settings_of(calibrated)
    stale = (
        ()
        if calibrated is folder
        else cycles_export.made_with_another_model(folder, of_model.sha256[MODEL])
    )
    other = (
        (f"made with another model than lies there now: {', '.join(stale)}; run dynamics again",)
        if stale
        else ()
    )
    session = stride_sets.RecordedSession(
        name=whole.name if calibrated is folder else f"{whole.parent.name}/{whole.name}",
        model=model,
        model_key=str(of_model.sha256[MODEL]),
        statics=_recordings(calibrated, moving=False),
        recordings=frozenset(_recordings(calibrated, moving=True) if calibrated is folder else ()),
        influence=uncertainty.joint,
        strides=cycles.typed(strides, folder / CYCLES),
        measures=measures,
        verdict=str(summary.get("verdict") or ""),
        reasons=_reasons(summary),
        remarks=(*of_model.remarks, *other),
        axis_deviations=axis_deviations(settings, model),
        error_shares=_shares(summary),
        prior=prior_of_study(settings.joint_prior, noise=model.noise),
        relative=settings.angles == "relative",
    )
    return session, (read, of_model)


def named_apart(
    a: stride_sets.RecordedSession, b: stride_sets.RecordedSession
) -> tuple[stride_sets.RecordedSession, stride_sets.RecordedSession]:
    """Both, with other names where their folders have one name."""
    return (replace(a, name="A"), replace(b, name="B")) if a.name == b.name else (a, b)


def _measures(folder: Path) -> pd.DataFrame:
    source = folder / stride_files.SPATIOTEMPORAL
    try:
        table, _ = read_csv(source)
        if missing := [name for name in stride_files.SPATIOTEMPORAL_COLUMNS if name not in table]:
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


def _recordings(folder: Path, *, moving: bool) -> tuple[str, ...]:
    """SHA-256 of the files of the trials that its summary tells of, or of the others: static ones."""
    told, hashes = (
        table_of(read_json_object(folder / n), key)
        for n, key in ((SUMMARY, "trials"), (MANIFEST, "inputs_sha256"))
    )
    files = (
        files.get("file", "")
        for trial, files in cycles_export.trial_files(folder).items()
        if (trial in told) is moving
    )
    return tuple(sorted(str(hashes[file]) for file in files if file in hashes))


def _reasons(summary: Mapping[str, object]) -> tuple[str, ...]:
    found = entries_of(summary, "reasons")
    return tuple(
        f"{', '.join(map(str, r.get('trials') or ['study']))}: {r.get('cause')}" for r in found
    )


def _shares(summary: Mapping[str, object]) -> dict[str, dict[str, float]]:
    """Torque -> source -> part of its variance, the mean over trials."""
    found: dict[str, list[dict[str, float]]] = {}
    for entry in table_of(summary, "trials").values():
        for torque, shares in table_of(entry, "torque_error_sources").items():
            found.setdefault(torque, []).append(shares)
    out = {}
    for torque, listed in found.items():
        sources = dict.fromkeys(source for shares in listed for source in shares)
        out[torque] = {
            s: float(np.mean([shares.get(s, 0.0) for shares in listed])) for s in sources
        }
    return out
