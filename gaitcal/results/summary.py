"""Write `summary.json`, joint powers, moment vectors and errors against declared truth.

A figure that does not exist is absent, never 0. The verdict in `summary.json` is read again for
further trials that use the model.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitcal.analysis.fit_findings import is_trunk_unmeasured
from gaitcal.analysis.result import Calibration, Loads, TrialResult
from gaitcal.analysis.truth_errors import CurveTruth, FeatureTruth, TruthErrors
from gaitcal.arrays import Array
from gaitcal.calibration.joint_phases import PhaseSummary
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.errors import STUDY, Code, Finding, InputError, Severity
from gaitcal.gait.cycles import GaitCycle
from gaitcal.gait.moments import get_moment
from gaitcal.io.result_folder import read_json_object
from gaitcal.model.linkage import (
    COORDINATES,
    LOWER_BODY,
    REACTIONS,
    SEGMENTS,
    SIDES,
    is_translation,
)
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.quality.verdict import Judgement, Verdict, WalkVerdict, has_effect_on_joints
from gaitcal.results.stride_tables import summarise_means
from gaitcal.results.table_files import Json, convert_to_columns, format_refused_lines, write_csv
from gaitcal.results.trial_tables import (
    POWER_HEADER,
    VECTOR_HEADER,
    build_power_table,
    build_vector_table,
)
from gaitcal.study.declared_truth import MOMENTS_SUFFIX, MOTION_SUFFIX

if TYPE_CHECKING:
    import pandas as pd

FOLDER = "truth"
PARAMETERS_HEADER = (
    "true and calibrated parameters in the same segment frames; error: fitted minus truth",
    "z: error in standard errors; of honest ones 95 of 100 are below 1.96",
)
MOTION_HEADER = (
    "true coordinates in degrees and m at the frames of motion/TRIAL.csv, from the anatomical zero",
    "_error: calibrated minus true; empty: the truth has no value at this instant",
)
MOMENTS_HEADER = (
    "true generalised forces in N m (pelvis_tx, _ty, _tz: N) at the frames of moments/TRIAL.csv",
    "_error: calibrated minus true, empty in frames that are not valid (valid_r, valid_l, valid)",
)


def write_truth(truth: TruthErrors | None, out: Path) -> None:
    """Write `truth/parameters.csv`, `truth/TRIAL_motion.csv` and `truth/TRIAL_moments.csv`.

    Parameters
    ----------
    truth
        Errors against the declared truth; None: nothing is written.
    out
        The result folder that is being written.
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
    write_csv(convert_to_columns(rows), folder / "parameters.csv", PARAMETERS_HEADER)
    for name, trial in truth.trials.items():
        for curves, time, ending, header in (
            (trial.coordinates, trial.time, MOTION_SUFFIX, MOTION_HEADER),
            (trial.forces, trial.time, MOMENTS_SUFFIX, MOMENTS_HEADER),
        ):
            if curves:
                write_csv(_build_curve_table(time, curves), folder / (name + ending), header)


def _build_curve_table(time: Array, curves: Mapping[str, CurveTruth]) -> dict[str, Array]:
    columns = {"time": time}
    for name, curve in curves.items():
        columns[name] = curve.truth
        columns[f"{name}_error"] = np.where(curve.compared, curve.fitted - curve.truth, np.nan)
    return columns


