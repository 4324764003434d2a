"""What speaks against a finished calibration: one finding for each thing that its own figures put
in doubt.

A segment without the markers it needs moves as a prior has it (`coordinate_prior.py`). What its
mass does otherwise appears at the pelvis as force and moment that nothing explains: so long as the
trunk is such a segment, the pelvis residual says how it moves, and nothing of masses. Torques of
the legs are summed from the feet upwards and do not depend on it.

Forces are judged after the joint parameters and with nominal masses: inertial parameters, and joint
ones fitted with them, take a fault of the forces up (a clock 66 ms late leaves 96 N before and 7 N
after).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.analysis.prepared_trials import CalibrationState, MovingTrial
from gaitcal.analysis.result import Loads, TrialResult
from gaitcal.arrays import BoolArray
from gaitcal.calibration.joint_phases import Phase
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

WORSE_M, WORSE = (
    5e-4,
    0.02,
)  # m, and share of the nominal error, by how much markers are met worse before it is told


def calibration_findings(
    session: CalibrationState, results: Sequence[TrialResult], phases: Sequence[Phase]
) -> tuple[Finding, ...]:
    """What the figures of a finished calibration put in doubt."""
    places = tuple[Finding, ...]()
    if session.joint is not None:
        isolated = {t.joint for t in results if t.joint is not None}
        found = check_joint_positions(
            session.model, session.parameters, session.joint.errors, session.prior, isolated
        )
        places = tuple(found)
    return (*bodies_that_cannot_be(session), *disagreements(results), *unfinished(phases), *places)


def bodies_that_cannot_be(session: CalibrationState) -> Iterator[Finding]:
    """Inertial parameters that no real body has, which only the published cost can find."""
    bodies = find_impossible_bodies(session.parameters.inertial)
    if not bodies:
        return
    left_out = (
        "; the third step needs possible ones and was left out"
        if session.settings.joint_step
        else ""
    )
    yield Finding(
        severity=Severity.WARNING,
        topic="inertial parameters",
        where=STUDY,
        cause=f"no real body has the inertial parameters found for {', '.join(bodies)}",
        found=f"torques have no standard errors then, and model.xml is not written{left_out}",
        cure="ip = 'consistent' keeps every body possible",
        code=Code.IMPOSSIBLE_BODY,
    )


def disagreements(results: Sequence[TrialResult]) -> Iterator[Finding]:
    """Trials whose markers the final model meets worse than the nominal one."""
    for t in results:
        segments = (
            () if t.joint else LOWER_BODY
        )  # arms that were raised in the static trial would hide worse legs
        first, last = t.nominal.errors.rms(*segments), t.final.errors.rms(*segments)
        if (
            first is not None
            and last is not None
            and last > max(first + WORSE_M, (1 + WORSE) * first)
        ):
            yield Finding(
                severity=Severity.WARNING,
                topic="trials",
                where=t.name,
                cause="the trials disagree about the joints",
                found=f"with the final model its markers are met worse ({1e3 * last:.1f} mm) than "
                "with the nominal one "
                f"({1e3 * first:.1f} mm)",
                cure="see whether the trials are of one person with the markers in one place; "
                "leave the odd one out",
                code=Code.TRIALS_DISAGREE,
            )


def unfinished(phases: Sequence[Phase]) -> Iterator[Finding]:
    """Fits that stopped before they reached their tolerance."""
    for phase in phases:
        if not phase.converged:
            yield Finding(
                severity=Severity.WARNING,
                topic="convergence",
                where=STUDY,
                cause=f"the fit of {phase.name} did not converge",
                found=phase.message,
                cure="its figures are not a minimum: look at the trials it was fitted to",
                code=Code.NOT_CONVERGED,
            )


def trial_findings(trial: MovingTrial, loads: Loads | None, weight: float) -> tuple[Finding, ...]:
    """Findings on one tracked trial: residuals with structure, and what no body can do. `weight`:
    of the body, N.
    """
    problem, motion = trial.body, trial.motion
    measured = problem.data.measured.transpose(2, 0, 1)
    seen: BoolArray = np.any(measured != 0.0, axis=2)
    tracked = TrackedMarkers(
        name=motion.name,
        time=motion.time,
        labels=problem.labels,
        segments=motion.errors.segments,
        weight=motion.errors.weight,
        measured=np.where(seen[:, :, None], measured, np.nan),
        model=problem.compute_positions(
            motion.coefficients, problem.build_body(trial.parameters)
        ).transpose(2, 0, 1),
    )
    moments, valid, legs = None, None, None
    if loads is not None:
        moments, valid, legs = loads.final, loads.reactions.valid, loads.reactions.valid_legs
    bounds = check_physical_limits(motion, weight, moments, valid, legs)
    return (
        *check_tracked_markers(tracked),
        *bounds,
        *check_angle_changes(trial.nominal, motion, valid),
    )


TRUNK = "head_trunk"
_WORDS = {TRUNK: "head and trunk", "upper_arm": "upper arms", "forearm_hand": "forearms and hands"}


def is_trunk_unmeasured(motion: Motion) -> bool:
    """Whether the markers of a whole-body motion leave open how the trunk turns."""
    return TRUNK in _unmeasured(motion)


def unmeasured_words(motion: Motion, parameters: Parameters) -> str:
    """Segments of the upper body that markers do not determine ("head and trunk, upper arms: 44 %
    of the body's mass"); nothing where none is.
    """
    segments = _unmeasured(motion)
    mass = dict(zip(MASSIVE_SEGMENTS, view_as_table(parameters.inertial)[:, 0], strict=True))
    share = float(sum(mass[segment] for segment in segments) / sum(mass.values()))
    parts = dict.fromkeys(_WORDS.get(s, _WORDS.get(s[:-2], s)) for s in segments)
    return f"{', '.join(parts)}: {100 * share:.0f} % of the body's mass" if parts else ""


def _unmeasured(motion: Motion) -> tuple[str, ...]:
    turns = {
        s: {e.name for e in JOINT_OF_CHILD[s].elements}
        for s in MASSIVE_SEGMENTS
        if s not in LOWER_BODY
    }
    return tuple(s for s, names in turns.items() if names & set(motion.guessed))


def unmeasured_mass(results: Sequence[TrialResult], parameters: Parameters) -> Iterator[Finding]:
    """Mass whose motion no marker determines, and the pelvis residual that it makes: no doubt of
    leg torques.
    """
    walks = [t for t in results if t.joint is None and t.loads is not None and t.loads.residuals]
    blind = [t for t in walks if is_trunk_unmeasured(t.body)]
    if not blind:
        return
    residuals = [t.loads.residuals[-1] for t in blind if t.loads is not None]
    force, moment = max(r.rms_force for r in residuals), max(r.rms_moment for r in residuals)
    where = "" if len(blind) == len(walks) else f" in {', '.join(t.name for t in blind)}"
    yield Finding(
        severity=Severity.INFO,
        topic="pelvis residual",
        where=blind[0].name if len(walks) > len(blind) == 1 else STUDY,
        cause=f"markers do not determine {unmeasured_words(blind[0].body, parameters)}",
        found="a trunk is taken to stay upright, arms to hang along it, unless markers say "
        "otherwise; how they really "
        f"move is the first cause of the pelvis residual (up to {force:.0f} N and {moment:.0f} N·m "
        f"RMS){where} and in "
        "the error bars of pelvis and trunk, and inertial parameters are not fitted against it; "
        "torques of the legs "
        "are summed from the feet upwards and do not depend on it",
        cure="three markers on the thorax that do not lie on one line (C7, T10, jugular notch, "
        "xiphoid) in all trials",
        code=Code.UNMEASURED_MASS,
    )


def spoilt_motions(checked: Sequence[Finding]) -> frozenset[str]:
    """Trials whose markers do not tell how a leg moves: their motion asks for forces that nobody
    exerted.
    """
    return frozenset(
        f.where
        for f in checked
        if f.leg and f.severity is Severity.ERROR and has_effect_on_joints(f.topic)
    )


def diagnose_forces(session: CalibrationState) -> ForceDiagnosis:
    """What is wrong with the forces of the tracked trials, by their motions and nominal inertial
    parameters.

    What the checks said of the markers tells whose motion is doubtful.
    """
    model, checked = session.model, session.checked
    doubtful = spoilt_motions(checked) | {
        f.where for f in checked if f.topic == ONE_MARKER and f.cause
    }
    parameters = session.parameters.with_inertial(model.nominal.inertial)
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
        for t in session.trials
        if t.reactions is not None
    )
    return find_force_faults(
        [replace(one, doubtful=one.name in doubtful) for one in evidence if one is not None]
    )


def left_out_of_masses(session: CalibrationState) -> list[str]:
    """Notes on the trials that say nothing of masses."""
    faulty, spoilt = session.forces.faulty, spoilt_motions(session.checked)
    words = {
        "forces at fault say nothing of masses": [
            t.name for t in session.trials if t.name in faulty
        ],
        "a leg that its markers do not show says nothing of masses": [
            t.name for t in session.walks if t.name in spoilt and t.name not in faulty
        ],
    }
    return [
        f"inertial parameters: {why}; left out: {', '.join(names)}"
        for why, names in words.items()
        if names
    ]
