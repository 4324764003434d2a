"""All tables of a result: built from its calibration, or read back from its folder.

One object for the files of the folder, the page, the PDF and the figures, none of which reads the
file of another. Tables of each trial over time are in `trial_tables.py`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.analysis.parameter_table import list_parameter_rows
from gaitcal.analysis.result import Calibration
from gaitcal.errors import Code, InputError
from gaitcal.gait.cycles import CYCLE_COLUMNS
from gaitcal.gait.normal_bands import Norm
from gaitcal.gait.peaks import PEAK_COLUMNS, PEAKS, PHASE_PEAKS, PeakMean
from gaitcal.gait.profile_score import Score, compute_profile_scores
from gaitcal.io.result_folder import MANIFEST, read_json_object
from gaitcal.model.model_file import load_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results import cycle_tables, stride_files
from gaitcal.results.normal_curves import (
    NO_NORM,
    NormTables,
    build_norm_tables,
    read_norm_tables,
    write_normal_curves,
)
from gaitcal.results.saved_result import MODEL
from gaitcal.results.stride_tables import StrideTables, build_stride_tables
from gaitcal.results.stride_uses import read_uses
from gaitcal.results.summary import SUMMARY, get_table, summarise_calibration
from gaitcal.results.table_files import (
    Column,
    convert_to_columns,
    format_json,
    read_rows,
    write_csv,
)

PARAMETERS: Final = "parameters.csv"


RESULT: Final = "result"
"""Key of the manifest of further trials: relative path of the result with their model."""


@dataclass(frozen=True, kw_only=True)
class ResultTables:
    """Tables of a result, or of its further trials."""

    model: SubjectModel
    strides: StrideTables
    summary: Mapping[str, Any]  # Content of `summary.json`
    manifest: Mapping[str, Any] = field(default_factory=dict)  # Content of `manifest.json`
    parameters: Mapping[str, Column] = field(default_factory=dict)
    """Columns of `parameters.csv`; empty for further trials."""
    norm: NormTables = NO_NORM
    scores: tuple[Score, ...] = ()
    """Gait Variable Scores and Gait Profile Scores, deg."""


def build_result_tables(
    calibration: Calibration, norm: Norm | None = None, manifest: Mapping[str, Any] | None = None
) -> ResultTables:
    """Build all tables of a calibration.

    Parameters
    ----------
    calibration
        A finished calibration.
    norm
        Normative data; None: none.
    manifest
        Versions, settings and input hashes.

    Returns
    -------
    ResultTables
        With the curves of each trial over time.
    """
    model, relative_to = calibration.model, calibration.relative_to
    strides = build_stride_tables(model, calibration.trials, relative_to, calibration.truth)
    norms = NO_NORM if norm is None else build_norm_tables(norm, model.subject)
    # Normative curves are of anatomical angles, not of angles relative to the static posture
    scores = (
        ()
        if norm is None or relative_to
        else compute_profile_scores(strides.cycles, norm.bands, model.subject)
    )
    return ResultTables(
        model=model,
        strides=strides,
        summary=summarise_calibration(calibration) | stride_files.summarise_profile(norms, scores),
        manifest=manifest or {},
        parameters=convert_to_columns(list_parameter_rows(calibration)),
        norm=norms,
        scores=scores,
    )


def write_result_tables(tables: ResultTables, folder: Path) -> None:
    """Write manifest, summary, parameters, stride files, scores and normative curves.

    Parameters
    ----------
    tables
        From `build_result_tables`.
    folder
        The result folder that is being written.
    """
    write_csv(tables.parameters, folder / PARAMETERS)
    stride_files.write_stride_files(folder, tables.strides)
    stride_files.write_profile(folder, tables.norm, tables.scores)
    write_normal_curves(tables.norm, folder)
    for name, content in ((MANIFEST, tables.manifest), (SUMMARY, tables.summary)):
        (folder / name).write_text(format_json(dict(content)), encoding="utf-8")


def read_result_tables(folder: Path) -> ResultTables:
    """Read the tables of a result, or of a folder of its further trials.

    Parameters
    ----------
    folder
        A result of `gaitcal calibrate`, or a folder of `gaitcal dynamics`. Model and normative data
        of further trials are those of their result, which their manifest names.

    Returns
    -------
    ResultTables
        Without curves over time and peaks of single strides, which no file has.

    Raises
    ------
    InputError
        The folder is no result, an earlier version wrote it, or a file is damaged.
    """
    manifest, summary = (read_json_object(folder / name) for name in (MANIFEST, SUMMARY))
    if not manifest:
        message = f"is no result of 'gaitcal calibrate' or 'gaitcal dynamics': has no {MANIFEST}"
        raise InputError(message, source=folder, code=Code.NO_RESULT)
    calibrated = folder
    # Further trials: the model is in the folder of their calibration.
    if not (folder / MODEL).exists():
        calibrated = (folder.resolve() / str(manifest.get(RESULT, ".."))).resolve()
    if not (calibrated / MODEL).exists():
        message = f"its calibration is not found: no {MODEL} in {calibrated}; run dynamics again"
        raise InputError(message, source=folder, code=Code.NO_RESULT)
    model, uses = load_model(calibrated / MODEL), read_uses(folder)
    cycles = cycle_tables.read_cycles(folder)
    strides = StrideTables(
        subject=model.subject,
        cycles={name: cycles[name].to_numpy() for name in CYCLE_COLUMNS},
        uses=uses,
        peaks=read_rows(folder / stride_files.PEAKS, PEAK_COLUMNS, _parse_peaks),
    )
    of_result = summary if calibrated is folder else read_json_object(calibrated / SUMMARY)
    return ResultTables(
        model=model,
        strides=strides,
        summary=summary,
        manifest=manifest,
        parameters=_read_parameters(folder / PARAMETERS),
        norm=read_norm_tables(calibrated, of_result),
        scores=_parse_scores(summary),
    )


def _parse_peaks(rows: Iterable[Mapping[str, str]]) -> tuple[PeakMean, ...]:
    """Parse the rows of `peaks.csv`, column -> text."""
    known = PEAKS | PHASE_PEAKS
    return tuple(
        PeakMean(
            activity=row["activity"],
            peak=known[row["peak"]],
            side=row["side"],
            n=int(row["n"]),
            strides=int(row["strides"]),
            mean=float(row["mean"]),
            sd=float(row["sd"] or "nan"),
            se=float(row["se"] or "nan"),
            percent=float(row["percent"] or "nan"),
        )
        for row in rows
    )


def _read_parameters(path: Path) -> dict[str, Column]:
    if not path.exists():
        return {}
    import pandas as pd

    table = pd.read_csv(path, comment="#")
    return {str(name): table[name].to_numpy() for name in table}


def _parse_scores(summary: Mapping[str, Any]) -> tuple[Score, ...]:
    """Parse the scores in `summary.json`."""
    return tuple(
        Score(
            side=side,
            variable=name,
            score=float(figures.get("score", np.nan)),
            error=float(figures.get("se", np.nan)),
            norm=float(figures.get("norm", np.nan)),
            strides=int(figures["strides"]),
        )
        for side, of_side in get_table(summary, "gait_profile").items()
        for name, figures in of_side.items()
    )
