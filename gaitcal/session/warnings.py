"""What speaks against a finished calibration: one finding for each thing that its own figures put in doubt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gaitcal.calibration.joint_phases import JointCalibration, Phase
from gaitcal.calibration.joint_prior import prior_of_study
from gaitcal.codes import Code
from gaitcal.faults.joint_places import joint_place_findings
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.inertial_parameters import impossible_bodies
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
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
