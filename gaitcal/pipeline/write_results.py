"""The result folder of a calibration, written whole or not at all, and its page, which is read back
and joined with those of further trials. `saved.py` reads back what further trials need.
"""

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gaitcal.analysis.parameter_table import parameter_rows
from gaitcal.analysis.result import Calibration, Loads, TrialResult
from gaitcal.export import other_formats
from gaitcal.export.opensim import osim_writer
from gaitcal.gait.normal_bands import Bands, Norm, norm_for, own_norm
from gaitcal.gait.profile_score import profile_scores
from gaitcal.io import opensim_files, toml
from gaitcal.io.result_folder import MANIFEST, ResultKind, write_result_folder
from gaitcal.model import model_file, parameters
from gaitcal.model.marker_set import marker_set_text
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page.page_data import calibration_page_data
from gaitcal.report.page.page_folder import write_page
from gaitcal.report.page.scene import scene_of
from gaitcal.results import saved_result, stride_files, trial_tables
from gaitcal.results.summary import subject_summary, summary, write_kinetics, write_truth
from gaitcal.results.table_files import Json, columns_of, json_text, refused_lines, write_csv
from gaitcal.runtime import with_one_blas_thread

VERSIONED = ("gaitcal", "pin", "numpy", "scipy", "ezc3d", "pandas")


@with_one_blas_thread
def write_results(
    calibration: Calibration,
    folder: Path | str,
    settings: Mapping[str, Json] | None = None,
    *,
    drafted: str | None = None,
    normal: Bands | None = None,
) -> Path:
    """Write everything a calibration gives into `folder`, whole or not at all. Returns the folder.

    Parameters
    ----------
    calibration
        From `gaitcal.calibrate`.
    folder
        Replaced if an earlier calibration is there; what `gaitcal montecarlo`, `dynamics` and
        `export` put into it is kept.
    settings
        Further entries of `manifest.json`, beside those of the study.
    drafted
        Text of the study file that was drafted from a folder of recordings; kept as `study.toml`.
    normal
        Bands of healthy people (`gaitcal.read_normal_bands`), drawn behind angles and moments.

    Raises
    ------
    InputError
        The folder cannot be written, or holds an input of the study, another kind of result, or
        files that are not ours.
    """
    folder = Path(folder)
    with write_result_folder(folder, ResultKind.CALIBRATION, calibration.study.files) as out:
        if drafted is not None:
            (out / "study.toml").write_text(drafted, encoding="utf-8")
        write_csv(columns_of(parameter_rows(calibration)), out / "parameters.csv")
        marker_set = calibration.study.marker_set.with_weights(calibration.study.weights)
        (out / saved_result.MARKER_SET).write_text(marker_set_text(marker_set), encoding="utf-8")
        strides = stride_files.write_stride_files(
            out, calibration.model, calibration.trials, calibration.relative_to
        )
        norm = _norm(calibration, normal, settings)
        # angles from the static posture are no anatomical ones: no healthy people's curves are
        # those
        scores = (
            profile_scores(strides, norm.bands, calibration.model.subject)
            if not calibration.relative_to
            else ()
        )
        content = manifest(calibration, settings)
        (out / MANIFEST).write_text(json_text(content), encoding="utf-8")
        write_page(
            out, scene_of(calibration), calibration_page_data(calibration, norm, content, scores)
        )
        stride_files.write_profile(out, norm, scores)
        write_truth(calibration.truth, out)
        for trial in calibration.trials:
            write_trial(trial, calibration.model, out, calibration.relative_to)
        told_of_all = summary(calibration) | stride_files.profile_summary(norm, scores)
        (out / "summary.json").write_text(json_text(told_of_all), encoding="utf-8")
        saved_result.save_uncertainty(calibration.uncertainty, out / saved_result.UNCERTAINTY)
        _models(calibration.model, out)
        _save_splines(calibration.trials, out / "splines.npz")
    return folder


def _norm(
    calibration: Calibration, normal: Bands | None, settings: Mapping[str, Json] | None
) -> Norm:
    """Of those that the user names, else what gaitcal brings for that age and speed; none beside
    angles of its own.
    """
    subject = calibration.model.subject
    if normal is not None:
        return own_norm(normal, str((settings or {}).get("normal", "")), subject)
    if calibration.relative_to:
        return Norm(remark="No norm: angles are counted from the static posture.")
    return norm_for(
        subject, stride_files.mean_speed(stride_files.means_summary(calibration.trials))
    )


