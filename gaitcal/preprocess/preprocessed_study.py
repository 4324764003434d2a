"""Prepare a study, once and in one order, for everything that looks at it.

`preprocess_study` is the one place where the trials of a study become clean ones. Checks,
calibration and further trials take what it gives, and change nothing of it. Trials are turned to
their direction and get their bandwidth where their tracking problems are posed
(`analysis/prepared_trials.py`): checks look at recordings in the axes of their files.
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
from gaitcal.preprocess.put_back_labels import put_back
from gaitcal.preprocess.rebuilt_markers import Rebuilding
from gaitcal.preprocess.static_disagreement import PossibleMove, find_possible_moves
from gaitcal.preprocess.study_model import build_nominal_from_clean, rebuild_static
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Trial

MOST_PLACED = 3  # Clusters; more that were knocked are another static posture


@dataclass(frozen=True, kw_only=True)
class PreprocessedStudy:
    """A study with clean trials, and what they are measured against."""

    study: Study
    """As it was read, but for knocked clusters of its static trial, which are where the moving
    trials have them.
    """
    clean: Study
    """The same with clean trials, before exchanged labels are put back."""
    completed: Rebuilding
    """The static trial, with what the other trials give back to it."""
    model: SubjectModel | None
    """Nominal; None where the static trial gives none, or its unit is wrong."""
    faults: tuple[Finding, ...]
    """What keeps the static trial from giving a model."""
    trials: tuple[TrialEvidence, ...]
    """Every trial without markers metres away and positions out of line, cut to what shows the
    pelvis, exchanged labels put back.
    """
    placed: tuple[Placement, ...]
    """The knocked clusters that were put where the moving trials have them."""

    @property
    def moving(self) -> tuple[TrialEvidence, ...]:
        """The trials in which the person moves."""
        return tuple(trial for trial in self.trials if not trial.is_static)

    @property
    def nominal(self) -> SubjectModel:
        """The nominal model, also of a static trial in a wrong unit; InputError where there is
        none.
        """
        return self.model or build_nominal_from_clean(self.clean, self.completed)

    def find_possible_moves(self) -> dict[str, dict[str, PossibleMove]]:
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
            fitted = SEGMENTS if t.trial.joint is None else list_joint_segments(t.trial.joint)
            moves = {
                s: move
                for s, move in find_possible_moves(t.clusters, t.links).items()
                if s in fitted
            }
            out[t.name] = {
                s: replace(m, rotation=np.hypot(m.rotation, placed.get(s, 0.0)))
                for s, m in moves.items()
            }
        return out


@np.errstate(all="ignore")
@with_one_blas_thread
def preprocess_study(study: Study) -> PreprocessedStudy:
    """Prepare a study: every trial clean, the static one whole, the nominal model.

    1. Outliers, single positions out of line and frames without the pelvis are left out of each
       trial (`clean_trial.py`).
    2. Markers that the static trial lost are rebuilt from the other trials (`rebuilt_markers.py`).
    3. The nominal model follows from the static trial, unless its unit is wrong (`study_model.py`).
    4. Labels that are exchanged for a part of a moving trial are put back (`put_back_labels.py`):
       lengths in the static posture tell which they are, so this cannot come first.
    5. A cluster that was knocked between the static trial and the moving ones is placed where these
       have it (`knocked_clusters.py`), and 2 to 4 are done again for this static trial. All stay
       where they were read where a placed one still does not agree with some trial.

    Parameters
    ----------
    study
        As it was read.
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
        found = PreprocessedStudy(
            study=study,
            clean=clean,
            completed=completed,
            model=model,
            faults=faults,
            trials=tuple(put_back(trial) for trial in measured),
            placed=placed,
        )
        first = first or found
        if len(placed) == MOST_PLACED:
            return found
        causes = {cause.segment for trial in found.moving for cause in trial.contradictions}
        static = [trial for trial in found.trials if trial.is_static]
        if not causes.isdisjoint(one.segment for one in placed) or len(static) != 1:
            return first
        knocked = find_placement(found.moving)
        if knocked is None:
            return found
        placed = (*placed, knocked)
        before, study = study, apply_placement(study, static[0], knocked)
        trials = tuple(
            kept if new is old else clean_trial(new, segment_of, noise)
            for new, old, kept in zip(study.trials, before.trials, trials, strict=True)
        )


def _build_evidence(trial: CleanTrial, study: Study) -> TrialEvidence:
    """A trial before it has a model to be measured against."""
    return TrialEvidence(
        trial=trial,
        marker_set=study.marker_set.with_weights(study.weights),
        subject=study.subject,
        settings=study.settings,
    )


def _build_nominal(
    standing: TrialEvidence, clean: Study, completed: Rebuilding
) -> tuple[SubjectModel | None, tuple[Finding, ...]]:
    """The nominal model, or why the static trial gives none; neither where its unit is wrong."""
    if not standing.has_body_size:
        return None, ()
    try:
        return build_nominal_from_clean(clean, completed), ()
    except InputError as fault:
        return None, (Finding.of_fault(fault, standing.name, standing.source, "static trial"),)


def _build_stance(study: Study, completed: Rebuilding, model: SubjectModel) -> Stance:
    """The static posture by what the static trial itself shows."""
    whole = Stance.from_recording(completed.static, study.marker_set, model, study.hip_centre)
    return whole.drop_markers(completed.labels)


@np.errstate(all="ignore")
@with_one_blas_thread
def preprocess_trial(
    trial: Trial, model: SubjectModel, marker_set: MarkerSet, settings: CalibrationSettings
) -> TrialEvidence:
    """Prepare one further trial, of a person whose model is known: steps 1 and 4 of a study.

    Parameters
    ----------
    trial
        As it was read.
    model
        Calibrated, of a saved result.
    marker_set, settings
        Those of the calibration.
    """
    found = TrialEvidence(
        trial=clean_trial(trial, marker_set.segment_of, marker_set.noise),
        marker_set=marker_set,
        subject=model.subject,
        settings=settings,
        model=model,
        stance=Stance.from_model(model),
    )
    return put_back(found)


@np.errstate(all="ignore")
def find_possible_moves_of_trial(evidence: TrialEvidence) -> dict[str, PossibleMove]:
    """What markers may have done, as `PreprocessedStudy.moves`, of one further trial."""
    of_markers = evidence.model is not None and evidence.model.noise is None
    return find_possible_moves(evidence.clusters, evidence.links) if of_markers else {}
