"""The figures of `summary.json`: fit quality, residuals, phases. A figure that does not exist is absent, never 0.

Joint powers and moment vectors of a trial in a result folder: written, and read back for exports.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.faults.verdict import Verdict
from gaitcal.gait.moments import moment_of
from gaitcal.model.linkage import COORDINATES, LOWER_BODY, REACTIONS, SEGMENTS, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.stride_files import means_summary
from gaitcal.results.table_file import Json, refused_lines, write_csv
from gaitcal.results.truth import truth_summary
from gaitcal.results.verdict import verdict_summary, walk_summary
from gaitcal.session.result import Calibration, Loads, TrialResult
from gaitcal.session.tables import POWER_HEADER, VECTOR_HEADER, power_table, vector_table

if TYPE_CHECKING:
    import pandas as pd

NO_FLOOR = 1e-6
"""mm: one or two markers follow a segment exactly; a ratio to that means nothing."""

SHARE_DIGITS = 4
TIME_DIGITS = 4
"""s: a tenth of a millisecond."""
JOINT_PRIOR = "joint_prior"
"""Entry: the cohort that joint parameters lean on; absent where that is none."""
STATIC_ANGLES = "static_angles_deg"
"""Entry: coordinate -> deg with which the calibrated model meets the static posture."""


def summary(calibration: Calibration) -> dict[str, Json]:
    """The content of `summary.json` (mm, N, N·m, s)."""
    return {
        "status": "converged" if calibration.converged else "not converged",
        **verdict_summary(calibration.verdict),
        "warnings": list(calibration.warnings),
        "notes": list(calibration.notes),
        **_joint_prior(calibration),
        "trials": {trial.name: trial_summary(trial, calibration.verdict) for trial in calibration.trials},
        **({"spatiotemporal": means} if (means := means_summary(calibration.trials)) else {}),
        STATIC_ANGLES: {
            name: round(float(np.rad2deg(value)), 4) + 0.0  # no negative zeros
            for name, value in calibration.static_angles.items()
            if not is_translation(name)
        },
        "phases": [
            {
                "name": phase.name,
                "trials": list(phase.trials),
                "parameters": phase.parameters,
                "iterations": phase.iterations,
                "seconds": round(phase.seconds, 4),
                "status": phase.status,
                "message": phase.message,
                **({} if phase.marker_noise is None else {"marker_noise_mm": round(1e3 * phase.marker_noise, 4)}),
                **({"noise_mm": {name: round(1e3 * nu, 4) for name, nu in phase.noise.items()}} if phase.noise else {}),
            }
            for phase in calibration.phases
        ],
        **({} if calibration.truth is None else {"truth": truth_summary(calibration.truth)}),
    }


def _joint_prior(calibration: Calibration) -> dict[str, Json]:
    prior = calibration.study.joint_prior
    if prior is None:
        return {}
    return {JOINT_PRIOR: {"file": prior.file, "people": prior.people, "left_out": prior.left_out}}


def trial_summary(trial: TrialResult, verdict: Verdict) -> dict[str, Json]:
    """One trial's entry: verdict, markers, segments, residuals, torque changes."""
    errors = trial.calibrated.errors
    out: dict[str, Json] = {
        "role": trial.role.value,
        **walk_summary(verdict, trial.name),
        "frames": len(trial.calibrated.time),
        "markers": len(errors.labels),
        "weighted_markers": int(errors.kept().sum()),
        "nodes": trial.calibrated.basis.nodes,
        "rms_mm": _rms(trial),
    }
    if trial.bandwidth:
        out["bandwidth_hz"] = round(trial.bandwidth.motion_hz, 3)
        out["bandwidth_by"] = trial.bandwidth.by.value
    if trial.joint:
        out["joint"] = trial.joint
    else:
        out["pelvis_and_legs_mm"] = _rms(trial, *LOWER_BODY)
    if trial.held_out:
        held = trial.held_out
        out["hold_out_mm"] = {"nominal": 1e3 * held.nominal, "calibrated": 1e3 * held.calibrated, "folds": held.folds}
        if held.legs:
            out["pelvis_and_legs_hold_out_mm"] = {"nominal": 1e3 * held.legs[0], "calibrated": 1e3 * held.legs[1]}
    nominal, calibrated = trial.nominal.errors.largest(), errors.largest()
    if nominal and calibrated:
        out["max_mm"] = {"nominal": 1e3 * nominal[0], "calibrated": 1e3 * calibrated[0], "marker": calibrated[1]}
    out["segments"] = {
        segment: {"markers": int(errors.kept(segment).sum()), "rms_mm": _rms(trial, segment)}
        for segment in SEGMENTS
        if errors.kept(segment).any()
    }
    if trial.joint_floor is not None:
        out["joint_floor_mm"] = {joint: 1e3 * value for joint, value in trial.joint_floor.joints.items()}
    if trial.joint is None:
        out["events"] = [
            {"side": e.side, "event": e.moment.value, "time": round(e.time, TIME_DIGITS), "source": e.source.value}
            for e in trial.events.events
        ]
        if trial.strides:
            out["spatiotemporal"] = means_summary([trial])
    if trial.loads is not None:
        reactions = trial.loads.reactions
        out["valid_frames"] = int(reactions.valid.sum())
        out["valid_frames_r"], out["valid_frames_l"] = int(reactions.valid_r.sum()), int(reactions.valid_l.sum())
        if reactions.valid.any():
            out["pelvis_residual"] = _pelvis_residual(trial.loads)
            if (due := trial.loads.expected) is not None:
                out["pelvis_residual_expected"] = {"force_N": due.force.expected, "torque_Nm": due.moment.expected}
                out["pelvis_residual_limit"] = {"force_N": due.force.limit, "torque_Nm": due.moment.limit}
        if reactions.has_torques:
            out["torque_change_bwh"] = _torque_change(trial.loads)
            if sources := _error_sources(trial.loads):
                out["torque_error_sources"] = sources
    return out


