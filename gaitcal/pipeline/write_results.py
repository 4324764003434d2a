"""Write the result folder of a calibration, whole or not at all.

`results/saved_result.py` reads it back for further trials.
"""

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gaitcal.analysis.result import Calibration, Loads, TrialResult
from gaitcal.export import other_formats
from gaitcal.export.opensim import osim_writer
from gaitcal.gait.normal_bands import Bands, Norm, make_user_norm, select_norm
from gaitcal.io import opensim_files, toml
from gaitcal.io.result_folder import ResultKind, write_result_folder
from gaitcal.model import model_file, parameters
from gaitcal.model.marker_set import format_marker_set
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page.page_data import build_calibration_page_data
from gaitcal.report.page.page_folder import write_page
from gaitcal.report.page.scene import Scene, build_person_scene, build_trial_scene
from gaitcal.results import saved_result, trial_tables
from gaitcal.results.result_tables import build_result_tables, write_result_tables
from gaitcal.results.stride_tables import compute_mean_speed, summarise_means
from gaitcal.results.summary import summarise_subject, write_kinetics, write_truth
from gaitcal.results.table_files import Json, format_refused_lines, write_csv
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
    """Write a calibration to a result folder, whole or not at all.

    Parameters
    ----------
    calibration
        From `gaitcal.calibrate`.
    folder
        Replaces an earlier calibration; additions of `gaitcal montecarlo`, `dynamics` and `export`
        are kept.
    settings
        Further entries of `manifest.json`, beside those of the study.
    drafted
        Text of the study file that was drafted from a folder of recordings; kept as `study.toml`.
    normal
        Normative data (`gaitcal.read_normal_bands`), drawn behind angles and moments.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        The folder cannot be written, or contains an input of the study, another kind of result, or
        files of another program.
    """
    folder = Path(folder)
    with write_result_folder(folder, ResultKind.CALIBRATION, calibration.study.files) as out:
        if drafted is not None:
            (out / "study.toml").write_text(drafted, encoding="utf-8")
        marker_set = calibration.study.marker_set.with_weights(calibration.study.weights)
        (out / saved_result.MARKER_SET).write_text(format_marker_set(marker_set), encoding="utf-8")
        # Page and CSV files are made of the same tables, so that they cannot differ.
        tables = build_result_tables(
            calibration,
            _choose_norm(calibration, normal, settings),
            _build_manifest(calibration, settings),
        )
        write_result_tables(tables, out)
        write_page(out, _build_scene(calibration), build_calibration_page_data(calibration, tables))
        write_truth(calibration.truth, out)
        for trial in calibration.trials:
            write_trial(trial, calibration.model, out, calibration.relative_to)
        saved_result.save_uncertainty(calibration.uncertainty, out / saved_result.UNCERTAINTY)
        _write_models(calibration.model, out)
        _save_splines(calibration.trials, out / "splines.npz")
    return folder


def _build_scene(calibration: Calibration) -> Scene:
    model = calibration.model
    trials = []
    for t in calibration.trials:
        reactions = None if t.loads is None else t.loads.reactions
        trials.append(
            build_trial_scene(model, t.name, t.role.value, t.body, t.recording, reactions)
        )
    return build_person_scene(model, tuple(trials), calibration.standard_errors)


def _choose_norm(
    calibration: Calibration, normal: Bands | None, settings: Mapping[str, Json] | None
) -> Norm:
    """Choose the user's normative data, else the built-in ones; none for relative angles."""
    subject = calibration.model.subject
    if normal is not None:
        return make_user_norm(normal, str((settings or {}).get("normal", "")), subject)
    if calibration.relative_to:
        return Norm(remark="No normative data: joint angles are relative to the static posture.")
    return select_norm(subject, compute_mean_speed(summarise_means(calibration.trials)))


def _build_manifest(
    calibration: Calibration, settings: Mapping[str, Json] | None = None
) -> dict[str, Json]:
    """Build the manifest of a result: versions, settings and input hashes.

    `settings`: further entries of `settings`. Returns: content of `manifest.json`.
    """
    subject, prior = calibration.model.subject, calibration.study.joint_prior
    prior_entry = {} if prior is None else {"priors_sha256": prior.sha256}
    return {
        "gaitcal": toml.get_package_version("gaitcal"),
        "versions": {name: toml.get_package_version(name) for name in VERSIONED}
        | {"python": platform.python_version()},
        "subject": summarise_subject(subject),
        "marker_set": calibration.study.marker_set.name,
        "rename": dict(calibration.study.rename),
        "settings": json.loads(calibration.study.settings.model_dump_json())
        | prior_entry
        | dict(settings or {}),
        "trials": {
            trial.name: {**calibration.study.input_names(trial)}
            for trial in calibration.study.trials
        },
        "inputs_sha256": dict(calibration.study.inputs),
        "inputs_changed_while_it_ran": list(calibration.study.changed_inputs()),
    }


def _write_models(model: SubjectModel, out: Path) -> None:
    """Write the model in our format and for OpenSim, ROS and MuJoCo."""
    model_file.save_model(model, out / saved_result.MODEL)
    osim_writer.write_osim(model, out / "model.osim")
    other_formats.write_urdf(model, out / "model.urdf")
    # MuJoCo rejects impossible bodies; a warning of the calibration reports them
    if not parameters.find_impossible_bodies(model.parameters.inertial):
        other_formats.write_mjcf(model, out / "model.xml")


def write_trial(
    trial: TrialResult,
    model: SubjectModel,
    out: Path,
    relative_to: Mapping[str, float] | None = None,
) -> None:
    """Write the files of a trial: motion, markers and, with force plates, torques and reactions.

    Parameters
    ----------
    trial
        The trial.
    model
        Fitted model.
    out
        Result folder.
    relative_to
        Coordinate -> angle (rad) in the static posture, subtracted from joint angles of the table.
        The .mot file is for `model.osim` and is never relative.
    """
    for name in ("motion", "marker_errors", "markers"):
        (out / name).mkdir(exist_ok=True)
    body, refused = trial.body, format_refused_lines(trial)
    other_formats.write_mot(
        out / "motion" / f"{trial.name}.mot", body.time, body.coordinates, body.q
    )
    header = (
        trial_tables.COORDINATE_HEADER
        if relative_to is None
        else (*trial_tables.COORDINATE_HEADER, *trial_tables.format_relative_header(relative_to))
    )
    coordinates = body.columns(trial.coordinate_errors, relative_to)
    write_csv(coordinates, out / "motion" / f"{trial.name}.csv", (*refused, *header))
    part = "the segments of its joint only" if trial.joint else "the whole body"
    write_csv(
        trial_tables.build_marker_error_table(trial),
        out / "marker_errors" / f"{trial.name}.csv",
        (f"distance between measured and model marker, mm, fit of {part}; empty: not visible",),
    )
    opensim_files.write_trc(out / "markers" / f"{trial.name}.trc", trial.recording)
    if trial.loads is not None:
        _write_loads(trial, trial.loads, model, out)


def _write_loads(trial: TrialResult, loads: Loads, model: SubjectModel, out: Path) -> None:
    """Write moments, forces and joint kinetics of a trial."""
    for name in ("moments", "forces"):
        (out / name).mkdir(exist_ok=True)
    body, refused = trial.body, format_refused_lines(trial)
    write_csv(
        trial_tables.build_moment_table(loads),
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
    """Save whole-body motions as splines with ground reactions, as a Monte Carlo study needs."""
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
