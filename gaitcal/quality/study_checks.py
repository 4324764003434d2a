"""A study examined: its trials clean, its static trial whole, and all checks over them; solves
nothing.

`examined` is the one place where a study becomes a clean one. Checks and calibration read what it
gives.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gaitcal.errors import Finding, InputError, Severity
from gaitcal.model.linkage import SEGMENTS, joint_segments
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import JOINT_PARAMETERS, ParameterKind
from gaitcal.model.rebuilt_markers import Rebuilding
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess import knocked_clusters, swapped_labels
from gaitcal.preprocess.marker_clusters import Stance
from gaitcal.preprocess.static_disagreement import PossibleMove, contradictions_in, possible_moves
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality import (
    foot_on_plate,
    joint_positions,
    knee_axes,
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
from gaitcal.runtime import remembered, with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, cleaned, completed_static, nominal_of, read_marker_set
from gaitcal.study.study_file import StudyFile, TrialTable, load_study_file
from gaitcal.study.study_trial import Trial, read_trial

MOST_PLACED = 3  # Clusters; more that were knocked are another static posture
TrialCheck: TypeAlias = Callable[[TrialEvidence], Iterator[Finding]]

UNIT_CHECKS: tuple[TrialCheck, ...] = (static_consistency.size, static_consistency.scale)
"""Where these find an error, distances mean nothing, and the other checks of the trial are left
out.
"""

AS_READ: tuple[TrialCheck, ...] = (swapped_labels.sides, swapped_labels.exchanged)
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
    swapped_labels.sides,
    swapped_labels.exchanged,
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
    swapped_labels.exchanged,
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
    of, static = examined(study), study.static.name
    findings: list[Finding] = [one.finding for one in of.placed]
    measured: list[TrialEvidence] = []
    for trial in of.trials:
        found = _check_trial(trial)
        findings += _worst_first(
            without_consequences([*(of.faults if trial.name == static else ()), *found])
        )
        if not any(f.topic in SPOILS_BODY and f.severity is Severity.ERROR for f in found):
            measured.append(swapped_labels.undone(trial))
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


@dataclass(frozen=True, kw_only=True)
class Examined:
    """A study with clean trials, and what they are measured against."""

    study: Study
    """As it was read, but for knocked clusters of its static trial, which are where the moving
    trials have them.
    """
    completed: Rebuilding  # The static trial, with what the other trials give back to it
    model: (
        SubjectModel | None
    )  # Nominal; None where the static trial gives none, or its unit is wrong
    faults: tuple[Finding, ...]  # What keeps the static trial from giving a model
    trials: tuple[TrialEvidence, ...]
    """Every trial without markers metres away and positions out of line, cut to what shows the
    pelvis.
    """
    placed: tuple[knocked_clusters.Placement, ...]  # The clusters that were put back

    @property
    def moving(self) -> tuple[TrialEvidence, ...]:
        """The trials in which the person moves."""
        return tuple(trial for trial in self.trials if not trial.is_static)

    @property
    def nominal(self) -> SubjectModel:
        """The nominal model, also of a static trial in a wrong unit; InputError where there is
        none.
        """
        return self.model or nominal_of(self.study, self.completed)

    def moves(self) -> dict[str, dict[str, PossibleMove]]:
        """Trial -> segment that it is fitted by -> what its markers may have done since the static
        trial; a cluster that was put back is as uncertain as its place.
        """
        out, loosened = dict[str, dict[str, PossibleMove]](), self.study.loosened
        placed = {
            p.segment: loosened.get(p.name, 0.0)
            for p in JOINT_PARAMETERS
            if p.kind is ParameterKind.ORIENTATION
        }
        for t in self.trials if self.study.marker_set.noise is None else ():
            fitted = SEGMENTS if t.trial.joint is None else joint_segments(t.trial.joint)
            moves = {
                s: move for s, move in possible_moves(t.clusters, t.links).items() if s in fitted
            }
            out[t.name] = {
                s: replace(m, turn=np.hypot(m.turn, placed.get(s, 0.0))) for s, m in moves.items()
            }
        return out


@remembered
@np.errstate(all="ignore")
def examined(study: Study) -> Examined:
    """The study with clean trials, and with knocked clusters where its moving trials have them;
    these are as they were where one that was placed still does not agree with some trial.
    """
    first = found = _examined(study, ())
    while len(found.placed) < MOST_PLACED:
        causes = {cause.segment for t in found.moving for cause in contradictions_in(t)}
        static = [trial for trial in found.trials if trial.is_static]
        if not causes.isdisjoint(one.segment for one in found.placed) or len(static) != 1:
            return first
        one = knocked_clusters.placement(found.moving)
        if one is None:
            break
        found = _examined(
            knocked_clusters.with_placement(found.study, static[0], one), (*found.placed, one)
        )
    return found


def _examined(study: Study, placed: tuple[knocked_clusters.Placement, ...]) -> Examined:
    """Its trials cleaned, its static trial completed, its nominal model."""
    clean, marker_set = cleaned(study), study.marker_set.with_weights(study.weights)
    static, completed = clean.static, completed_static(clean)
    trials = [
        TrialEvidence.of(trial, marker_set, study.subject, study.settings, None)
        for trial in clean.trials
    ]
    model, faults, stance = None, tuple[Finding, ...](), None
    if not any(
        finding for t in trials if t.trial is static for finding in static_consistency.size(t)
    ):
        try:
            model = nominal_of(clean, completed)
        except InputError as fault:
            faults = (
                Finding.of_fault(fault, static.name, static.recording.source, "static trial"),
            )
    if model is not None:
        whole = Stance.of_recording(completed.static, study.marker_set, model, study.hip_centre)
        stance = whole.without(completed.labels)
    return Examined(
        study=study,
        completed=completed,
        model=model,
        faults=faults,
        trials=tuple(
            swapped_labels.put_back(
                replace(
                    t,
                    model=model,
                    stance=stance,
                    rebuilding=completed if t.trial is static else None,
                )
            )
            for t in trials
        ),
        placed=placed,
    )


def further_evidence(
    trial: Trial, model: SubjectModel, marker_set: MarkerSet, settings: CalibrationSettings
) -> TrialEvidence:
    """What the checks look at, of one further trial against a saved model and its marker set."""
    found = TrialEvidence.of(
        trial, marker_set, model.subject, settings, model, Stance.of_model(model)
    )
    return swapped_labels.put_back(found)


@np.errstate(all="ignore")
def further_moves(evidence: TrialEvidence) -> dict[str, PossibleMove]:
    """What markers may have done, as `Examined.moves`, of one further trial."""
    of_markers = evidence.model is not None and evidence.model.noise is None
    return possible_moves(evidence.clusters, evidence.links) if of_markers else {}


@np.errstate(all="ignore")
def check_further(evidence: TrialEvidence) -> tuple[Finding, ...]:
    """All findings on one further trial (`further_evidence`), the worst first."""
    found = without_consequences(_check_trial(evidence))
    mended = swapped_labels.undone(evidence)
    of_body = (
        *plate_checks.body_mass((evidence,)),
        *static_consistency.static_consistency((mended,)),
    )
    return tuple(_worst_first([*found, *of_body]))


def _check_trial(trial: TrialEvidence) -> list[Finding]:
    units = [finding for check in UNIT_CHECKS for finding in check(trial)]
    if any(finding.severity is Severity.ERROR for finding in units):
        return units[:1]
    asked = TRIAL_CHECKS
    if trial.marker_set.noise is not None:
        asked = tuple(check for check in TRIAL_CHECKS if check not in OF_SKIN)
    mended = swapped_labels.undone(trial)
    found = units + [f for check in asked for f in check(trial if check in AS_READ else mended)]
    return [*found, *foot_on_plate.outside_sole(mended, found)]


def _worst_first(findings: Sequence[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: finding.severity.rank)