def _rms(trial: TrialResult, *segments: str) -> dict[str, Json]:
    nominal, calibrated, floor = trial.rms_mm(*segments)
    joint_floor = trial.joint_floor_mm(*segments)
    out: dict[str, Json] = {"nominal": nominal, "calibrated": calibrated, "rigid_floor": floor}
    if joint_floor is not None:
        out["joint_floor"] = joint_floor
    for name, least in (("calibrated_to_floor", floor), ("calibrated_to_joint_floor", joint_floor)):
        if calibrated is not None and least is not None and least > NO_FLOOR:
            out[name] = calibrated / least
    if trial.final is not trial.calibrated:
        final = trial.final.errors.rms(*segments)
        out["final_model"] = None if final is None else 1e3 * final
    return out


def _torque_change(loads: Loads) -> dict[str, Json]:
    """RMS over valid frames of final minus nominal torque, percent of body weight times height."""
    out: dict[str, Json] = {}
    for name in (*COORDINATES, *REACTIONS):
        valid = loads.reactions.valid_for(name)
        if not name.startswith("pelvis") and valid.any():
            change = 100.0 * (moment_of(loads.final, name) - moment_of(loads.nominal, name)) / loads.final.bwh
            out[name] = float(np.sqrt((change[valid] ** 2).mean()))
    return out


def _error_sources(loads: Loads) -> dict[str, Json]:
    """Part of the variance of each torque that each source of error makes, over valid frames; they sum to 1."""
    out: dict[str, Json] = {}
    for column, name in enumerate(FORCES):
        shares = loads.errors.shares(column, loads.reactions.valid_for(name)) if loads.errors else {}
        if shares and not name.startswith("pelvis"):
            out[name] = {source.key: round(share, SHARE_DIGITS) for source, share in shares.items()}
    return out


def _pelvis_residual(loads: Loads) -> dict[str, Json]:
    out: dict[str, Json] = {}
    for stage, moments in loads.moments.items():
        force, torque = moments.residual_rms(loads.reactions.valid)
        out[stage.key] = {"force_N": force, "torque_Nm": torque}
    return out


POWER_FOLDER, VECTOR_FOLDER = "powers", "moment_vectors"
DIGITS = 6
"""A millionth of a watt or newton metre."""


def write_kinetics(trial: TrialResult, model: SubjectModel, out: Path) -> None:
    """`powers/TRIAL.csv` and `moment_vectors/TRIAL.csv` of a trial with force plates; else nothing."""
    loads = trial.loads
    if loads is None or loads.kinetics is None:
        return
    of_powers = power_table(loads, loads.kinetics, model.subject.mass)
    of_vectors = vector_table(loads, loads.kinetics)
    tables = ((POWER_FOLDER, of_powers, POWER_HEADER), (VECTOR_FOLDER, of_vectors, VECTOR_HEADER))
    for folder, table, header in tables:
        (out / folder).mkdir(exist_ok=True)
        write_csv(_short(table), out / folder / f"{trial.name}.csv", (*refused_lines(trial), *header))


def read_vectors(folder: Path, trial: str) -> pd.DataFrame | None:
    """The moment vectors of a trial of a result; None where there are none: no force plates."""
    import pandas as pd

    path = folder / VECTOR_FOLDER / f"{trial}.csv"
    return pd.read_csv(path, comment="#") if path.exists() else None


def _short(table: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Rounded, but for the time."""
    return {name: values if name == "time" else np.round(values, DIGITS) for name, values in table.items()}
