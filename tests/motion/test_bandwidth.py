"""The bandwidth that markers ask for: near the best on known motions, whatever the noise, the camera and the gaps."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.motion.bandwidth import (
    LONGEST_S,
    LOWEST_HZ,
    DenseMotion,
    busiest,
    frame_information,
    highest_cutoff,
    with_bandwidth,
)
from gaitcal.motion.motion import Motion, track_nodes, tracked_motion
from gaitcal.motion.spline import NodeRule, smoothing, spline_basis
from gaitcal.motion.trial_problem import MotionProblem, trial_problem
from gaitcal.synthetic.motion import gait_motion, synthetic_markers
from tests.derivatives import Array

MODEL = published_model()
GAIT = gait_motion()
TIME, TRUE = GAIT.basis.time, GAIT.q
MARKERS = synthetic_markers(MODEL.parameters, MODEL.markers, TRUE)
SEGMENTS = np.array(MODEL.markers.segments)


def problem_of(markers: Array, time: Array = TIME) -> MotionProblem:
    recording = Recording(source="made up", time=time, labels=MODEL.markers.labels, markers=markers)
    return trial_problem("walk", MODEL, recording, NodeRule())


def smoothed(problem: MotionProblem, hz: float) -> Motion:
    return tracked_motion(with_bandwidth(problem, MODEL.parameters, hz), MODEL.parameters)


def asked(problem: MotionProblem) -> float:
    return DenseMotion(problem, MODEL.parameters).by_markers()


def white(seed: int, deviation: float) -> Array:
    return np.random.default_rng(seed).normal(0, deviation, MARKERS.shape)


def slow(seed: int) -> Array:
    """Skin movement: 5 mm, below 2 Hz."""
    rng = np.random.default_rng(seed)
    omega, phase = rng.uniform(2, 12, (2, *MARKERS.shape[1:]))
    return np.asarray(0.005 * np.sin(omega * TIME[:, None, None] + phase))


@pytest.mark.parametrize(
    "noise", [white(1, 0.001), white(2, 0.0003), white(3, 0.0005) + slow(3)], ids=["1mm", "fine", "slow"]
)
def test_choice_is_near_the_best_on_truth(noise: Array) -> None:
    problem = problem_of(MARKERS + noise)
    inner = slice(20, -20)  # accelerations at the ends lean on one side

    def errors(hz: float) -> Array:
        motion, true = smoothed(problem, hz), [GAIT.basis.evaluate(GAIT.nodes, k) for k in (0, 2)]
        found = (motion.q, motion.acceleration)
        gaps = [(a - b)[inner, 3:] for a, b in zip(found, true, strict=True)]
        return np.sqrt([np.mean(gap**2) for gap in gaps])

    best = np.min([errors(hz) for hz in np.geomspace(3.0, 25.0, 9)], axis=0)
    # what is made least is the error of the coordinates; their accelerations would have a little less
    assert (errors(asked(problem)) < [1.1 * best[0], 1.6 * best[1]]).all()
    assert errors(3.0)[1] > 1.5 * best[1] < errors(25.0)[1]  # so that a wrong choice would show


def test_slow_noise_says_nothing_of_fast_noise() -> None:
    """What takes noise for white smooths a walk away under skin movement."""
    fine = white(4, 0.0003)
    assert asked(problem_of(MARKERS + fine + slow(4))) > 0.75 * asked(problem_of(MARKERS + fine))
    assert asked(problem_of(MARKERS + white(4, 0.003))) < 0.9 * asked(problem_of(MARKERS + fine))


def test_without_noise_everything_passes_and_the_motion_is_found() -> None:
    problem = problem_of(MARKERS)
    hz = asked(problem)
    assert hz == pytest.approx(highest_cutoff(problem.basis)) == 25.0
    motion = smoothed(problem, hz)
    assert motion.converged
    assert np.abs(motion.q - TRUE).max() < 5e-4


def test_the_penalty_limits_the_motion_not_the_nodes() -> None:
    problem = problem_of(MARKERS + white(5, 0.001))
    for hz in (4.0, 8.0, 16.0):
        chosen = with_bandwidth(problem, MODEL.parameters, hz)
        finer = spline_basis(TIME, 2 * chosen.basis.nodes)
        information = frame_information(problem, problem.constants(MODEL.parameters))
        fine = replace(problem, basis=finer, smoothing=smoothing(finer, information, hz))
        motion, reference = (tracked_motion(p, MODEL.parameters) for p in (chosen, fine))
        scale = np.sqrt(np.mean(reference.acceleration[20:-20] ** 2))
        assert (
            np.sqrt(np.mean((motion.acceleration - reference.acceleration)[20:-20] ** 2)) < 0.1 * scale
        )  # 2 % with 8 Hz; with 16 Hz what differs is noise
        assert motion.cutoff_hz == pytest.approx(0.863 * hz, rel=1e-3)


def test_one_dense_motion_foretells_the_others() -> None:
    """Coordinates taken to be uncoupled: near what tracking with that cut-off makes of them."""
    dense = DenseMotion(problem_of(MARKERS + white(6, 0.001)), MODEL.parameters)
    basis = dense.problem.basis
    constants = dense.problem.constants(MODEL.parameters)
    for hz in (4.0, 8.0):
        foretold = dense.at(hz)
        problem = replace(dense.problem, smoothing=smoothing(basis, dense.information, hz))
        nodes = track_nodes(problem, constants, dense.nodes).nodes
        change, gap = (basis.evaluate(nodes - other) for other in (dense.nodes, foretold.nodes))
        in_markers = [np.vdot(x @ dense.information, x) for x in (gap, change)]
        assert in_markers[0] < 0.1 * in_markers[1]
        rms = np.sqrt(problem.marker_cost(nodes, constants) / problem.data.weight.sum())
        assert foretold.rms == pytest.approx(rms, rel=0.03)


def test_information_does_not_depend_on_gaps() -> None:
    """A marker lost for half of the trial counts half throughout: no frame is without information."""
    problem = problem_of(MARKERS)
    weight = problem.data.weight.copy()
    weight[:, ::2] = 0.0
    constants = problem.constants(MODEL.parameters)
    whole, half = (frame_information(p, constants) for p in (problem, problem.with_weight(weight)))
    np.testing.assert_allclose(whole, whole.T)
    assert np.linalg.eigvalsh(whole)[0] > 0
    np.testing.assert_allclose(half, 0.5 * whole, atol=0.1 * np.abs(whole).max())


@pytest.mark.parametrize("every, first", [(8, 208), (4, 208), (2, 208), (1, 12), (1, 20), (1, 60)])
def test_slow_cameras_and_short_trials(every: int, first: int) -> None:
    noisy = MARKERS + white(7, 0.0005)
    problem = problem_of(noisy[:first:every], TIME[:first:every])
    hz = asked(problem)
    assert LOWEST_HZ <= hz <= highest_cutoff(problem.basis)
    motion = smoothed(problem, hz)
    assert motion.converged
    assert motion.basis.nodes <= len(motion.time) + 5
    assert np.abs(motion.q - TRUE[:first:every])[:, 3:].max() < 0.15


def test_gaps_and_lost_segments_stay_bounded() -> None:
    noisy = MARKERS + white(8, 0.0005)
    noisy[60:90, SEGMENTS == "foot_r"] = np.nan
    noisy[130:, SEGMENTS == "forearm_hand_l"] = np.nan
    rng = np.random.default_rng(8)
    for marker in range(0, len(SEGMENTS), 3):
        start = int(rng.integers(0, 180))
        noisy[start : start + 20, marker] = np.nan
    problem = problem_of(noisy)
    motion = smoothed(problem, asked(problem))
    assert motion.converged
    assert np.abs(motion.q - TRUE)[:, 3:].max() < 1.0
    assert np.abs((motion.q - TRUE)[60:90]).max() < 0.6


def test_a_still_person() -> None:
    still = np.repeat(MARKERS[:1], len(TIME), axis=0)
    for noise in (white(9, 0.0003), np.zeros_like(still)):
        problem = problem_of(still + noise)
        hz = asked(problem)
        motion = smoothed(problem, hz)
        assert motion.converged
        assert np.abs(motion.q - TRUE[:1]).max() < 0.01
    assert asked(problem_of(still + white(9, 0.0003))) < 4.0


def test_markers_with_nothing_to_spare_say_nothing() -> None:
    """Three markers hold the pelvis' six coordinates with three to spare; two of a segment more leave none to all."""
    kept = [int(k) for s in dict.fromkeys(SEGMENTS) for k in np.flatnonzero(s == SEGMENTS)[: 3 if s == "pelvis" else 1]]
    lone = np.full_like(MARKERS, np.nan)
    lone[:, kept] = MARKERS[:, kept]
    assert np.isfinite(asked(problem_of(lone)))


def test_a_long_trial_is_looked_at_where_most_happens() -> None:
    frames = int(3 * LONGEST_S * 25)
    time, moves = np.arange(frames) / 25.0, np.zeros(frames)
    moves[900:1100] = 1.0
    still = np.repeat(MARKERS[:1], frames, axis=0)
    still += 0.01 * np.sin(8 * time)[:, None, None] * moves[:, None, None]
    problem = problem_of(still, time)
    for chosen in (busiest(problem), busiest(problem, moves)):
        assert len(chosen) == LONGEST_S * 25 + 1
        assert chosen[0] <= 900 and chosen[-1] >= 1099
    assert busiest(problem_of(MARKERS)).tolist() == list(range(len(TIME)))
    assert len(DenseMotion(problem, MODEL.parameters).problem.basis.time) == len(chosen)
