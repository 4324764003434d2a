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
from gaitcal.quality.verdict import SPOILS_BODY, remove_consequences
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.study import Study, read_marker_set
from gaitcal.study.study_file import StudyFile, TrialTable, load_study_file
from gaitcal.study.study_trial import Trial, read_trial

TrialCheck: TypeAlias = Callable[[TrialEvidence], Iterator[Finding]]

UNIT_CHECKS: tuple[TrialCheck, ...] = (
    static_consistency.check_size,
    static_consistency.check_scale,
)
"""An error of these makes all distances meaningless: the other checks of the trial are skipped."""

AS_READ: tuple[TrialCheck, ...] = (label_checks.check_sides, label_checks.check_swapped_labels)
"""These check swapped labels; all others use the trial with swaps corrected."""

TRIAL_CHECKS: tuple[TrialCheck, ...] = (
    marker_checks.check_outliers,
    marker_checks.check_missing,
    marker_checks.check_reconstructed,
    marker_checks.check_not_reconstructed,
    marker_checks.check_base_segment,
    marker_checks.check_empty_labels,
    marker_checks.check_single_psis,
    marker_checks.check_unknown_labels,
    marker_checks.check_duplicates,
    marker_checks.check_bare_segments,
    marker_checks.check_single_markers,
    trial_role.check_upright,
    trial_role.check_heading,
    label_checks.check_sides,
    label_checks.check_swapped_labels,
    sampling.check_spikes,
    sampling.check_seams,
    marker_checks.check_gaps,
    marker_slip.check_frozen,
    marker_slip.check_constant_coordinates,
    marker_slip.check_displaced_markers,
    trial_role.check_declared_joint,
    trial_role.check_single_joint,
    trial_role.check_static_length,
    trial_role.check_stillness,
    static_landmarks.check_proportions,
    trial_role.check_straight_legs,
    trial_role.check_flat_feet,
    joint_positions.check_given_hips,
    marker_checks.check_marker_positions,
    sampling.check_rate,
    sampling.check_header_rate,
    sampling.check_speed,
    sampling.check_bandwidth,
    plate_checks.report_reader_notes,
    plate_checks.check_signals,
    plate_checks.check_corners,
    plate_checks.check_step_loads,
    plate_checks.check_time_overlap,
    foot_on_plate.check_contacts,
    plate_checks.check_horizontal_signs,
    plate_checks.check_free_moment_sign,
    plate_checks.check_pressure_beside_feet,
)

SKIN_MARKER_CHECKS: tuple[TrialCheck, ...] = (
    label_checks.check_swapped_labels,
    marker_slip.check_displaced_markers,
    marker_checks.check_duplicates,
    marker_checks.check_marker_positions,
    trial_role.check_straight_legs,
    trial_role.check_flat_feet,
    static_landmarks.check_proportions,
)
"""These check the placement of markers on the skin: not for computed points without markers."""


@with_one_blas_thread
def check_file(path: Path | str) -> tuple[Finding, ...]:
    """Check a study file and everything that it names.

    Parameters
    ----------
    path
        The study file.

    Returns
    -------
    tuple of Finding
        As of `check_study`; a file that cannot be read is a finding as well.
    """
    path = Path(path)
    try:
        file = load_study_file(path)
        marker_set = read_marker_set(file, path)
        trials, unreadable = _read_trials(file, marker_set)
        if unreadable:
            return unreadable
        study = Study.assemble(file, marker_set, trials, path)
    except InputError as fault:
        return (Finding.from_error(fault, "study", str(path), "study file"),)
    return check_study(study)


def _read_trials(
    file: StudyFile, marker_set: MarkerSet
) -> tuple[tuple[Trial, ...], tuple[Finding, ...]]:
    """Read the trials; return those that can be read, and the reasons why others cannot."""

    def read_or_report(trial: TrialTable) -> Trial | Finding:
        try:
            return read_trial(trial, file.markers.rename, marker_set)
        except InputError as fault:
            return Finding.from_error(fault, trial.name, str(trial.file), "reading")

    found = [read_or_report(trial) for trial in file.trials]
    unreadable = tuple(trial for trial in found if isinstance(trial, Finding))
    return tuple(trial for trial in found if isinstance(trial, Trial)), unreadable


# numbers of a damaged file may overflow before a finding reports them
@np.errstate(all="ignore")
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
def check_preprocessed(prepared: PreprocessedStudy) -> tuple[Finding, ...]:
    """Check a preprocessed study, as `check_study` does.

    Parameters
    ----------
    prepared
        From `preprocess_study`.

    Returns
    -------
    tuple of Finding
        As of `check_study`.
    """
    study, static = prepared.study, prepared.study.static.name
    findings: list[Finding] = [one.finding for one in prepared.placed]
    measured: list[TrialEvidence] = []
    for trial in prepared.trials:
        found = _check_trial(trial)
        findings += _sort_worst_first(
            remove_consequences([*(prepared.faults if trial.name == static else ()), *found])
        )
        if not any(f.topic in SPOILS_BODY and f.severity is Severity.ERROR for f in found):
            measured.append(trial.with_labels_restored)
    if static in [trial.name for trial in measured] and study.marker_set.noise is None:
        findings += static_consistency.check_static_consistency(measured)
    return (
        *findings,
        *(knee_axes.check_knee_lines(measured, findings) if study.marker_set.noise is None else ()),
        *named_joint_centres.check_named_centres(prepared.trials),
        *plate_checks.check_body_mass(prepared.trials),
        *sampling.check_equal_rates(prepared.trials),
        *sampling.check_duplicate_recordings(prepared.trials),
        *trial_role.check_statics_agree(prepared.trials),
    )


@np.errstate(all="ignore")
def check_further(evidence: TrialEvidence) -> tuple[Finding, ...]:
    """Check a further trial of a calibrated subject.

    Parameters
    ----------
    evidence
        From `preprocess_trial`.

    Returns
    -------
    tuple of Finding
        The worst first.
    """
    found = remove_consequences(_check_trial(evidence))
    of_body = (
        *plate_checks.check_body_mass((evidence,)),
        *static_consistency.check_static_consistency((evidence.with_labels_restored,)),
    )
    return tuple(_sort_worst_first([*found, *of_body]))


def _check_trial(trial: TrialEvidence) -> list[Finding]:
    """Run all checks of a single trial."""
    units = [finding for check in UNIT_CHECKS for finding in check(trial)]
    if any(finding.severity is Severity.ERROR for finding in units):
        return units[:1]
    checks = TRIAL_CHECKS
    # computed points, as of a markerless system, are not placed on the skin
    if trial.marker_set.noise is not None:
        checks = tuple(check for check in TRIAL_CHECKS if check not in SKIN_MARKER_CHECKS)
    corrected = trial.with_labels_restored
    found = units
    for check in checks:
        found += check(trial if check in AS_READ else corrected)
    return [*found, *foot_on_plate.check_pressure_outside_sole(corrected, found)]


def _sort_worst_first(findings: Sequence[Finding]) -> list[Finding]:
    """Sort findings by severity."""
    return sorted(findings, key=lambda finding: finding.severity.rank)
