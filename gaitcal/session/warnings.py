"""What speaks against a finished calibration: one finding for each thing that its own figures put in doubt.

What a tracked trial says against itself: residuals with structure, and what no body can do.

How much of the body's mass moves in a way that markers do not determine, and what that does to the pelvis residual.

A segment without the markers it needs moves as a prior has it (`motion/undetermined.py`). What its mass does otherwise
appears at the pelvis as force and moment that nothing explains: so long as the trunk is such a segment, the pelvis
residual says how it moves, and nothing of masses. Torques of the legs are summed from the feet upwards and do not
depend on it.

Which trials of a study have forces that are at fault: asked before any force moves a parameter.

It is the residual after the joint parameters and with nominal masses that tells: inertial parameters, and joint ones
fitted with them, take a fault of the forces up (a clock 66 ms late leaves 96 N before and 7 N after).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import BoolArray
from gaitcal.calibration.joint_phases import JointCalibration, Phase
from gaitcal.calibration.joint_prior import prior_of_study
from gaitcal.codes import Code
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.faults.after_fit import TrackedMarkers, impossible, large_changes, marker_findings
from gaitcal.faults.force_diagnosis import ForceDiagnosis, force_findings
from gaitcal.faults.force_evidence import force_evidence
from gaitcal.faults.joint_places import joint_place_findings
from gaitcal.faults.one_marker import TOPIC as ONE_MARKER
from gaitcal.faults.verdict import touches_model
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.linkage import JOINT_OF_CHILD, LOWER_BODY
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, impossible_bodies, table
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.session.prepare import PreparedTrial
from gaitcal.session.result import TrialResult
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study

WORSE_M, WORSE = 5e-4, 0.02
"""m, and share of the nominal error, by how much markers are met worse before it is told."""


def calibration_findings(
    study: Study,
    results: Sequence[TrialResult],
    parameters: Parameters,
    phases: Sequence[Phase],
    nominal: SubjectModel,
    joint: JointCalibration | None,
) -> tuple[Finding, ...]:
    """What the figures of a calibration that ended with `parameters` put in doubt."""
    isolated = {t.joint for t in results if t.joint is not None}
    settings, places = study.settings, tuple[Finding, ...]()
    if joint is not None:
        prior = prior_of_study(settings.joint_prior, study.joint_prior)
        places = tuple(joint_place_findings(nominal, parameters, joint.influence, prior, isolated))
    return (*bodies_that_cannot_be(settings, parameters), *disagreements(results), *unfinished(phases), *places)


def bodies_that_cannot_be(settings: CalibrationSettings, parameters: Parameters) -> Iterator[Finding]:
    """Inertial parameters that no real body has, which only the published cost can find."""
    bodies = impossible_bodies(parameters.inertial)
    if not bodies:
        return
    left_out = "; the third step needs possible ones and was left out" if settings.joint_step else ""
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
        segments = () if t.joint else LOWER_BODY  # arms that were raised in the static trial would hide worse legs
        first, last = t.nominal.errors.rms(*segments), t.final.errors.rms(*segments)
        if first is not None and last is not None and last > max(first + WORSE_M, (1 + WORSE) * first):
            yield Finding(
                severity=Severity.WARNING,
                topic="trials",
                where=t.name,
                cause="the trials disagree about the joints",
                found=f"with the final model its markers are met worse ({1e3 * last:.1f} mm) than with the nominal one "
                f"({1e3 * first:.1f} mm)",
                cure="see whether the trials are of one person with the markers in one place; leave the odd one out",
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


def trial_findings(
    problem: TrialProblem,
    parameters: Parameters,
    motion: Motion,
    nominal: Motion,
    weight: float,
    moments: Moments | None,
    reactions: GroundReactions | None,
) -> tuple[Finding, ...]:
    """Findings on one trial whose whole body was tracked with the final `parameters`.

    Parameters
    ----------
    problem, motion : the whole body.
    nominal : the motion with the nominal model, of the whole body or a part.
    weight : of the body, N.
    moments, reactions : final generalised forces, and where they mean something; None without force plates.
    """
    valid, legs = (None, None) if reactions is None else (reactions.valid, reactions.valid_legs)
    markers = marker_findings(tracked_markers(problem, parameters, motion))
    return (*markers, *impossible(motion, weight, moments, valid, legs), *large_changes(nominal, motion, valid))


def tracked_markers(problem: TrialProblem, parameters: Parameters, motion: Motion) -> TrackedMarkers:
    """Measured markers beside the model's."""
    measured = problem.data.measured.transpose(2, 0, 1)
    seen: BoolArray = np.any(measured != 0.0, axis=2)
    return TrackedMarkers(
        name=motion.name,
        time=motion.time,
        labels=problem.labels,
        segments=motion.errors.segments,
        weight=motion.errors.weight,
        measured=np.where(seen[:, :, None], measured, np.nan),
        model=problem.positions(motion.nodes, problem.constants(parameters)).transpose(2, 0, 1),
    )


