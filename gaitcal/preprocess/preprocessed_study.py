"""Prepare a study, once and in one order, for checks, calibration and further trials.

`preprocess_study` is the one place where the trials of a study are cleaned. Everything else takes
its result and changes nothing of it. Trials are rotated to their direction of progression and get
their bandwidth where their tracking problems are posed (`analysis/prepared_trials.py`): checks work
in the axes of the files.
"""

from dataclasses import dataclass, replace

import numpy as np

from gaitcal.errors import Finding, InputError
from gaitcal.model.linkage import SEGMENTS, list_joint_segments
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import JOINT_PARAMETERS, ParameterKind
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.clean_trial import CleanTrial, clean_trial
from gaitcal.preprocess.knocked_clusters import Placement, apply_placement, find_placement
from gaitcal.preprocess.marker_clusters import Stance
from gaitcal.preprocess.put_back_labels import restore_swapped_labels
from gaitcal.preprocess.rebuilt_markers import MarkerReconstruction
from gaitcal.preprocess.static_disagreement import PossibleMove, find_possible_moves
from gaitcal.preprocess.study_model import build_nominal_from_clean, rebuild_static
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Trial

MOST_PLACED = 3
"""Knocked clusters that are placed; more are another static posture."""


@dataclass(frozen=True, kw_only=True)
class PreprocessedStudy:
    """A study with clean trials, and the references for their checks."""

    study: Study
    """As it was read, with knocked clusters of its static trial placed by the moving trials."""
    clean: Study
    """The same with clean trials, before swapped labels are put back."""
    completed: MarkerReconstruction
    """The static trial with the markers that were reconstructed from the other trials."""
    model_or_none: SubjectModel | None
    """Nominal; None if the static trial gives none, or its unit is wrong."""
    faults: tuple[Finding, ...]
    """Why the static trial gives no model."""
    trials: tuple[TrialEvidence, ...]
    """Every trial without outliers and isolated jumps, cut to the frames with the pelvis, swapped
    labels put back.
    """
    placed: tuple[Placement, ...]
    """The knocked clusters that were placed by the moving trials."""

    @property
    def moving(self) -> tuple[TrialEvidence, ...]:
        """The trials in which the person moves."""
        return tuple(trial for trial in self.trials if not trial.is_static)

    @property
    def nominal(self) -> SubjectModel:
        """The nominal model, also of a static trial in a wrong unit, where `model_or_none` is None.

        Raises InputError if the static trial gives none.
        """
        return self.model_or_none or build_nominal_from_clean(self.clean, self.completed)

    def find_possible_moves(self) -> dict[str, dict[str, PossibleMove]]:
        """Compute how far the pose of each segment may be wrong because its markers moved.

        Returns
        -------
        dict
            Trial -> segment that it is fitted by -> uncertainty of its pose. A cluster that was
            placed has at least the uncertainty of its placement. Empty for markerless points.
        """
        out, loosened = dict[str, dict[str, PossibleMove]](), self.study.loosened
        if self.study.marker_set.noise is not None:
            return out
        placed = {
            p.segment: loosened.get(p.name, 0.0)
            for p in JOINT_PARAMETERS
            if p.kind is ParameterKind.ORIENTATION
        }
        for trial in self.trials:
            joint = trial.trial.joint
            fitted = SEGMENTS if joint is None else list_joint_segments(joint)
            moves = out[trial.name] = {}
            for segment, move in find_possible_moves(trial.clusters, trial.links).items():
                if segment in fitted:
                    rotation = np.hypot(move.rotation, placed.get(segment, 0.0))
                    moves[segment] = replace(move, rotation=rotation)
        return out


