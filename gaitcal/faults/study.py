"""All checks over a whole study: reads everything, solves nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults import (
    body_size,
    contacts,
    direction,
    exchanged,
    hip_centres,
    jumps,
    knee_lines,
    marker_slip,
    markers,
    moving_joint,
    one_marker,
    outside_sole,
    plates,
    sampling,
    standing,
    static_consistency,
    static_landmarks,
)
from gaitcal.faults import jumps as frozen
from gaitcal.faults import markers as lost_markers
from gaitcal.faults import markers as marker_places
from gaitcal.faults import plates as free_moment
from gaitcal.faults import standing as posture
from gaitcal.faults import standing as several_statics
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.stance import Stance
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, cleaned, completed_static
from gaitcal.study.study_file import StudyFile, Trial, load_study_file
from gaitcal.study.study_trial import StudyTrial, read_trial

OTHER_RATE = 2.5
"""Laboratories record at 50 and 100, or 100 and 200 Hz; a time column that is wrong may be wrong by more."""

TrialCheck: TypeAlias = Callable[[TrialEvidence], Iterator[Finding]]

UNIT_CHECKS: tuple[TrialCheck, ...] = (body_size.size, body_size.scale)
"""Where these find an error, distances mean nothing, and the other checks of the trial are left out."""

TRIAL_CHECKS: tuple[TrialCheck, ...] = (
    markers.strays,
    markers.missing,
    lost_markers.rebuilt,
    lost_markers.not_rebuilt,
    markers.too_few,
    markers.never_seen,
    markers.one_sacral,
    markers.unknown,
    markers.doubled,
    markers.bare_segments,
    one_marker.followed,
    direction.upright,
    direction.heading,
    direction.sides,
    exchanged.exchanged,
    jumps.spikes,
    jumps.seam,
    markers.gaps,
    frozen.frozen,
    frozen.flat,
    marker_slip.marker_slip,
    moving_joint.declared_joint,
    moving_joint.one_joint_alone,
    standing.length,
    standing.stillness,
    static_landmarks.proportions,
    posture.standing_straight,
    posture.standing_flat,
    hip_centres.given,
    marker_places.on_segments,
    sampling.rate,
    sampling.header_rate,
    sampling.speed,
    sampling.splines,
    plates.told_on_reading,
    plates.signals,
    plates.corners,
    body_size.standing,
    body_size.stepping,
    contacts.covered,
    contacts.contacts,
    plates.horizontal,
    free_moment.free_moment,
    plates.beside_feet,
    body_size.carried_mass,
)


CONSEQUENCES = {
    "landmarks": ("static trial", "posture", "sides", "axes", "marker places"),
    "axes": ("sides", "exchanged", "heading", "plate to foot", "plates", "time", "joint"),
    "sides": ("exchanged", "heading", "plate to foot", "plates", "joint"),
}
"""Topic of an error whose cause is known -> topics of the same trial that it puts in disorder by itself."""


NO_BODY = ("units", "axes", "sides", "landmarks")
"""Topics of errors of a trial that are told already and put its whole body in disorder against the other trials'."""


@with_one_blas_thread
def check_file(path: Path | str) -> tuple[Finding, ...]:
    """Check the study file at `path` and everything that it names; a file that cannot be read is a finding too."""
    path = Path(path)
    try:
        file = load_study_file(path)
        marker_set = load_marker_set(file.markers.set)
        trials, unreadable = _read(file, marker_set)
        if unreadable:
            return unreadable
        study = Study.assemble(file, marker_set, trials, path)
    except InputError as fault:
        return (Finding.of_fault(fault, "study", str(path), "study file"),)
    return check_study(study)


def _read(file: StudyFile, marker_set: MarkerSet) -> tuple[tuple[StudyTrial, ...], tuple[Finding, ...]]:
    """The trials that can be read, and why the others cannot."""

    def read(trial: Trial) -> StudyTrial | Finding:
        try:
            return read_trial(trial, file.markers.rename, marker_set)
        except InputError as fault:
            return Finding.of_fault(fault, trial.name, str(trial.file), "reading")

    found = [read(trial) for trial in file.trials]
    unreadable = tuple(trial for trial in found if isinstance(trial, Finding))
    return tuple(trial for trial in found if isinstance(trial, StudyTrial)), unreadable


