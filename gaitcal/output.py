"""The result folder of a calibration, written whole or not at all."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.atomic import atomic_directory
from gaitcal.export import write_external_loads, write_mjcf, write_mot, write_osim, write_sto_moments, write_urdf
from gaitcal.model.model_file import save_model
from gaitcal.motion.motion import Motion
from gaitcal.recording import write_trc
from gaitcal.report import write_report
from gaitcal.study.result import Calibration, TrialResult
from gaitcal.study.summary import Json, summary
from gaitcal.study.tables import (
    MOMENT_HEADER,
    coordinate_table,
    marker_error_table,
    moment_table,
    parameter_table,
)
from gaitcal.view import save_scene, scene_of, write_view

VERSIONED = ("gaitcal", "pin", "numpy", "scipy", "ezc3d", "pandas")


def write_results(calibration: Calibration, folder: Path | str, settings: Mapping[str, Json] | None = None) -> Path:
    """Write everything a calibration gives into `folder` (replaced if an earlier result is there).

    Raises
    ------
    InputError
        The folder cannot be written, or holds files that are not ours.
    """
    folder = Path(folder)
    made = manifest(calibration, settings)
    with atomic_directory(folder) as out:
        (out / "manifest.json").write_text(_json(made), encoding="utf-8")
        (out / "summary.json").write_text(_json(summary(calibration)), encoding="utf-8")
        _csv(parameter_table(calibration), out / "parameters.csv")
        _models(calibration, out)
        for trial in calibration.trials:
            _trial(calibration, trial, out)
        save_uncertainty(calibration, out / "uncertainty.npz")
        save_scene(scene_of(calibration), out / "scene.npz")
        write_view(calibration, out / "view.html")
        write_report(calibration, out / "report.html", manifest=made)
    return folder


def manifest(calibration: Calibration, settings: Mapping[str, Json] | None = None) -> dict[str, Json]:
    """Versions, settings and input hashes of a result."""
    subject = calibration.model.subject
    return {
        "gaitcal": _version("gaitcal"),
        "versions": {name: _version(name) for name in VERSIONED} | {"python": platform.python_version()},
        "subject": {
            "name": subject.name,
            "mass_kg": subject.mass,
            "height_m": subject.height,
            "sex": subject.sex,
        },
        "marker_set": calibration.study.marker_set.name,
        "settings": json.loads(calibration.study.settings.model_dump_json()) | dict(settings or {}),
        "inputs_sha256": dict(calibration.study.inputs),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def _json(content: Json) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _csv(table: pd.DataFrame, path: Path, comments: tuple[str, ...] = ()) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {line}\n" for line in comments)
        table.to_csv(stream, index=False, lineterminator="\n")


def _models(calibration: Calibration, out: Path) -> None:
    save_model(calibration.model, out / "model.toml")
    writers: dict[str, Callable[..., object]] = {"osim": write_osim, "urdf": write_urdf, "xml": write_mjcf}
    for suffix, write in writers.items():
        write(calibration.model, out / f"model.{suffix}")


def _trial(calibration: Calibration, trial: TrialResult, out: Path) -> None:
    for name in ("motion", "marker_errors", "markers"):
        (out / name).mkdir(exist_ok=True)
    write_motion(trial.body, out / "motion", trial.name)
    _csv(
        marker_error_table(trial),
        out / "marker_errors" / f"{trial.name}.csv",
        (
            "distance between measured and model marker, mm; calibrated model; empty: not seen",
            "isolated trial: fit of the segments of its joint alone" if trial.joint else "fit of the whole body",
        ),
    )
    write_trc(out / "markers" / f"{trial.name}.trc", trial.recording)
    if trial.loads is not None:
        write_moments(calibration, trial, out)


def write_motion(motion: Motion, folder: Path, name: str) -> None:
    """`NAME.mot` for OpenSim, and `NAME.csv` with velocities and accelerations."""
    write_mot(folder / f"{name}.mot", motion.time, motion.coordinates, motion.q)
    _csv(
        coordinate_table(motion),
        folder / f"{name}.csv",
        ("coordinates in degrees and m, _velocity per s, _acceleration per s^2; exact derivatives of the splines",),
    )


def write_moments(calibration: Calibration, trial: TrialResult, out: Path) -> None:
    """Generalised forces and the ground reactions behind them, for one trial with force plates."""
    loads = trial.loads
    if loads is None:
        return
    for name in ("moments", "forces"):
        (out / name).mkdir(exist_ok=True)
    table = moment_table(loads, trial.body, calibration.model.subject.bwh)
    _csv(table, out / "moments" / f"{trial.name}.csv", MOMENT_HEADER)
    comments = tuple(line for line in MOMENT_HEADER if line.startswith("valid"))
    write_sto_moments(
        out / "moments" / f"{trial.name}.sto", trial.body.time, loads.final.tau, trial.body.coordinates, comments=comments
    )
    write_external_loads(out / "forces", trial.body.time, loads.reactions.wrench, stem=trial.name)


def save_uncertainty(calibration: Calibration, path: Path) -> None:
    """What further trials need to get standard errors: influences on the joint parameters, spread of the inertial."""
    spread = calibration.uncertainty
    np.savez_compressed(
        path,
        joint_free=np.array(spread.joint_free, dtype=str),
        joint=spread.joint,
        inertial=spread.inertial,
    )