def summarise_truth(truth: TruthErrors) -> dict[str, Json]:
    """Summarise errors of parameters, joint centres, axes and curves, in the units of the files."""
    # Position and axis of a joint are two features of one entry.
    joints: dict[str, dict[str, Json]] = {}
    for feature in truth.features:
        joints.setdefault(feature.joint, {})[feature.part] = _summarise_feature(feature)
    return {
        "parameters": {
            p.name: _drop_unknown(
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
        "joints": {**joints},
        "trials": {
            name: {
                "coordinates": _summarise_curves(trial.coordinates),
                "forces": _summarise_curves(trial.forces),
            }
            for name, trial in truth.trials.items()
        },
    }


def _summarise_feature(f: FeatureTruth) -> dict[str, Json]:
    """Summarise a centre or axis.

    `within` counts those `of` its parameters whose 95 % interval contains the truth.
    """
    held = (sum(f.within), len(f.within)) if f.within else (None, None)
    return _drop_unknown(
        unit=f.unit, nominal_error=f.nominal, error=f.fitted, within=held[0], of=held[1]
    )


def _summarise_curves(curves: Mapping[str, CurveTruth]) -> dict[str, Json]:
    return {
        name: _drop_unknown(
            rms_error=c.rms, nominal_rms_error=c.nominal_rms, share_within=c.share_within
        )
        for name, c in curves.items()
        if c.rms is not None
    }


def _drop_unknown(**figures: Json) -> dict[str, Json]:
    """Drop figures that are None and round the others."""
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


def summarise_calibration(calibration: Calibration) -> dict[str, Json]:
    """Build the content of `summary.json`.

    Returns: lengths in mm, forces in N, torques in N·m, times in s.
    """
    means = summarise_means(calibration.trials)
    return {
        "status": "converged" if calibration.converged else "not converged",
        **summarise_verdict(calibration.verdict),
        "warnings": list(calibration.warnings),
        "notes": list(calibration.notes),
        "subject": summarise_subject(calibration.model.subject),
        **_summarise_joint_prior(calibration),
        "trials": {
            trial.name: summarise_trial(trial, calibration.verdict) for trial in calibration.trials
        },
        **({"spatiotemporal": means} if means else {}),
        STATIC_ANGLES: {
            name: round(float(np.rad2deg(value)), 4) + 0.0  # no negative zeros
            for name, value in calibration.static_angles.items()
            if not is_translation(name)
        },
        "phases": [_summarise_phase(phase) for phase in calibration.phases],
        **({} if calibration.truth is None else {"truth": summarise_truth(calibration.truth)}),
    }


def _summarise_phase(phase: PhaseSummary) -> dict[str, Json]:
    """Summarise one phase of the calibration; marker noise in mm, if it was estimated."""
    out: dict[str, Json] = {
        "name": phase.name,
        "trials": list(phase.trials),
        "parameters": phase.parameters,
        "iterations": phase.iterations,
        "seconds": round(phase.seconds, 4),
        "status": phase.status,
        "message": phase.message,
    }
    if phase.marker_noise is not None:
        out["marker_noise_mm"] = round(1e3 * phase.marker_noise, 4)
    if phase.noise:
        out["noise_mm"] = {name: round(1e3 * nu, 4) for name, nu in phase.noise.items()}
    return out


def summarise_subject(subject: Subject) -> dict[str, Json]:
    """Summarise the subject and its clinical record; unknown entries are absent.

    Parameters
    ----------
    subject
        The subject.

    Returns
    -------
    dict
        `name`, `mass_kg`, `height_m` and other known data.
    """
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


def _summarise_joint_prior(calibration: Calibration) -> dict[str, Json]:
    prior = calibration.study.joint_prior
    if prior is None:
        return {}
    return {JOINT_PRIOR: {"file": prior.file, "people": prior.people, "left_out": prior.left_out}}


def summarise_trial(trial: TrialResult, verdict: Verdict) -> dict[str, Json]:
    """Summarise one trial: verdict, markers, segments, residuals, torque changes.

    Parameters
    ----------
    trial
        A trial of a calibration, or a further trial.
    verdict
        Contains the verdict on this trial.

    Returns
    -------
    dict
        Its entry in `summary.json`.
    """
    out: dict[str, Json] = {
        "role": trial.role.value,
        **summarise_walk(verdict, trial.name),
        **_summarise_markers(trial),
    }
    if trial.joint is None:
        out |= {"activity": trial.activity, **_summarise_events(trial)}
    if trial.loads is not None:
        out |= _summarise_loads(trial, trial.loads)
    return out


def _summarise_markers(trial: TrialResult) -> dict[str, Json]:
    """Summarise the motion and its marker errors: all markers, segments, floors, hold-out."""
    errors = trial.calibrated.errors
    out: dict[str, Json] = {
        "frames": len(trial.calibrated.time),
        "markers": len(errors.labels),
        "weighted_markers": int(errors.select_observed().sum()),
        "nodes": trial.calibrated.basis.control_points,
        "rms_mm": _summarise_rms(trial),
    }
    if trial.bandwidth:
        out["bandwidth_hz"] = round(trial.bandwidth.motion_hz, 3)
        out["bandwidth_by"] = trial.bandwidth.chosen_by.value
    if trial.joint:
        out["joint"] = trial.joint
    else:
        out["pelvis_and_legs_mm"] = _summarise_rms(trial, *LOWER_BODY)
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
    nominal, calibrated = trial.nominal.errors.find_largest(), errors.find_largest()
    if nominal and calibrated:
        out["max_mm"] = {
            "nominal": 1e3 * nominal[0],
            "calibrated": 1e3 * calibrated[0],
            "marker": calibrated[1],
        }
    out["segments"] = {
        segment: {
            "markers": int(errors.select_observed(segment).sum()),
            "rms_mm": _summarise_rms(trial, segment),
        }
        for segment in SEGMENTS
        if errors.select_observed(segment).any()
    }
    if trial.joint_floor is not None:
        # mm, the least distance that each joint by itself allows.
        floors = trial.joint_floor.joints
        out["joint_floor_mm"] = {joint: 1e3 * value for joint, value in floors.items()}
    return out


def _summarise_events(trial: TrialResult) -> dict[str, Json]:
    """Summarise foot events, repetitions and spatiotemporal means of a whole-body trial."""
    out: dict[str, Json] = {}
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
        out["repetitions"] = [_summarise_repetition(cycle) for cycle in trial.events.repeats]
    if trial.strides:
        out["spatiotemporal"] = summarise_means([trial])
    return out


def _summarise_repetition(cycle: GaitCycle) -> dict[str, Json]:
    phases: list[Json] = [
        {"phase": name, "stop": round(until, TIME_DIGITS)} for name, until in cycle.parts
    ]
    return {
        "start": round(cycle.start, TIME_DIGITS),
        "stop": round(cycle.stop, TIME_DIGITS),
        "phases": phases,
    }


def _summarise_loads(trial: TrialResult, loads: Loads) -> dict[str, Json]:
    """Summarise valid frames, pelvis residuals, and changes and errors of the torques."""
    reactions = loads.reactions
    out: dict[str, Json] = {
        "valid_frames": int(reactions.valid.sum()),
        "valid_frames_r": int(reactions.valid_r.sum()),
        "valid_frames_l": int(reactions.valid_l.sum()),
    }
    if reactions.valid.any():
        # Only over valid frames, as torques elsewhere are not shown.
        out["pelvis_residual"] = _summarise_pelvis_residual(loads)
        if (expected := loads.expected) is not None:
            out["pelvis_residual_expected"] = {
                "force_N": expected.force.expected,
                "torque_Nm": expected.moment.expected,
            }
            out["pelvis_residual_limit"] = {
                "force_N": expected.force.limit,
                "torque_Nm": expected.moment.limit,
            }
            if is_trunk_unmeasured(trial.body):
                out["trunk_measured"] = False
    if reactions.has_torques:
        out["torque_change_bwh"] = _compute_torque_change(loads)
        if sources := _summarise_error_sources(loads):
            out["torque_error_sources"] = sources
    return out


def _summarise_rms(trial: TrialResult, *segments: str) -> dict[str, Json]:
    nominal, calibrated, floor = trial.compute_rms_mm(*segments)
    joint_floor = trial.compute_joint_floor_mm(*segments)
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


def _compute_torque_change(loads: Loads) -> dict[str, Json]:
    """Compute the RMS change of torques over valid frames, % of body weight times height."""
    out: dict[str, Json] = {}
    for name in (*COORDINATES, *REACTIONS):
        valid = loads.reactions.valid_for(name)
        if not name.startswith("pelvis") and valid.any():
            change = (
                100.0
                * (get_moment(loads.final, name) - get_moment(loads.nominal, name))
                / loads.final.bwh
            )
            out[name] = float(np.sqrt((change[valid] ** 2).mean()))
    return out


def _summarise_error_sources(loads: Loads) -> dict[str, Json]:
    """Summarise the part of each source in the variance of each torque; the parts sum to 1."""
    out: dict[str, Json] = {}
    for column, name in enumerate(FORCES):
        shares = (
            loads.errors.compute_shares(column, loads.reactions.valid_for(name))
            if loads.errors
            else {}
        )
        if shares and not name.startswith("pelvis"):
            out[name] = {source.key: round(share, SHARE_DIGITS) for source, share in shares.items()}
    return out


def _summarise_pelvis_residual(loads: Loads) -> dict[str, Json]:
    out: dict[str, Json] = {}
    for stage, moments in loads.moments.items():
        force, torque = moments.residual_rms(loads.reactions.valid)
        out[stage.key] = {"force_N": force, "torque_Nm": torque}
    return out


POWER_FOLDER, VECTOR_FOLDER = "powers", "moment_vectors"
DIGITS = 6  # A millionth of a watt or newton metre


def write_kinetics(trial: TrialResult, model: SubjectModel, out: Path) -> None:
    """Write `powers/TRIAL.csv` and `moment_vectors/TRIAL.csv`; nothing without force plates.

    Parameters
    ----------
    trial
        A trial with its loads.
    model
        The calibrated subject.
    out
        The result folder that is being written.
    """
    loads = trial.loads
    if loads is None or loads.kinetics is None:
        return
    of_powers = build_power_table(loads, loads.kinetics, model.subject.mass)
    of_vectors = build_vector_table(loads, loads.kinetics)
    tables = ((POWER_FOLDER, of_powers, POWER_HEADER), (VECTOR_FOLDER, of_vectors, VECTOR_HEADER))
    for folder, table, header in tables:
        (out / folder).mkdir(exist_ok=True)
        rounded = {name: v if name == "time" else np.round(v, DIGITS) for name, v in table.items()}
        write_csv(
            rounded, out / folder / f"{trial.name}.csv", (*format_refused_lines(trial), *header)
        )


def read_vectors(folder: Path, trial: str) -> "pd.DataFrame | None":
    """Read the moment vectors of a trial of a result; None without force plates."""
    import pandas as pd

    path = folder / VECTOR_FOLDER / f"{trial}.csv"
    return pd.read_csv(path, comment="#") if path.exists() else None


SUMMARY = "summary.json"


def get_table(content: Mapping[str, object], key: str) -> dict[str, Any]:
    """Get an object from a JSON file of a result.

    Parameters
    ----------
    content
        Parsed JSON.
    key
        Name of the entry.

    Returns
    -------
    dict
        Empty if there is no such object.
    """
    found = content.get(key)
    return found if isinstance(found, dict) else {}


def get_entries(content: Mapping[str, object], key: str) -> list[dict[str, Any]]:
    """Get a list of objects from a JSON file of a result.

    Parameters
    ----------
    content
        Parsed JSON.
    key
        Name of the entry.

    Returns
    -------
    list of dict
        Empty if there is no such list.
    """
    found = content.get(key)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def summarise_verdict(verdict: Verdict) -> dict[str, Json]:
    """Summarise a verdict.

    Parameters
    ----------
    verdict
        The verdict on a study.

    Returns
    -------
    dict
        Entries `verdict`, `reasons` and, if the user forced the calculation, `forced`.
    """
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


def summarise_walk(verdict: Verdict, walk: str) -> dict[str, Json]:
    """Summarise the verdict on one walk; empty for a trial without a verdict."""
    trial = verdict.trials.get(walk)
    if trial is None:
        return {}
    legs: dict[str, Json] = {
        f"verdict_{side}": judgement.value for side, judgement in trial.legs.items()
    }
    return {"verdict": trial.judgement.value} | legs


def parse_verdict(summary: Mapping[str, object]) -> Verdict:
    """Parse the verdict in `summary.json`, without its reasons.

    Parameters
    ----------
    summary
        Of a calibration, or of further trials, which are refused or trustworthy together if all of
        them are, and else doubtful.

    Returns
    -------
    Verdict
        With the verdict on each walk; without reasons.
    """
    trials = {}
    for name, trial in get_table(summary, "trials").items():
        if "verdict" not in trial:
            continue
        # Older results and functional trials have no verdict of single legs.
        legs = {s: Judgement(trial[f"verdict_{s}"]) for s in SIDES if f"verdict_{s}" in trial}
        trials[name] = WalkVerdict(judgement=Judgement(trial["verdict"]), legs=legs)
    together = combine_judgements(trial.judgement.value for trial in trials.values())
    return Verdict(
        judgement=Judgement(summary.get("verdict", together)),
        reasons=(),
        trials=trials,
        forced=bool(summary.get("forced")),
    )


def combine_judgements(judgements: Iterable[str]) -> Judgement:
    """Combine judgements: the common one; doubtful if they differ; trustworthy without any."""
    found = {Judgement(name) for name in judgements} or {Judgement.TRUSTWORTHY}
    return found.pop() if len(found) == 1 else Judgement.DOUBTFUL


def require_not_refused(folder: Path) -> None:
    """Raise if the calibration of a result is refused.

    Parameters
    ----------
    folder
        A result folder.

    Raises
    ------
    InputError
        With the first reason.
    """
    summary = read_json_object(folder / SUMMARY)
    if summary.get("verdict") != Judgement.REFUSED.value:
        return
    first = next(iter(get_entries(summary, "reasons")), {})
    message = f"the calibration is refused: {first.get('cause')}; {first.get('action')}"
    raise InputError(message, code=Code.MODEL_IN_DOUBT, source=folder)


def find_model_doubts(summary: Mapping[str, object]) -> tuple[Finding, ...]:
    """Find the consequence of a calibration's verdict for further trials: one finding, or none.

    Findings on the forces of its walks do not concern the model; those on their markers do.
    """
    # Reasons of single walks do not concern further trials; those of joints, masses or the whole
    # study do.
    walks = {
        name for name, entry in get_table(summary, "trials").items() if entry.get("role") == "gait"
    }
    shared = [
        r
        for r in get_entries(summary, "reasons")
        if has_effect_on_joints(str(r.get("topic"))) or not _list_names(r) or _list_names(r) - walks
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


def _list_names(reason: Mapping[str, object]) -> set[str]:
    names = reason.get("trials")
    return {str(name) for name in names} if isinstance(names, list) else set()
