"""Findings on a finished calibration, from its residuals, parameters and torques.

A segment without the markers it needs moves as a prior has it (`coordinate_prior.py`). The error of
that motion times the mass of the segment appears as an unexplained force and moment at the pelvis.
If the trunk is such a segment, the pelvis residual depends on its motion and does not determine
masses. Torques of the legs are summed from the feet upwards and do not depend on it.

Forces are diagnosed after the joint parameters and with nominal masses: inertial parameters, and
joint parameters fitted with them, absorb a fault of the forces (a time offset of 66 ms leaves 96 N
before the inertial fit and 7 N after it).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.analysis.prepared_trials import CalibrationState, MovingTrial
from gaitcal.analysis.result import Loads, TrialResult
from gaitcal.arrays import BoolArray
from gaitcal.calibration.joint_phases import PhaseSummary
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.model.linkage import JOINT_OF_CHILD, LOWER_BODY
from gaitcal.model.parameters import (
    MASSIVE_SEGMENTS,
    Parameters,
    find_impossible_bodies,
    view_as_table,
)
from gaitcal.quality.after_fit import (
    TrackedMarkers,
    check_angle_changes,
    check_physical_limits,
    check_tracked_markers,
)
from gaitcal.quality.force_diagnosis import ForceDiagnosis, find_force_faults
from gaitcal.quality.force_evidence import build_force_evidence
from gaitcal.quality.joint_positions import check_joint_positions
from gaitcal.quality.marker_checks import ONE_MARKER
from gaitcal.quality.verdict import has_effect_on_joints
from gaitcal.tracking.motion import Motion

WORSE_M = 5e-4
"""m: smaller increases of the marker error over the nominal model are not reported."""
WORSE = 0.02
"""Share of the nominal marker error: the same for large errors."""
TRUNK = "head_trunk"
_LABELS = {TRUNK: "head and trunk", "upper_arm": "upper arms", "forearm_hand": "forearms and hands"}


def check_calibration(
    state: CalibrationState, results: Sequence[TrialResult], phases: Sequence[PhaseSummary]
) -> tuple[Finding, ...]:
    """Check bodies, marker errors, convergence and joint positions of a finished calibration."""
    positions = tuple[Finding, ...]()
    if state.joint is not None:
        functional = {t.joint for t in results if t.joint is not None}
        found = check_joint_positions(
            state.model, state.parameters, state.joint.errors, state.prior, functional
        )
        positions = tuple(found)
    return (
        *_check_body_inertia(state),
        *check_marker_fit(results),
        *check_convergence(phases),
        *positions,
    )


def _check_body_inertia(state: CalibrationState) -> Iterator[Finding]:
    """Find inertial parameters that no real body has; only the published cost gives them.

    Yields: at most one, of the study.
    """
    bodies = find_impossible_bodies(state.parameters.inertial)
    if not bodies:
        return
    left_out = (
        "; the joint step needs possible bodies and was left out"
        if state.settings.joint_step
        else ""
    )
    yield Finding(
        severity=Severity.WARNING,
        topic="inertial parameters",
        where=STUDY,
        cause=f"no real body has the fitted inertial parameters of {', '.join(bodies)}",
        found=f"torques have no standard errors, and model.xml is not written{left_out}",
        cure="set ip = 'consistent', which keeps every body possible",
        code=Code.IMPOSSIBLE_BODY,
    )


def check_marker_fit(results: Sequence[TrialResult]) -> Iterator[Finding]:
    """Find trials with a larger marker error with the final model than with the nominal one.

    Yields one for each such trial.
    """
    for t in results:
        # Walks are compared over pelvis and legs: arms that were raised in the static trial would
        # hide worse legs.
        segments = () if t.joint else LOWER_BODY
        first, last = t.nominal.errors.rms(*segments), t.final.errors.rms(*segments)
        if first is None or last is None:
            continue
        if last > max(first + WORSE_M, (1 + WORSE) * first):
            yield Finding(
                severity=Severity.WARNING,
                topic="trials",
                where=t.name,
                cause="the trials disagree about the joints",
                found=f"marker error {1e3 * last:.1f} mm with the final model, {1e3 * first:.1f} mm"
                " with the nominal model",
                cure="check that all trials are of one person with the markers in one position; "
                "leave out the trial that differs",
                code=Code.TRIALS_DISAGREE,
            )


def check_convergence(phases: Sequence[PhaseSummary]) -> Iterator[Finding]:
    """Find fits that stopped before they reached their tolerance.

    Yields one for each such fit.
    """
    for phase in phases:
        if not phase.converged:
            yield Finding(
                severity=Severity.WARNING,
                topic="convergence",
                where=STUDY,
                cause=f"the fit of {phase.name} did not converge",
                found=phase.message,
                cure="its result is not a minimum: check the trials it was fitted to",
                code=Code.NOT_CONVERGED,
            )


def check_tracked_trial(
    trial: MovingTrial, loads: Loads | None, weight: float
) -> tuple[Finding, ...]:
    """Check one tracked trial: markers with structured residuals, impossible angles and moments.

    Parameters
    ----------
    trial : MovingTrial
        After tracking.
    loads : Loads or None
        Its ground reactions and torques; None without force plates.
    weight : float
        Body weight, N.

    Returns
    -------
    tuple of Finding
    """
    problem, motion = trial.whole_body_problem, trial.motion
    measured = problem.data.measured.transpose(2, 0, 1)
    # Positions that were not measured are zero in the data of a problem.
    observed: BoolArray = np.any(measured != 0.0, axis=2)
    tracked = TrackedMarkers(
        name=motion.name,
        time=motion.time,
        labels=problem.labels,
        segments=motion.errors.segments,
        weight=motion.errors.weight,
        measured=np.where(observed[:, :, None], measured, np.nan),
        model=problem.compute_positions(
            motion.coefficients, problem.build_body(trial.parameters)
        ).transpose(2, 0, 1),
    )
    moments, valid, legs = None, None, None
    if loads is not None:
        moments, valid, legs = loads.final, loads.reactions.valid, loads.reactions.valid_legs
    # Moments are checked in valid frames only.
    bounds = check_physical_limits(motion, weight, moments, valid, legs)
    return (
        *check_tracked_markers(tracked),
        *bounds,
        *check_angle_changes(trial.nominal, motion, valid),
    )


def is_trunk_unmeasured(motion: Motion) -> bool:
    """Return whether the markers do not determine the rotation of the trunk.

    Parameters
    ----------
    motion : Motion
        Of the whole body.

    Returns
    -------
    bool
    """
    return TRUNK in _list_unmeasured_segments(motion)


def describe_unmeasured_segments(motion: Motion, parameters: Parameters) -> str:
    """Name the segments of the upper body that markers do not determine, and their share of mass.

    Parameters
    ----------
    motion : Motion
        Of the whole body.
    parameters : Parameters
        With the masses.

    Returns
    -------
    str
        `head and trunk, upper arms: 44 % of the body's mass`; empty if there are none.
    """
    segments = _list_unmeasured_segments(motion)
    mass = dict(zip(MASSIVE_SEGMENTS, view_as_table(parameters.inertial)[:, 0], strict=True))
    share = float(sum(mass[segment] for segment in segments) / sum(mass.values()))
    # Both sides of an arm segment have one label.
    labels = dict.fromkeys(_LABELS.get(s, _LABELS.get(s[:-2], s)) for s in segments)
    return f"{', '.join(labels)}: {100 * share:.0f} % of the body's mass" if labels else ""


def _list_unmeasured_segments(motion: Motion) -> tuple[str, ...]:
    """List the segments above the pelvis with a coordinate that its prior determines."""
    out = []
    for segment in MASSIVE_SEGMENTS:
        if segment in LOWER_BODY:
            continue
        coordinates = {element.name for element in JOINT_OF_CHILD[segment].elements}
        if coordinates & set(motion.guessed):
            out.append(segment)
    return tuple(out)


def check_unmeasured_mass(
    results: Sequence[TrialResult], parameters: Parameters
) -> Iterator[Finding]:
    """Report mass whose motion no marker determines, and the pelvis residual.

    It is a note: torques of the legs do not depend on it.

    Yields: at most one.
    """
    walks = [t for t in results if t.joint is None and t.loads is not None and t.loads.residuals]
    unmeasured = [t for t in walks if is_trunk_unmeasured(t.body)]
    if not unmeasured:
        return
    # The last stage has the fitted parameters.
    residuals = [t.loads.residuals[-1] for t in unmeasured if t.loads is not None]
    force, moment = max(r.rms_force for r in residuals), max(r.rms_moment for r in residuals)
    in_all = len(unmeasured) == len(walks)
    where = "" if in_all else f" in {', '.join(t.name for t in unmeasured)}"
    yield Finding(
        severity=Severity.INFO,
        topic="pelvis residual",
        where=unmeasured[0].name if len(walks) > len(unmeasured) == 1 else STUDY,
        cause="markers do not determine "
        f"{describe_unmeasured_segments(unmeasured[0].body, parameters)}",
        found="the model keeps the trunk upright and the arms hanging along it; the difference from"
        f" the real motion is the main part of the pelvis residual (up to {force:.0f} N and "
        f"{moment:.0f} N·m RMS){where} and of the error bars of pelvis and trunk; inertial "
        "parameters are not fitted; torques of the legs do not depend on it",
        cure="put three markers that are not in line on the thorax (C7, T10, jugular notch, "
        "xiphoid) in all trials",
        code=Code.UNMEASURED_MASS,
    )


def list_trials_with_faulty_legs(checked: Sequence[Finding]) -> frozenset[str]:
    """List the trials in which the markers do not determine the motion of a leg.

    Their motion asks for forces that did not act.

    `checked`: findings of the checks before the fit. Returns: names of trials.
    """
    return frozenset(
        f.where
        for f in checked
        if f.leg and f.severity is Severity.ERROR and has_effect_on_joints(f.topic)
    )


def diagnose_forces(state: CalibrationState) -> ForceDiagnosis:
    """Diagnose the forces of the tracked trials by their motions and nominal inertial parameters.

    A trial whose markers are in doubt by the checks has a doubtful motion.

    Returns: empty if the nominal bodies are impossible.
    """
    model, checked = state.model, state.checked
    # A motion that is wrong itself cannot accuse the forces.
    doubtful = list_trials_with_faulty_legs(checked) | {
        f.where for f in checked if f.topic == ONE_MARKER and f.cause
    }
    # Masses of the table: fitted ones would already have absorbed a part of the fault.
    parameters = state.parameters.with_inertial(model.nominal.inertial)
    if find_impossible_bodies(parameters.inertial):
        return ForceDiagnosis()
    evidence = (
        build_force_evidence(
            replace(t, recording=t.in_file_axes),
            t.recording,
            model,
            parameters,
            t.motion,
            t.reactions,
        )
        for t in state.trials
        if t.reactions is not None
    )
    return find_force_faults(
        [replace(one, doubtful=one.name in doubtful) for one in evidence if one is not None]
    )


def note_trials_without_masses(state: CalibrationState) -> list[str]:
    """Note the trials that are left out of the inertial fit, and why.

    Returns: one note for each reason.
    """
    faulty = state.force_diagnosis.faulty
    faulty_legs = list_trials_with_faulty_legs(state.checked)
    reasons = {
        "faulty forces": [t.name for t in state.trials if t.name in faulty],
        "a leg whose markers do not determine its motion": [
            t.name for t in state.walks if t.name in faulty_legs and t.name not in faulty
        ],
    }
    return [
        f"inertial parameters: left out for {why}: {', '.join(names)}"
        for why, names in reasons.items()
        if names
    ]
