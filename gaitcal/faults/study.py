"""All checks over a whole study: reads everything, solves nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gaitcal.errors import InputError
from gaitcal.faults import (
    exchanged,
    foot_on_plate,
    joint_places,
    knee_line,
    knocked,
    marker_slip,
    markers,
    plates,
    role,
    sampling,
    static_consistency,
    static_landmarks,
)
from gaitcal.faults.cluster import Stance
from gaitcal.faults.contradiction import PossibleMove, possible_moves
from gaitcal.faults.evidence import MarkerEvidence
from gaitcal.faults.verdict import SPOILS_BODY, without_consequences
from gaitcal.findings import Finding, Severity
from gaitcal.model.linkage import SEGMENTS, joint_segments
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import JOINT_PARAMETERS, Kind
from gaitcal.model.subject_model import SubjectModel
from gaitcal.runtime import remembered, with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, cleaned, completed_static, marker_set_of
from gaitcal.study.study_file import StudyFile, TrialTable, load_study_file
from gaitcal.study.study_trial import Trial, read_trial

MOST_PLACED = 3
"""Clusters; more that were knocked are another static posture."""
TrialCheck: TypeAlias = Callable[[MarkerEvidence], Iterator[Finding]]

UNIT_CHECKS: tuple[TrialCheck, ...] = (static_consistency.size, static_consistency.scale)
"""Where these find an error, distances mean nothing, and the other checks of the trial are left out."""

TRIAL_CHECKS: tuple[TrialCheck, ...] = (
    markers.outliers,
    markers.missing,
    markers.rebuilt,
    markers.not_rebuilt,
    markers.too_few,
    markers.never_seen,
    markers.one_sacral,
    markers.unknown,
    markers.doubled,
    markers.bare_segments,
    markers.followed,
    role.upright,
    role.heading,
    exchanged.sides,
    exchanged.exchanged,
    sampling.spikes,
    sampling.seam,
    markers.gaps,
    marker_slip.frozen,
    marker_slip.flat,
    marker_slip.marker_slip,
    role.declared_joint,
    role.one_joint_alone,
    role.length,
    role.stillness,
    static_landmarks.proportions,
    role.standing_straight,
    role.standing_flat,
    joint_places.given_hips,
    markers.on_segments,
    sampling.rate,
    sampling.header_rate,
    sampling.speed,
    sampling.splines,
    plates.told_on_reading,
    plates.signals,
    plates.corners,
    plates.step_loads,
    plates.covered,
    foot_on_plate.contacts,
    plates.horizontal,
    plates.free_moment,
    plates.beside_feet,
)

OF_SKIN: tuple[TrialCheck, ...] = (
    exchanged.exchanged,
    marker_slip.marker_slip,
    markers.doubled,
    markers.on_segments,
    role.standing_straight,
    role.standing_flat,
    static_landmarks.proportions,
)
"""These ask where a hand put each marker, and whether it stayed there: nothing to ask of points that are no markers."""


@with_one_blas_thread
def check_file(path: Path | str) -> tuple[Finding, ...]:
    """Check the study file at `path` and everything that it names; a file that cannot be read is a finding too."""
    path = Path(path)
    try:
        file = load_study_file(path)
        marker_set = marker_set_of(file, path)
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


@np.errstate(all="ignore")  # absurd numbers of a damaged file may overflow on their way to a message
@with_one_blas_thread
def check_study(study: Study) -> tuple[Finding, ...]:
    """All findings on a study whose files could be read, the worst first within each trial."""
    study, placed = placed_by_motion(study)
    _, faults, trials = _looked_at(study)
    findings: list[Finding] = [one.finding for one in placed]
    measured: list[MarkerEvidence] = []
    for trial in trials:
        found = _check_trial(trial)
        findings += _worst_first(without_consequences([*(faults if trial.name == study.static.name else ()), *found]))
        if not any(f.topic in SPOILS_BODY and f.severity is Severity.ERROR for f in found):
            measured.append(trial)
    if study.static.name in [trial.name for trial in measured] and study.marker_set.noise is None:
        findings += static_consistency.static_consistency(measured)
    return (
        *findings,
        *(knee_line.knee_lines(measured, findings) if study.marker_set.noise is None else ()),
        *plates.body_mass(trials),
        *sampling.rates_differ(trials),
        *sampling.same_recording(trials),
        *role.statics_agree(trials),
    )


@remembered
def placed_by_motion(study: Study) -> tuple[Study, tuple[knocked.Placement, ...]]:
    """The study with knocked clusters where its moving trials have them, and which these are; as it is where one that
    was placed still does not agree with some trial.
    """
    placed, found = study, tuple[knocked.Placement, ...]()
    while len(found) < MOST_PLACED:
        static, moving = (tuple(t for t in _looked_at(placed)[2] if t.is_static is still) for still in (True, False))
        causes = {cause.segment for t in moving for cause in static_consistency.contradictions_in(t)}
        if not causes.isdisjoint(one.segment for one in found) or len(static) != 1:
            return study, ()
        one = knocked.placement(moving)
        if one is None:
            break
        placed, found = knocked.with_placement(placed, static[0], one), (*found, one)
    return placed, found


@remembered
def moves_since_static(study: Study) -> dict[str, dict[str, PossibleMove]]:
    """Trial -> segment that it is fitted by -> what its markers may have done since the static trial; a cluster that
    was put back is as uncertain as its place.
    """
    out = dict[str, dict[str, PossibleMove]]()
    placed = {p.segment: study.loosened.get(p.name, 0.0) for p in JOINT_PARAMETERS if p.kind is Kind.ORIENTATION}
    for t in _looked_at(study)[2] if study.marker_set.noise is None else ():
        fitted = SEGMENTS if t.trial.joint is None else joint_segments(t.trial.joint)
        moves = {s: move for s, move in possible_moves(t.clusters, t.links).items() if s in fitted}
        out[t.name] = {s: replace(m, turn=np.hypot(m.turn, placed.get(s, 0.0))) for s, m in moves.items()}
    return out


def further_evidence(
    trial: Trial, model: SubjectModel, marker_set: MarkerSet, settings: CalibrationSettings
) -> MarkerEvidence:
    """What the checks look at, of one further trial against a saved model and its marker set."""
    return MarkerEvidence.of(trial, marker_set, model.subject, settings, model, Stance.of_model(model))


@np.errstate(all="ignore")
def further_moves(evidence: MarkerEvidence) -> dict[str, PossibleMove]:
    """What markers may have done, as `moves_since_static`, of one further trial."""
    of_markers = evidence.model is not None and evidence.model.noise is None
    return possible_moves(evidence.clusters, evidence.links) if of_markers else {}


@remembered
def _looked_at(study: Study) -> tuple[SubjectModel | None, tuple[Finding, ...], tuple[MarkerEvidence, ...]]:
    """The nominal model, or what keeps the static trial from giving one, and what the checks look at."""
    model, faults = None, tuple[Finding, ...]()
    if not any(static_consistency.size(_evidence(study, cleaned(study).static, None))):
        model, faults = role.nominal_model_of(study)
    return model, faults, evidence_of(study, model)


@np.errstate(all="ignore")
def check_further(evidence: MarkerEvidence) -> tuple[Finding, ...]:
    """All findings on one further trial (`further_evidence`), the worst first."""
    found = without_consequences(_check_trial(evidence))
    of_body = (*plates.body_mass((evidence,)), *static_consistency.static_consistency((evidence,)))
    return tuple(_worst_first([*found, *of_body]))


def evidence_of(study: Study, model: SubjectModel | None) -> tuple[MarkerEvidence, ...]:
    """What the checks look at, trial by trial, with the nominal model if there is one."""
    stance, completed = None, completed_static(study)
    if model is not None:
        rule = study.hip_centre
        whole = Stance.of_recording(completed.static, study.marker_set, model, rule)
        stance = whole.without(completed.labels)
    trials = [replace(_evidence(study, trial, model), stance=stance) for trial in cleaned(study).trials]
    return tuple(replace(t, rebuilding=completed) if t.name == study.static.name else t for t in trials)


def _evidence(study: Study, trial: Trial, model: SubjectModel | None) -> MarkerEvidence:
    marker_set = study.marker_set.with_weights(study.weights)
    return MarkerEvidence.of(trial, marker_set, study.subject, study.settings, model)


def _check_trial(trial: MarkerEvidence) -> list[Finding]:
    units = [finding for check in UNIT_CHECKS for finding in check(trial)]
    if any(finding.severity is Severity.ERROR for finding in units):
        return units[:1]
    asked = TRIAL_CHECKS
    if trial.marker_set.noise is not None:
        asked = tuple(check for check in TRIAL_CHECKS if check not in OF_SKIN)
    found = units + [finding for check in asked for finding in check(trial)]
    return [*found, *foot_on_plate.outside_sole(trial, found)]


def _worst_first(findings: Sequence[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: finding.severity.rank)
