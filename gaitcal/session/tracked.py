"""The motions of all trials with the nominal and with the fitted joint parameters, and the forces under the feet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.session.prepare import PreparedTrial, measured_reactions
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role


@dataclass(frozen=True)
class Tracked:
    """By the name of the trial."""

    before: Mapping[str, Motion]
    """With the nominal model: the whole body in gait, the segments of its joint in an isolated trial."""
    motions: Mapping[str, Motion]
    """Of the whole body, with the fitted joint parameters."""
    reactions: Mapping[str, GroundReactions]
    """On the feet of these motions; of gait trials with force plates."""


def tracked_trials(
    trials: Sequence[PreparedTrial], nominal: SubjectModel, parameters: Parameters, settings: CalibrationSettings
) -> Tracked:
    """Track all trials with both models."""

    def loaded(trial: PreparedTrial) -> tuple[Motion, GroundReactions | None]:
        motion = tracked_motion(trial.body, parameters)
        if trial.role is not Role.GAIT or not trial.recording.plates:
            return motion, None
        return motion, measured_reactions(trial, nominal, parameters, motion, settings)

    names = [trial.name for trial in trials]
    parts = [trial.fitted if trial.joint else trial.body for trial in trials]
    after = [loaded(trial) for trial in trials]
    before = [tracked_motion(part, nominal.parameters) for part in parts]
    return Tracked(
        before=dict(zip(names, before, strict=True)),
        motions={name: motion for name, (motion, _) in zip(names, after, strict=True)},
        reactions={name: r for name, (_, r) in zip(names, after, strict=True) if r is not None},
    )
