"""What a result folder says of its trials: the figures of `summary.json` (one that does not exist
is absent, never 0), the tables of joint powers and moment vectors, and, where it is known, the
truth (`truth/`).

The verdict in `summary.json`: written with a result, read back for what stands on its model.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitcal.analysis.fit_findings import is_trunk_unmeasured
from gaitcal.analysis.result import Calibration, Loads, TrialResult
from gaitcal.analysis.truth_errors import CurveTruth, FeatureTruth, TruthErrors
from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.errors import STUDY, Code, Finding, InputError, Severity
from gaitcal.gait.moments import moment_of
from gaitcal.io.result_folder import read_json_object
from gaitcal.model.linkage import COORDINATES, LOWER_BODY, REACTIONS, SEGMENTS, is_translation
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.quality.verdict import Judgement, Verdict, touches_model
from gaitcal.results.stride_files import means_summary
from gaitcal.results.table_files import Json, columns_of, refused_lines, write_csv
from gaitcal.results.trial_tables import POWER_HEADER, VECTOR_HEADER, power_table, vector_table
from gaitcal.study.declared_truth import MOMENTS_SUFFIX, MOTION_SUFFIX

if TYPE_CHECKING:
    import pandas as pd

FOLDER = "truth"
PARAMETERS_HEADER = (
    "what is known to be true beside what was calibrated, told in the same segment frames; error: "
    "fitted minus truth",
    "z: error in standard errors; of honest ones 95 of 100 are below 1.96",
)
MOTION_HEADER = (
    "true coordinates in degrees and m at the frames of motion/TRIAL.csv, from the anatomical zero",
    "_error: calibrated minus true; empty: the truth has no such instant",
)
MOMENTS_HEADER = (
    "true generalised forces in N m (pelvis_tx, _ty, _tz: N) at the frames of moments/TRIAL.csv",
    "_error: calibrated minus true, empty in frames that do not count (valid_r, valid_l, valid)",
)


def write_truth(truth: TruthErrors | None, out: Path) -> None:
    """Write `truth/parameters.csv`, `truth/TRIAL_motion.csv` and `truth/TRIAL_moments.csv`; nothing
    if None.
    """
    if truth is None:
        return
    folder = out / FOLDER
    folder.mkdir(exist_ok=True)
    rows = [
        {
            "name": p.name,
            "kind": p.kind,
            "unit": p.unit,
            "truth": p.truth,
            "nominal": p.nominal,
            "fitted": p.fitted,
            "standard_error": p.error_bar,
            "error": p.error,
            "z": p.z,
            "status": p.status,
        }
        for p in truth.parameters
    ]
    write_csv(columns_of(rows), folder / "parameters.csv", PARAMETERS_HEADER)
    for name, trial in truth.trials.items():
        for curves, time, ending, header in (
            (trial.coordinates, trial.time, MOTION_SUFFIX, MOTION_HEADER),
            (trial.forces, trial.time, MOMENTS_SUFFIX, MOMENTS_HEADER),
        ):
            if curves:
                write_csv(_curve_table(time, curves), folder / (name + ending), header)


def _curve_table(time: Array, curves: Mapping[str, CurveTruth]) -> dict[str, Array]:
    columns = {"time": time}
    for name, curve in curves.items():
        columns[name] = curve.truth
        columns[f"{name}_error"] = np.where(curve.compared, curve.fitted - curve.truth, np.nan)
    return columns


def truth_summary(truth: TruthErrors) -> dict[str, Json]:
    """Fitted parameters, joint centres and axes, and curves of each trial; units as in the files of
    the result.
    """
    return {
        "parameters": {
            p.name: _known(
                unit=p.unit,
                nominal_error=p.nominal_error,
                error=p.error,
                standard_error=p.error_bar,
                z=p.z,
            )
            for p in truth.parameters
            if p.status == "fitted"
        },
        "undetermined": [p.name for p in truth.parameters if p.status == "unidentifiable"],
        "not_compared": dict(truth.not_compared),
        "joints": {
            joint: {f.part: _feature(f) for f in truth.features if f.joint == joint}
            for joint in dict.fromkeys(f.joint for f in truth.features)
        },
        "trials": {
            name: {"coordinates": _curves(trial.coordinates), "forces": _curves(trial.forces)}
            for name, trial in truth.trials.items()
        },
    }


def _feature(f: FeatureTruth) -> dict[str, Json]:
    """`within`: how many `of` its parameters with standard errors hold the truth."""
    held = (sum(f.within), len(f.within)) if f.within else (None, None)
    return _known(unit=f.unit, nominal_error=f.nominal, error=f.fitted, within=held[0], of=held[1])


def _curves(curves: Mapping[str, CurveTruth]) -> dict[str, Json]:
    return {
        name: _known(rms_error=c.rms, nominal_rms_error=c.nominal_rms, share_within=c.share_within)
        for name, c in curves.items()
        if c.rms is not None
    }


def _known(**figures: Json) -> dict[str, Json]:
    """Figures that exist; the others are absent."""
    return {
        key: round(v, 6) if isinstance(v, float) else v
        for key, v in figures.items()
        if v is not None
    }


NO_FLOOR = 1e-6  # mm: one or two markers follow a segment exactly; a ratio to that means nothing

SHARE_DIGITS = 4
TIME_DIGITS = 4  # s: a tenth of a millisecond
JOINT_PRIOR = (
    "joint_prior"  # Entry: the cohort that joint parameters lean on; absent where that is none
)
# Entry: coordinate -> deg with which the calibrated model meets the static posture
STATIC_ANGLES = "static_angles_deg"


def summary(calibration: Calibration) -> dict[str, Json]:
    """The content of `summary.json` (mm, N, N·m, s)."""
    return {
        "status": "converged" if calibration.converged else "not converged",
        **verdict_summary(calibration.verdict),
        "warnings": list(calibration.warnings),
        "notes": list(calibration.notes),
        "subject": subject_summary(calibration.model.subject),
        **_joint_prior(calibration),
        "trials": {
            trial.name: trial_summary(trial, calibration.verdict) for trial in calibration.trials
        },
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
                **(
                    {}
                    if phase.marker_noise is None
                    else {"marker_noise_mm": round(1e3 * phase.marker_noise, 4)}
                ),
                **(
                    {"noise_mm": {name: round(1e3 * nu, 4) for name, nu in phase.noise.items()}}
                    if phase.noise
                    else {}
                ),
            }
            for phase in calibration.phases
        ],
        **({} if calibration.truth is None else {"truth": truth_summary(calibration.truth)}),
    }


def subject_summary(subject: Subject) -> dict[str, Json]:
    """Who it is, and what a clinic wrote down; what nobody says is absent."""
    out: dict[str, Json] = {
        "name": subject.name,
        "mass_kg": subject.mass,
        "height_m": subject.height,
    }
    out |= {"height_error_m": subject.height_error} if subject.height_error else {}
    out |= {"sex": subject.sex} if subject.sex else {}
    return (
        out
        | ({} if subject.age is None else {"age_years": subject.age})
        | dict(subject.record.known)
    )


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
        out["hold_out_mm"] = {
            "nominal": 1e3 * held.nominal,
            "calibrated": 1e3 * held.calibrated,
            "folds": held.folds,
        }
        if held.legs:
            out["pelvis_and_legs_hold_out_mm"] = {
                "nominal": 1e3 * held.legs[0],
                "calibrated": 1e3 * held.legs[1],
            }
    nominal, calibrated = trial.nominal.errors.largest(), errors.largest()
    if nominal and calibrated:
        out["max_mm"] = {
            "nominal": 1e3 * nominal[0],
            "calibrated": 1e3 * calibrated[0],
            "marker": calibrated[1],
        }
    out["segments"] = {
        segment: {"markers": int(errors.kept(segment).sum()), "rms_mm": _rms(trial, segment)}
        for segment in SEGMENTS
        if errors.kept(segment).any()
    }
    if trial.joint_floor is not None:
        out["joint_floor_mm"] = {
            joint: 1e3 * value for joint, value in trial.joint_floor.joints.items()
        }
    if trial.joint is None:
        out["events"] = [
            {
                "side": e.side,
                "event": e.moment.value,
                "time": round(e.time, TIME_DIGITS),
                "source": e.source.value,
            }
            for e in trial.events.events
        ]
        if trial.events.repeats:
            out["repetitions"] = [
                {
                    "start": round(c.start, TIME_DIGITS),
                    "stop": round(c.stop, TIME_DIGITS),
                    "phases": [
                        {"phase": name, "stop": round(until, TIME_DIGITS)}
                        for name, until in c.parts
                    ],
                }
                for c in trial.events.repeats
            ]
        if trial.strides:
            out["spatiotemporal"] = means_summary([trial])
    if trial.loads is not None:
        reactions = trial.loads.reactions
        out["valid_frames"] = int(reactions.valid.sum())
        out["valid_frames_r"], out["valid_frames_l"] = (
            int(reactions.valid_r.sum()),
            int(reactions.valid_l.sum()),
        )
        if reactions.valid.any():
            out["pelvis_residual"] = _pelvis_residual(trial.loads)
            if (due := trial.loads.expected) is not None:
                out["pelvis_residual_expected"] = {
                    "force_N": due.force.expected,
                    "torque_Nm": due.moment.expected,
                }
                out["pelvis_residual_limit"] = {
                    "force_N": due.force.limit,
                    "torque_Nm": due.moment.limit,
                }
                if is_trunk_unmeasured(trial.body):
                    out["trunk_measured"] = False
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
            change = (
                100.0
                * (moment_of(loads.final, name) - moment_of(loads.nominal, name))
                / loads.final.bwh
            )
            out[name] = float(np.sqrt((change[valid] ** 2).mean()))
    return out


def _error_sources(loads: Loads) -> dict[str, Json]:
    """Part of the variance of each torque that each source of error makes, over valid frames; they
    sum to 1.
    """
    out: dict[str, Json] = {}
    for column, name in enumerate(FORCES):
        shares = (
            loads.errors.shares(column, loads.reactions.valid_for(name)) if loads.errors else {}
        )
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
DIGITS = 6  # A millionth of a watt or newton metre


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
        rounded = {name: v if name == "time" else np.round(v, DIGITS) for name, v in table.items()}
        write_csv(rounded, out / folder / f"{trial.name}.csv", (*refused_lines(trial), *header))


def read_vectors(folder: Path, trial: str) -> "pd.DataFrame | None":
    """The moment vectors of a trial of a result; None where there are none: no force plates."""
    import pandas as pd

    path = folder / VECTOR_FOLDER / f"{trial}.csv"
    return pd.read_csv(path, comment="#") if path.exists() else None


SUMMARY = "summary.json"


def table_of(content: Mapping[str, object], key: str) -> dict[str, Any]:
    """The object of that name in a JSON file of a result; empty where there is none."""
    found = content.get(key)
    return found if isinstance(found, dict) else {}


def entries_of(content: Mapping[str, object], key: str) -> list[dict[str, Any]]:
    """The objects of a list of that name in a JSON file of a result; none where there is no list."""
    found = content.get(key)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def verdict_summary(verdict: Verdict) -> dict[str, Json]:
    """Entries `verdict`, `reasons` and, where the user went past errors, `forced`."""
    out: dict[str, Json] = {"verdict": verdict.judgement.value}
    if verdict.forced:
        out["forced"] = True
    out["reasons"] = [
        {
            "code": reason.code.value,
            "cause": reason.cause,
            "evidence": reason.evidence,
            "action": reason.action,
            "trial": ", ".join(reason.trials),
            "trials": list(reason.trials),
            "leg": reason.leg,
            "topic": reason.topic,
            "severity": reason.severity.value,
        }
        for reason in verdict.reasons
    ]
    return out


def walk_summary(verdict: Verdict, walk: str) -> dict[str, Json]:
    """Entries `verdict`, `verdict_r` and `verdict_l` of one walk; none for a trial that is not
    judged by itself.
    """
    trial = verdict.trials.get(walk)
    if trial is None:
        return {}
    legs: dict[str, Json] = {
        f"verdict_{side}": judgement.value for side, judgement in trial.legs.items()
    }
    return {"verdict": trial.judgement.value} | legs


def require_not_refused(folder: Path) -> None:
    """InputError where the calibration in a result folder is refused, with the first reason."""
    summary = read_json_object(folder / SUMMARY)
    if summary.get("verdict") != Judgement.REFUSED.value:
        return
    first = next(iter(entries_of(summary, "reasons")), {})
    said = f"the calibration is refused: {first.get('cause')}; {first.get('action')}"
    raise InputError(said, code=Code.MODEL_IN_DOUBT, source=folder)


def of_the_model(summary: Mapping[str, object]) -> tuple[Finding, ...]:
    """What a saved calibration's own verdict says of every further trial: one finding, or none.

    Faults of the forces of its walks do not touch its model; those of their markers do.
    """
    walks = {
        name for name, entry in table_of(summary, "trials").items() if entry.get("role") == "gait"
    }
    shared = [
        r
        for r in entries_of(summary, "reasons")
        if touches_model(str(r.get("topic"))) or not _names(r) or _names(r) - walks
    ]
    if not shared:
        return ()
    first = min(
        shared, key=lambda r: (r.get("severity") != Severity.ERROR.value, bool(r.get("leg")))
    )
    refused = first.get("severity") == Severity.ERROR.value
    word = Judgement.REFUSED.value if refused else Judgement.DOUBTFUL.value
    return (
        Finding(
            severity=Severity.ERROR if refused else Severity.WARNING,
            topic="calibration",
            where=STUDY,
            cause=f"the calibration of this person is {word}",
            found=f"{first.get('cause')}: {first.get('evidence')}",
            cure=str(first.get("action") or "look at its report"),
            leg=str(first.get("leg") or ""),
            code=Code.MODEL_IN_DOUBT,
        ),
    )


def _names(reason: Mapping[str, object]) -> set[str]:
    names = reason.get("trials")
    return {str(name) for name in names} if isinstance(names, list) else set()