def manifest(
    calibration: Calibration, settings: Mapping[str, Json] | None = None
) -> dict[str, Json]:
    """Versions, settings and input hashes of a result."""
    subject, prior = calibration.model.subject, calibration.study.joint_prior
    leaning = {} if prior is None else {"priors_sha256": prior.sha256}
    return {
        "gaitcal": toml.get_package_version("gaitcal"),
        "versions": {name: toml.get_package_version(name) for name in VERSIONED}
        | {"python": platform.python_version()},
        "subject": subject_summary(subject),
        "marker_set": calibration.study.marker_set.name,
        "rename": dict(calibration.study.rename),
        "settings": json.loads(calibration.study.settings.model_dump_json())
        | leaning
        | dict(settings or {}),
        "trials": {
            trial.name: {**calibration.study.get_input_names(trial)}
            for trial in calibration.study.trials
        },
        "inputs_sha256": dict(calibration.study.inputs),
        "inputs_changed_while_it_ran": list(calibration.study.find_changed_inputs()),
    }


def _models(model: SubjectModel, out: Path) -> None:
    model_file.save_model(model, out / saved_result.MODEL)
    osim_writer.write_osim(model, out / "model.osim")
    other_formats.write_urdf(model, out / "model.urdf")
    if not parameters.impossible_bodies(
        model.parameters.inertial
    ):  # a warning of the calibration tells
        other_formats.write_mjcf(model, out / "model.xml")


def write_trial(
    trial: TrialResult,
    model: SubjectModel,
    out: Path,
    relative_to: Mapping[str, float] | None = None,
) -> None:
    """Motion, marker errors and markers of a trial; with force plates also torques and ground
    reactions.

    `relative_to`: coordinate -> rad in the static posture, from which the table counts joint
    angles; the .mot, which moves `model.osim`, never does.
    """
    for name in ("motion", "marker_errors", "markers"):
        (out / name).mkdir(exist_ok=True)
    body, refused = trial.body, refused_lines(trial)
    other_formats.write_mot(
        out / "motion" / f"{trial.name}.mot", body.time, body.coordinates, body.q
    )
    header = (
        trial_tables.COORDINATE_HEADER
        if relative_to is None
        else (*trial_tables.COORDINATE_HEADER, *trial_tables.relative_header(relative_to))
    )
    coordinates = body.columns(trial.coordinate_errors, relative_to)
    write_csv(coordinates, out / "motion" / f"{trial.name}.csv", (*refused, *header))
    part = "the segments of its joint alone" if trial.joint else "the whole body"
    write_csv(
        trial_tables.marker_error_table(trial),
        out / "marker_errors" / f"{trial.name}.csv",
        (f"distance between measured and model marker, mm, fit of {part}; empty: not seen",),
    )
    opensim_files.write_trc(out / "markers" / f"{trial.name}.trc", trial.recording)
    if trial.loads is not None:
        _write_loads(trial, trial.loads, model, out)


def _write_loads(trial: TrialResult, loads: Loads, model: SubjectModel, out: Path) -> None:
    for name in ("moments", "forces"):
        (out / name).mkdir(exist_ok=True)
    body, refused = trial.body, refused_lines(trial)
    write_csv(
        trial_tables.moment_table(loads),
        out / "moments" / f"{trial.name}.csv",
        (*refused, *trial_tables.MOMENT_HEADER),
    )
    other_formats.write_sto_moments(
        out / "moments" / f"{trial.name}.sto",
        body.time,
        loads.final.tau,
        body.coordinates,
        comments=(
            *refused,
            *(line for line in trial_tables.MOMENT_HEADER if line.startswith("valid")),
        ),
    )
    other_formats.write_external_loads(
        out / "forces", body.time, loads.reactions.wrench, stem=trial.name
    )
    write_kinetics(trial, model, out)


def _save_splines(trials: Sequence[TrialResult], path: Path) -> None:
    """Whole-body motions as splines, with the ground reactions: what a Monte Carlo study starts
    from.
    """
    arrays: dict[str, np.ndarray] = {"trials": np.array([t.name for t in trials], dtype=str)}
    for k, t in enumerate(trials):
        arrays |= {
            f"time_{k}": t.body.time,
            f"knots_{k}": t.body.basis.knots,
            f"nodes_{k}": t.body.coefficients,
        }
        if t.loads is not None:
            arrays |= {
                f"wrench_{k}": t.loads.reactions.wrench,
                f"valid_{k}": t.loads.reactions.valid,
            }
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
