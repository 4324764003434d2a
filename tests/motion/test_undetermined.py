"""What no marker determines: which coordinates that is, where they are taken to be, and how uncertain that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import coordinate_variances, marker_moves
from gaitcal.calibration.joint_estimate import free_of
from gaitcal.dynamics.axis_errors import ErrorSource
from gaitcal.io.recording import Recording
from gaitcal.model.chain import axis_rotation
from gaitcal.model.linkage import LUMBAR
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_NAMES
from gaitcal.motion.coordinate_prior import DEVIATION, upright_trunk
from gaitcal.motion.motion import Motion, track, tracked_motion
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.trial_problem import TrialProblem, trial_problem
from gaitcal.synthetic.motion import gait_motion
from tests.synthetic_studies import made_recording

MODEL = published_model()
SEGMENT = dict(zip(MODEL.markers.labels, MODEL.markers.segments, strict=True))
TRUNK = tuple(label for label, s in SEGMENT.items() if s == "head_trunk")
ARMS = tuple(label for label, s in SEGMENT.items() if "arm" in s)
ARM_ANGLES = {f"{name}_{side}" for name in ("arm_flex", "arm_add", "elbow_flex") for side in "rl"}
UPRIGHT_DEG = 0.1
"""A spline's fit of the pelvis's swing."""
FOLLOWED_RAD = 0.02
"""A prior of 5 deg against a marker 0.4 m away: it pulls by a few percent of how far the trunk is from upright."""
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def walk() -> Recording:
    return made_recording(gait_motion())


def hidden(recording: Recording, *labels: str, share: float = 1.0) -> Recording:
    """The recording with these markers not seen in the first `share` of its frames."""
    markers = recording.markers.copy()
    markers[: round(share * len(markers)), [recording.labels.index(label) for label in labels]] = np.nan
    return replace(recording, markers=markers)


def problem_of(recording: Recording) -> TrialProblem:
    return trial_problem("walk", MODEL, recording, NodeRule())


def test_three_markers_off_one_line_need_nothing(walk: Recording) -> None:
    assert problem_of(walk).guessed == ()
    assert problem_of(hidden(walk, *TRUNK, share=0.4)).guessed == ()


def test_a_trunk_without_markers_and_arms_with_them(walk: Recording) -> None:
    """What nothing shows is where it is known to be, whatever else is seen."""
    assert set(problem_of(hidden(walk, *TRUNK, *ARMS)).guessed) == {*LUMBAR, *ARM_ANGLES}
    assert set(problem_of(hidden(walk, *TRUNK, *ARMS, share=0.6)).guessed) == {*LUMBAR, *ARM_ANGLES}
    assert not set(problem_of(hidden(walk, *ARMS)).guessed) & set(LUMBAR)
    assert problem_of(hidden(walk, *TRUNK)).guessed == LUMBAR, "arms pull on a trunk, and do not determine it"


def test_one_marker_on_the_sternum_leaves_its_turn_about_the_line_to_the_hips_open(walk: Recording) -> None:
    sternum = next(label for label in TRUNK if "Sternum" in label)
    found = problem_of(hidden(walk, *(m for m in (*TRUNK, *ARMS) if m != sternum)))
    assert {"lumbar_bending", "lumbar_rotation"} <= set(found.guessed)
    assert sternum in found.labels
    motion = tracked_motion(found, MODEL.parameters)
    k = motion.coordinates.index("lumbar_extension")
    assert np.abs(motion.q - gait_motion().q)[:, k].max() < FOLLOWED_RAD


@pytest.mark.parametrize("kept", [1, 0])
def test_a_segment_of_one_marker_or_none_is_asked_too(walk: Recording, kept: int) -> None:
    """A foot: with one marker its inversion is open, and nothing else of the leg."""
    foot = [label for label, s in SEGMENT.items() if s == "foot_r"]
    found = set(problem_of(hidden(walk, *foot[kept:])).guessed)
    assert "subtalar_angle_r" in found
    assert found <= {"subtalar_angle_r", "ankle_angle_r"}
    problem = problem_of(hidden(walk, *foot[kept:]))
    assert not any(n.startswith("subtalar_r") for n in free_of([problem], JP_NAMES))
    assert any(n.startswith("subtalar_r") for n in free_of([problem, problem_of(walk)], JP_NAMES))


def _axes(motion: Motion) -> Array:
    """(nf, 3, 3) axes of the trunk in the laboratory."""
    q = {name: motion.q[:, k] for k, name in enumerate(motion.coordinates)}

    def turn(a: str, b: str, c: str) -> Array:
        angles = zip(q[a], q[b], q[c], strict=True)
        return np.array([axis_rotation(2, x) @ axis_rotation(0, y) @ axis_rotation(1, z) for x, y, z in angles])

    return turn("pelvis_tilt", "pelvis_list", "pelvis_rotation") @ turn(*LUMBAR)


def test_a_trunk_that_nothing_shows_stays_upright_in_the_laboratory(walk: Recording) -> None:
    motion = track(MODEL, hidden(walk, *TRUNK, *ARMS))
    axes = _axes(motion)
    lean = np.rad2deg(np.arccos(np.clip(axes[:, 1, 1], -1.0, 1.0)))
    assert lean.max() < UPRIGHT_DEG
    pelvis = motion.q[:, [motion.coordinates.index("pelvis_tilt")]]
    assert np.rad2deg(np.ptp(pelvis)) > 1.0
    arms = [k for k, name in enumerate(motion.coordinates) if name in ARM_ANGLES]
    assert np.abs(motion.q[:, arms]).max() == 0.0


def test_it_turns_with_the_way_and_not_with_the_pelvis() -> None:
    time = np.arange(400) / 100.0
    standing = {"pelvis_tilt": -0.2, "lumbar_extension": 0.15, "lumbar_bending": 0.02}
    swing = 0.1 * np.sin(2 * np.pi * time)
    zero = np.zeros_like(time)
    still = upright_trunk(time, np.stack([-0.2 + zero, zero, zero], axis=1), standing)
    np.testing.assert_allclose(still, np.broadcast_to([0.15, 0.02, 0.0], still.shape), atol=ROUNDING)
    # about the vertical the first turn of an upright pelvis is its rotation
    turned = upright_trunk(time, np.stack([zero, zero, 0.5 * time], axis=1), {})
    np.testing.assert_allclose(turned, 0.0, atol=ROUNDING)
    middle = slice(100, 300)
    kept = upright_trunk(time, np.stack([zero, zero, 0.5 * time + swing], axis=1), {})
    np.testing.assert_allclose(kept[middle, 2], -swing[middle], atol=0.1 * 0.1)


def test_its_uncertainty_is_that_of_the_prior(walk: Recording) -> None:
    problem = problem_of(hidden(walk, *TRUNK, *ARMS))
    motion = tracked_motion(problem, MODEL.parameters)
    moves = marker_moves(problem, motion.nodes, MODEL.parameters, None)
    variance = coordinate_variances(problem, moves)[ErrorSource.POSTURE]
    for k, name in enumerate(motion.coordinates):
        expected = DEVIATION.get(name, 0.0) if name in problem.guessed else 0.0
        np.testing.assert_allclose(np.rad2deg(np.sqrt(variance[:, k])), expected, atol=1e-3, err_msg=name)
    whole = problem_of(walk)
    seen = marker_moves(whole, tracked_motion(whole, MODEL.parameters).nodes, MODEL.parameters, None)
    assert ErrorSource.POSTURE not in seen.present


def test_markers_tell_what_they_can(walk: Recording) -> None:
    """With sternum, elbows and wrists the trunk is nearer to the truth than without, and its errors are smaller."""
    sternum = next(label for label in TRUNK if "Sternum" in label)
    one = hidden(walk, *(m for m in TRUNK if m != sternum))
    none = hidden(walk, *TRUNK, *ARMS)
    true = gait_motion().q
    off = []
    for recording in (none, one):
        motion = track(MODEL, recording)
        columns = [motion.coordinates.index(name) for name in LUMBAR]
        off.append(float(np.sqrt(((motion.q - true)[:, columns] ** 2).mean())))
    assert off[1] < 0.5 * off[0]
