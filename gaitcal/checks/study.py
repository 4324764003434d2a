"""All checks over a whole study: reads everything, solves nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gaitcal.checks import (
    contacts,
    direction,
    exchanged,
    force_direction,
    labels,
    lengths,
    plates,
    sampling,
    standing,
    visibility,
)
from gaitcal.checks.evidence import Evidence, TrialEvidence
from gaitcal.checks.finding import Finding, Severity
from gaitcal.errors import InputError
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, StudyTrial, read_trial
from gaitcal.study.study_file import load_study_file

TrialCheck: TypeAlias = Callable[[TrialEvidence], Iterator[Finding]]

UNIT_CHECKS: tuple[TrialCheck, ...] = (lengths.size, lengths.scale)
"""Where these find an error, distances mean nothing, and the other checks of the trial are left out."""

TRIAL_CHECKS: tuple[TrialCheck, ...] = (
    labels.missing,
    labels.too_few,
    labels.never_seen,
    labels.unknown,
    labels.doubled,
    labels.bare_segments,
    direction.upright,
    direction.heading,
    direction.sides,
    exchanged.exchanged,
    exchanged.spikes,
    visibility.gaps,
    visibility.frozen,
    visibility.flat,
    standing.length,
    standing.stillness,
    lengths.body_height,
    sampling.rate,
    sampling.header_rate,
    sampling.speed,
    sampling.splines,
    plates.told_on_reading,
    plates.signals,
    plates.corners,
    plates.body_mass,
    contacts.covered,
    contacts.contacts,
    force_direction.horizontal,
    force_direction.beside_feet,
    force_direction.carried_mass,
)


def check_file(path: Path | str) -> tuple[Finding, ...]:
    """Check the study file at `path` and everything that it names; a file that cannot be read is a finding too."""
    path = Path(path)
    try:
        file = load_study_file(path)
        marker_set = load_marker_set(file.markers.set)
    except InputError as fault:
        return (standing.fault_of(fault, "study", str(path), "study file"),)
    trials: list[StudyTrial] = []
    unreadable: list[Finding] = []
    for trial in file.trials:
        try:
            trials.append(read_trial(trial, file.markers.rename, marker_set))
        except InputError as fault:
            unreadable.append(standing.fault_of(fault, trial.name, str(trial.file), "reading"))
    if unreadable:
        return tuple(unreadable)
    try:
        study = Study.assemble(file, marker_set, tuple(trials), path)
    except InputError as fault:
        return (standing.fault_of(fault, "study", str(path), "study file"),)
    return check_study(study)


@np.errstate(all="ignore")  # absurd numbers of a damaged file may overflow on their way to a message
def check_study(study: Study) -> tuple[Finding, ...]:
    """All findings on a study whose files could be read, the worst first within each trial."""
    marker_set = study.marker_set.with_weights(study.weights)
    plain = [TrialEvidence(t, marker_set, study.subject, study.settings, None) for t in study.trials]
    spoilt = {t.name: list(lengths.size(t)) for t in plain}
    model: SubjectModel | None = None
    faults: tuple[Finding, ...] = ()
    if not spoilt[study.static.name]:
        model, faults = standing.nominal_model_of(study)
    trials = tuple(TrialEvidence(t.trial, marker_set, study.subject, study.settings, model) for t in plain)
    findings: list[Finding] = []
    for trial in trials:
        own = [*(faults if trial.is_static else ()), *_trial(trial)]
        findings += sorted(own, key=lambda finding: list(Severity).index(finding.severity))
    findings += sampling.rates_differ(Evidence(trials))
    findings += sampling.same_recording(Evidence(trials))
    return tuple(findings)


@np.errstate(all="ignore")  # absurd numbers of a damaged file may overflow on their way to a message
def check_further(
    trial: StudyTrial, model: SubjectModel, marker_set: MarkerSet, settings: CalibrationSettings
) -> tuple[Finding, ...]:
    """All findings on one further trial against a saved model and its marker set, the worst first."""
    found = _trial(TrialEvidence(trial, marker_set, model.subject, settings, model))
    return tuple(sorted(found, key=lambda finding: list(Severity).index(finding.severity)))


def _trial(trial: TrialEvidence) -> list[Finding]:
    units = [finding for check in UNIT_CHECKS for finding in check(trial)]
    if any(finding.severity is Severity.ERROR for finding in units):
        return units[:1]
    return units + [finding for check in TRIAL_CHECKS for finding in check(trial)]
