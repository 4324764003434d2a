"""Evidence of walks whose forces are known: a synthetic one without any error, and real ones."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gaitcal.dynamics.ground_reactions import FORCE_HZ, compute_motion_reactions
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.force_evidence import ForceEvidence, build_force_evidence
from gaitcal.study.study_trial import Role, Trial
from gaitcal.synthetic.synthetic_motion import simulate_gait
from gaitcal.tracking.motion import Motion, track_motion
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import build_trial_problem
from tests.synthetic_studies import made_plates, made_recording


@dataclass(frozen=True)
class Walk:
    """A tracked walk over plates."""

    model: SubjectModel
    recording: Recording
    motion: Motion

    def evidence(
        self, change: Callable[[Recording], Recording] = lambda r: r, name: str = "walk"
    ) -> ForceEvidence:
        """With other plates, or other markers, which are tracked again."""
        recording, motion = change(self.recording), self.motion
        if recording.markers is not self.recording.markers:
            motion = tracked(self.model, recording)
        trial = Trial(name=name, role=Role.GAIT, recording=recording)
        parameters = self.model.parameters
        reactions = compute_motion_reactions(
            self.model, parameters, motion, recording, {}, FORCE_HZ
        )
        found = build_force_evidence(trial, recording, self.model, parameters, motion, reactions)
        assert found is not None
        return found


def tracked(model: SubjectModel, recording: Recording) -> Motion:
    """With the splines' usual number of control points."""
    return track_motion(
        build_trial_problem("walk", model, recording, ControlPointRule()), model.parameters
    )


@lru_cache(maxsize=1)
def exact_walk() -> Walk:
    """Markers and plates of one motion and one body; the plates lie side by side, 4 m long and 1 m
    wide.
    """
    model, true = published_model(), simulate_gait()
    plates = [
        replace(
            plate,
            corners=np.array(
                [[-1.5, 0.0, low], [2.5, 0.0, low], [2.5, 0.0, low + 1], [-1.5, 0.0, low + 1]]
            ),
        )
        for plate, low in zip(made_plates(true), (0.0, -1.0), strict=True)
    ]
    recording = replace(made_recording(true), plates=tuple(plates))
    return Walk(model, recording, tracked(model, recording))