TRUNK = "head_trunk"
_WORDS = {TRUNK: "head and trunk", "upper_arm": "upper arms", "forearm_hand": "forearms and hands"}


def is_trunk_unmeasured(motion: Motion) -> bool:
    """Whether the markers of a whole-body motion leave open how the trunk turns."""
    return TRUNK in _unmeasured(motion)


def unmeasured_share(motion: Motion, parameters: Parameters) -> float:
    """Share (0 to 1) of the body's mass in segments of the upper body that markers do not determine."""
    mass = dict(zip(MASSIVE_SEGMENTS, table(parameters.inertial)[:, 0], strict=True))
    return float(sum(mass[segment] for segment in _unmeasured(motion)) / sum(mass.values()))


def unmeasured_words(motion: Motion, parameters: Parameters) -> str:
    """The same in words ("head and trunk, upper arms: 44 % of the body's mass"); nothing where none is."""
    parts = dict.fromkeys(_WORDS.get(s, _WORDS.get(s[:-2], s)) for s in _unmeasured(motion))
    return f"{', '.join(parts)}: {100 * unmeasured_share(motion, parameters):.0f} % of the body's mass" if parts else ""


def _unmeasured(motion: Motion) -> tuple[str, ...]:
    turns = {s: {e.name for e in JOINT_OF_CHILD[s].elements} for s in MASSIVE_SEGMENTS if s not in LOWER_BODY}
    return tuple(s for s, names in turns.items() if names & set(motion.guessed))


def unmeasured_mass(results: Sequence[TrialResult], parameters: Parameters) -> Iterator[Finding]:
    """Mass whose motion no marker determines, and the pelvis residual that it makes: no doubt of leg torques."""
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
        found="a trunk is taken to stay upright, arms to hang along it, unless markers say otherwise; how they really "
        f"move is the first cause of the pelvis residual (up to {force:.0f} N and {moment:.0f} N·m RMS){where} and in "
        "the error bars of pelvis and trunk, and inertial parameters are not fitted against it; torques of the legs "
        "are summed from the feet upwards and do not depend on it",
        cure="three markers on the thorax that do not lie on one line (C7, T10, jugular notch, xiphoid) in all trials",
        code=Code.UNMEASURED_MASS,
    )


def spoilt_motions(checked: Sequence[Finding]) -> frozenset[str]:
    """Trials whose markers do not tell how a leg moves: their motion asks for forces that nobody exerted."""
    return frozenset(f.where for f in checked if f.leg and f.severity is Severity.ERROR and touches_model(f.topic))


def diagnose_forces(
    trials: Sequence[PreparedTrial],
    model: SubjectModel,
    parameters: Parameters,
    motions: Mapping[str, Motion],
    reactions: Mapping[str, GroundReactions],
    checked: Sequence[Finding] = (),
) -> ForceDiagnosis:
    """What is wrong with the forces of the trials that have `reactions`, by motions with `parameters`.

    Inertial parameters are those of `model.nominal`, whatever `parameters` has. What the checks said of the markers
    tells whose motion is doubtful.
    """
    doubtful = spoilt_motions(checked) | {f.where for f in checked if f.topic == ONE_MARKER and f.cause}
    parameters = parameters.with_inertial(model.nominal.inertial)
    if impossible_bodies(parameters.inertial):
        return ForceDiagnosis()
    evidence = (
        force_evidence(t.trial, t.recording, model, parameters, motions[t.name], reactions[t.name])
        for t in trials
        if t.name in reactions
    )
    return force_findings([replace(one, doubtful=one.name in doubtful) for one in evidence if one is not None])


def left_out_of_masses(trials: Sequence[PreparedTrial], faulty: Collection[str], spoilt: Collection[str]) -> list[str]:
    """Notes on the trials that say nothing of masses."""
    words = {
        "forces at fault say nothing of masses": [t.name for t in trials if t.name in faulty],
        "a leg that its markers do not show says nothing of masses": [
            t.name for t in trials if t.joint is None and t.name in spoilt and t.name not in faulty
        ],
    }
    return [f"inertial parameters: {why}; left out: {', '.join(names)}" for why, names in words.items() if names]