@np.errstate(all="ignore")
@with_one_blas_thread
def preprocess_study(study: Study) -> PreprocessedStudy:
    """Prepare a study: clean every trial, complete the static one, make the nominal model.

    1. Outliers, isolated jumps and frames without the pelvis are removed from each trial
       (`clean_trial.py`).
    2. Markers that the static trial lost are reconstructed from the other trials
       (`rebuilt_markers.py`).
    3. The nominal model is made from the static trial, unless its unit is wrong (`study_model.py`).
    4. Labels that are swapped in a part of a moving trial are put back (`put_back_labels.py`). The
       swap is found by lengths in the static posture, so this step follows the model.
    5. A cluster that was knocked between the static and the moving trials is placed by the moving
       trials (`knocked_clusters.py`), and steps 2 to 4 are repeated for this static trial. If a
       placed cluster still contradicts some trial, nothing is placed.

    Parameters
    ----------
    study
        As it was read.

    Returns
    -------
    PreprocessedStudy
    """
    first, placed = None, tuple[Placement, ...]()
    segment_of, noise = study.marker_set.segment_of, study.marker_set.noise
    trials = tuple(clean_trial(trial, segment_of, noise) for trial in study.trials)
    while True:
        clean = replace(study, trials=trials)
        completed = rebuild_static(clean)
        evidence = tuple(_build_evidence(trial, study) for trial in trials)
        standing = next(trial for trial in evidence if trial.is_static)
        model, faults = _build_nominal(standing, clean, completed)
        stance = None if model is None else _build_stance(study, completed, model)
        measured = tuple(
            replace(
                one, model=model, stance=stance, rebuilding=completed if one is standing else None
            )
            for one in evidence
        )
        prepared = PreprocessedStudy(
            study=study,
            clean=clean,
            completed=completed,
            model_or_none=model,
            faults=faults,
            trials=tuple(restore_swapped_labels(trial) for trial in measured),
            placed=placed,
        )
        first = first or prepared
        if len(placed) == MOST_PLACED:
            return prepared
        # a placed cluster that still contradicts a trial was not knocked: back to the first result
        causes = {cause.segment for trial in prepared.moving for cause in trial.contradictions}
        static = [trial for trial in prepared.trials if trial.is_static]
        if not causes.isdisjoint(one.segment for one in placed) or len(static) != 1:
            return first
        knocked = find_placement(prepared.moving)
        if knocked is None:
            return prepared
        placed = (*placed, knocked)
        before, study = study, apply_placement(study, static[0], knocked)
        trials = tuple(
            kept if new is old else clean_trial(new, segment_of, noise)
            for new, old, kept in zip(study.trials, before.trials, trials, strict=True)
        )


def _build_evidence(trial: CleanTrial, study: Study) -> TrialEvidence:
    """Make the evidence of a trial before there is a model."""
    return TrialEvidence(
        trial=trial,
        marker_set=study.marker_set.with_weights(study.weights),
        subject=study.subject,
        settings=study.settings,
    )


def _build_nominal(
    standing: TrialEvidence, clean: Study, completed: MarkerReconstruction
) -> tuple[SubjectModel | None, tuple[Finding, ...]]:
    """Make the nominal model, or the findings why not; neither if the unit is wrong."""
    if not standing.has_body_size:
        return None, ()
    try:
        return build_nominal_from_clean(clean, completed), ()
    except InputError as fault:
        return None, (Finding.from_error(fault, standing.name, standing.source, "static trial"),)


def _build_stance(study: Study, completed: MarkerReconstruction, model: SubjectModel) -> Stance:
    """Measure the static posture from the markers that the static trial itself shows."""
    whole = Stance.from_recording(completed.static, study.marker_set, model, study.hip_centre)
    return whole.drop_markers(completed.labels)


@np.errstate(all="ignore")
@with_one_blas_thread
def preprocess_trial(
    trial: Trial, model: SubjectModel, marker_set: MarkerSet, settings: CalibrationSettings
) -> TrialEvidence:
    """Prepare one further trial of a person whose model is known: steps 1 and 4 of a study.

    Parameters
    ----------
    trial
        As it was read.
    model
        Calibrated, of a saved result.
    marker_set, settings
        Of the calibration.

    Returns
    -------
    TrialEvidence
    """
    evidence = TrialEvidence(
        trial=clean_trial(trial, marker_set.segment_of, marker_set.noise),
        marker_set=marker_set,
        subject=model.subject,
        settings=settings,
        model=model,
        stance=Stance.from_model(model),
    )
    return restore_swapped_labels(evidence)


@np.errstate(all="ignore")
def find_possible_moves_of_trial(evidence: TrialEvidence) -> dict[str, PossibleMove]:
    """Compute the uncertainty of the segments' poses by moved markers, in one further trial.

    Parameters
    ----------
    evidence
        Of the trial.

    Returns
    -------
    dict
        Segment -> uncertainty, see `PreprocessedStudy.find_possible_moves`.
    """
    has_markers = evidence.model is not None and evidence.model.noise is None
    return find_possible_moves(evidence.clusters, evidence.links) if has_markers else {}
