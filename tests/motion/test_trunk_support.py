"""A trial that shows too little of the trunk does not follow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.nominal import published_model
from gaitcal.motion.motion import track
from gaitcal.motion.node_rule import NodeRule
from gaitcal.motion.trial_problem import trial_problem
from gaitcal.motion.trunk_support import TRUNK, telling
from gaitcal.recording import Recording
from gaitcal.synthetic.motion import gait_motion
from tests.synthetic_studies import made_recording

MODEL = published_model()
ON_TRUNK = tuple(
    label for label, segment in zip(MODEL.markers.labels, MODEL.markers.segments, strict=True) if segment == TRUNK
)
UPPER = tuple(
    label
    for label, segment in zip(MODEL.markers.labels, MODEL.markers.segments, strict=True)
    if segment == TRUNK or "arm" in segment
)


@pytest.fixture(scope="module")
def walk() -> Recording:
    return made_recording(gait_motion())


def hidden(recording: Recording, labels: tuple[str, ...], share: float = 1.0) -> Recording:
    """The recording with these markers not seen in the first `share` of its frames."""
    markers = recording.markers.copy()
    markers[: round(share * len(markers)), [recording.labels.index(label) for label in labels]] = np.nan
    return replace(recording, markers=markers)


def test_two_markers_of_the_trunk_leave_trunk_and_arms_alone(walk: Recording) -> None:
    problem = trial_problem("walk", MODEL, hidden(walk, ON_TRUNK[2:]), NodeRule())
    assert not set(problem.labels) & set(UPPER)
    motion = track(MODEL, hidden(walk, ON_TRUNK[2:]), rule=NodeRule())
    still = [i for i, name in enumerate(motion.coordinates) if name.startswith(("lumbar", "arm", "elbow"))]
    assert len(still) == 9
    assert np.abs(motion.q[:, still]).max() == 0.0


def test_three_markers_in_half_of_the_frames_do(walk: Recording) -> None:
    for share, followed in ((0.4, True), (0.6, False)):
        problem = trial_problem("walk", MODEL, hidden(walk, ON_TRUNK[2:], share), NodeRule())
        assert set(UPPER).issubset(problem.labels) is followed


def test_where_the_trunk_hangs_on_nothing_there_is_nothing_to_ask() -> None:
    segments, local = ("upper_arm_r", "forearm_hand_r"), np.zeros((2, 3))
    seen = np.ones((2, 5), dtype=bool)
    assert telling(("upper_arm_r", "forearm_hand_r"), segments, local, seen).all()
    assert not telling(("pelvis", TRUNK, "upper_arm_r", "forearm_hand_r"), segments, local, seen).any()
