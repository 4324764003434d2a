"""All checks of a study or of a further trial, before anything is fitted.

They read what `preprocess/preprocessed_study.py` has prepared, and change nothing.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gaitcal.errors import Finding, InputError, Severity
from gaitcal.model.marker_set import MarkerSet
from gaitcal.preprocess.preprocessed_study import PreprocessedStudy, preprocess_study
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality import (
    foot_on_plate,
    joint_positions,
    knee_axes,
    label_checks,
    marker_checks,
    marker_slip,
    named_joint_centres,
    plate_checks,
    sampling,
    static_consistency,
    static_landmarks,
    trial_role,
)
from gaitcal.quality.verdict import SPOILS_BODY, without_consequences
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.study import Study, read_marker_set
from gaitcal.study.study_file import StudyFile, TrialTable, load_study_file
from gaitcal.study.study_trial import Trial, read_trial

TrialCheck: TypeAlias = Callable[[TrialEvidence], Iterator[Finding]]

UNIT_CHECKS: tuple[TrialCheck, ...] = (static_consistency.size, static_consistency.scale)
"""Where these find an error, distances mean nothing, and the other checks of the trial are left
out.
"""

AS_READ: tuple[TrialCheck, ...] = (label_checks.sides, label_checks.exchanged)
"""These look for exchanged labels; all others see the trial with what was exchanged undone."""

TRIAL_CHECKS: tuple[TrialCheck, ...] = (
    marker_checks.outliers,
    marker_checks.missing,
    marker_checks.rebuilt,
    marker_checks.not_rebuilt,
    marker_checks.too_few,
    marker_checks.never_seen,
    marker_checks.one_sacral,
    marker_checks.unknown,
    marker_checks.doubled,
    marker_checks.bare_segments,
    marker_checks.followed,
    trial_role.upright,
    trial_role.heading,
    label_checks.sides,
    label_checks.exchanged,
    sampling.spikes,
    sampling.seam,
    marker_checks.gaps,
    marker_slip.frozen,
    marker_slip.flat,
    marker_slip.marker_slip,
    trial_role.declared_joint,
    trial_role.one_joint_alone,
    trial_role.length,
    trial_role.stillness,
    static_landmarks.proportions,
    trial_role.standing_straight,
    trial_role.standing_flat,
    joint_positions.given_hips,
    marker_checks.on_segments,
    sampling.rate,
    sampling.header_rate,
    sampling.speed,
    sampling.splines,
    plate_checks.told_on_reading,
    plate_checks.signals,
    plate_checks.corners,
    plate_checks.step_loads,
    plate_checks.covered,
    foot_on_plate.contacts,
    plate_checks.horizontal,
    plate_checks.free_moment,
    plate_checks.beside_feet,
)

OF_SKIN: tuple[TrialCheck, ...] = (
    label_checks.exchanged,
    marker_slip.marker_slip,
    marker_checks.doubled,
    marker_checks.on_segments,
    trial_role.standing_straight,
    trial_role.standing_flat,
    static_landmarks.proportions,
)
"""These ask where a hand put each marker, and whether it stayed there: nothing to ask of points
that are no markers.
"""


@with_one_blas_thread
def check_file(path: Path | str) -> tuple[Finding, ...]:
    """Check the study file at `path` and everything that it names; a file that cannot be read is a
    finding too.
    """
    path = Path(path)
    try:
        file = load_study_file(path)
        marker_set = read_marker_set(file, path)
        trials, unreadable = _read(file, marker_set)
        if unreadable:
            return unreadable
        study = Study.assemble(file, marker_set, trials, path)
    except InputError as fault:
        return (Finding.of_fault(fault, "study", str(path), "study file"),)
    return check_study(study)


def _read(file: StudyFile, marker_set: MarkerSet) -> tuple[tuple[Trial, ...], tuple[Finding, ...]]:
    """The trials that can be read, and why the others cannot."""

    def read(trial: TrialTable) -> Trial | Finding:
        try:
            return read_trial(trial, file.markers.rename, marker_set)
        except InputError as fault:
            return Finding.of_fault(fault, trial.name, str(trial.file), "reading")

    found = [read(trial) for trial in file.trials]
    unreadable = tuple(trial for trial in found if isinstance(trial, Finding))
    return tuple(trial for trial in found if isinstance(trial, Trial)), unreadable


@np.errstate(
    all="ignore"
)  # absurd numbers of a damaged file may overflow on their way to a message
@with_one_blas_thread
def check_study(study: Study) -> tuple[Finding, ...]:
    """Check the recordings of a study before anything is fitted, as `gaitcal check` does.

    Parameters
    ----------
    study
        From `Study.load`.

    Returns
    -------
    tuple of Finding
        Each with severity, trial, cause, evidence, remedy and code; within a trial the worst first.
    """
    return check_preprocessed(preprocess_study(study))


@np.errstate(all="ignore")
@with_one_blas_thread
def check_preprocessed(of: PreprocessedStudy) -> tuple[Finding, ...]:
    """Check a study that is prepared, as `check_study` does.

    Parameters
    ----------
    of
        From `preprocess_study`.

    Returns
    -------
    tuple of Finding
        As of `check_study`.
    """
    study, static = of.study, of.study.static.name
    findings: list[Finding] = [one.finding for one in of.placed]
    measured: list[TrialEvidence] = []
    for trial in of.trials:
        found = _check_trial(trial)
        findings += _worst_first(
            without_consequences([*(of.faults if trial.name == static else ()), *found])
        )
        if not any(f.topic in SPOILS_BODY and f.severity is Severity.ERROR for f in found):
            measured.append(trial.with_labels_restored)
    if static in [trial.name for trial in measured] and study.marker_set.noise is None:
        findings += static_consistency.static_consistency(measured)
    return (
        *findings,
        *(knee_axes.knee_lines(measured, findings) if study.marker_set.noise is None else ()),
        *named_joint_centres.named_centres(of.trials),
        *plate_checks.body_mass(of.trials),
        *sampling.rates_differ(of.trials),
        *sampling.same_recording(of.trials),
        *trial_role.statics_agree(of.trials),
    )


@np.errstate(all="ignore")
def check_further(evidence: TrialEvidence) -> tuple[Finding, ...]:
    """All findings on one further trial (`preprocess_trial`), the worst first."""
    found = without_consequences(_check_trial(evidence))
    of_body = (
        *plate_checks.body_mass((evidence,)),
        *static_consistency.static_consistency((evidence.with_labels_restored,)),
    )
    return tuple(_worst_first([*found, *of_body]))


def _check_trial(trial: TrialEvidence) -> list[Finding]:
    units = [finding for check in UNIT_CHECKS for finding in check(trial)]
    if any(finding.severity is Severity.ERROR for finding in units):
        return units[:1]
    asked = TRIAL_CHECKS
    if trial.marker_set.noise is not None:
        asked = tuple(check for check in TRIAL_CHECKS if check not in OF_SKIN)
    mended = trial.with_labels_restored
    found = units + [f for check in asked for f in check(trial if check in AS_READ else mended)]
    return [*found, *foot_on_plate.outside_sole(mended, found)]


def _worst_first(findings: Sequence[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: finding.severity.rank)