@np.errstate(all="ignore")  # absurd numbers of a damaged file may overflow on their way to a message
@with_one_blas_thread
def check_study(study: Study) -> tuple[Finding, ...]:
    """All findings on a study whose files could be read, the worst first within each trial."""
    model: SubjectModel | None = None
    faults: tuple[Finding, ...] = ()
    if not any(body_size.size(_evidence(study, cleaned(study).static, None))):
        model, faults = standing.nominal_model_of(study)
    trials = evidence_of(study, model)
    findings: list[Finding] = []
    measured: list[TrialEvidence] = []
    for trial in trials:
        found = _check_trial(trial)
        findings += _worst_first(_without_consequences([*(faults if trial.name == study.static.name else ()), *found]))
        if _shows_body(found):
            measured.append(trial)
    if study.static.name in [trial.name for trial in measured]:
        findings += static_consistency.static_consistency(measured)
    return (
        *findings,
        *knee_lines.knee_lines(measured, findings),
        *rates_differ(trials),
        *same_recording(trials),
        *several_statics.statics_agree(trials),
    )


@np.errstate(all="ignore")
def check_further(
    trial: StudyTrial, model: SubjectModel, marker_set: MarkerSet, settings: CalibrationSettings
) -> tuple[Finding, ...]:
    """All findings on one further trial against a saved model and its marker set, the worst first."""
    evidence = TrialEvidence.of(trial, marker_set, model.subject, settings, model, Stance.of_model(model))
    found = _without_consequences(_check_trial(evidence))
    return tuple(_worst_first([*found, *static_consistency.static_consistency((evidence,))]))


def evidence_of(study: Study, model: SubjectModel | None) -> tuple[TrialEvidence, ...]:
    """What the checks look at, trial by trial, with the nominal model if there is one."""
    stance, completed = None, completed_static(study)
    if model is not None:
        rule = HipCentre(study.settings.hip_rule)
        whole = Stance.of_recording(completed.static, study.marker_set, model, rule)
        stance = whole.without(completed.labels)
    trials = [replace(_evidence(study, trial, model), stance=stance) for trial in cleaned(study).trials]
    return tuple(replace(t, rebuilding=completed) if t.name == study.static.name else t for t in trials)


def _evidence(study: Study, trial: StudyTrial, model: SubjectModel | None) -> TrialEvidence:
    marker_set = study.marker_set.with_weights(study.weights)
    return TrialEvidence.of(trial, marker_set, study.subject, study.settings, model)


def _shows_body(found: Sequence[Finding]) -> bool:
    return not any(finding.topic in NO_BODY and finding.severity is Severity.ERROR for finding in found)


def _check_trial(trial: TrialEvidence) -> list[Finding]:
    units = [finding for check in UNIT_CHECKS for finding in check(trial)]
    if any(finding.severity is Severity.ERROR for finding in units):
        return units[:1]
    found = units + [finding for check in TRIAL_CHECKS for finding in check(trial)]
    return [*found, *outside_sole.outside_sole(trial, found)]


def _without_consequences(findings: list[Finding]) -> list[Finding]:
    """The findings of one trial without what only follows from others."""
    causes = {f.topic for f in findings if f.severity is Severity.ERROR and f.cause}
    follows = {topic for cause in causes for topic in CONSEQUENCES.get(cause, ())}
    return [f for f in findings if f.topic not in follows]


def _worst_first(findings: list[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: finding.severity.rank)


def rates_differ(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Trials whose frame rate is not that of the others."""
    rates = {t.name: t.recording.rate for t in trials if len(t.recording.time) > 1}
    common = float(np.median(list(rates.values()))) if rates else 0.0
    odd = {name: rate for name, rate in rates.items() if abs(rate - common) > 0.01 * common}
    if odd and len(odd) < 0.5 * len(rates):
        far = any(not 1.0 / OTHER_RATE <= rate / common <= OTHER_RATE for rate in odd.values())
        yield Finding(
            severity=Severity.WARNING if far else Severity.INFO,
            topic="sampling",
            where=STUDY,
            cause="trials of one study have different frame rates",
            found=f"most have {common:.4g} Hz, but {', '.join(f'{name} {rate:.4g} Hz' for name, rate in odd.items())}",
            cure="look whether their time columns are right" if far else "as it should be, if recorded or exported so",
            code=Code.RATES_DIFFER,
        )


def same_recording(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Trials whose markers are the same in every frame, whatever their files are called: one would count twice.

    Parts of one long file, chosen by `time`, are trials of their own.
    """
    for one, other in combinations(trials, 2):
        a, b = one.recording, other.recording
        if a.labels != b.labels or not np.array_equal(a.markers[:1], b.markers[:1], equal_nan=True):
            continue  # one frame is soon compared, and tells most apart
        if np.array_equal(a.markers, b.markers, equal_nan=True):
            yield other.error(
                "trials",
                f"holds the same {len(b.time)} frames as trial '{one.name}' ({one.source})",
                "name the file of this trial, leave the trial out, or give each its part with time = [start, end]",
                code=Code.SAME_RECORDING,
            )
