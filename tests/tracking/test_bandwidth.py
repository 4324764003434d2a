"""The bandwidth that markers ask for, near the best on known motions; the penalty that limits a
motion to it.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.linalg import eigh
from scipy.optimize import least_squares

from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.synthetic.synthetic_motion import compute_synthetic_markers, simulate_gait
from gaitcal.tracking.bandwidth import (
    LOWEST_HZ,
    MAX_SEARCH_S,
    DenseMotion,
    Smoother,
    apply_bandwidth,
    compute_frame_information,
    compute_highest_cutoff,
    find_busiest_frames,
)
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.motion import Motion, track_coefficients, track_motion
from gaitcal.tracking.spline import (
    DEGREE,
    ORDER,
    TENSION_HZ,
    ControlPointRule,
    build_roughness,
    build_smoothing,
    build_spline_basis,
    compute_frame_rate,
    compute_stiffness,
)
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from tests.derivatives import (
    Array,
    assert_derivative,
    from_band,
    noisy,
    perturbed_parameters,
    random_trial,
    without_segments,
)

MODEL = published_model()
GAIT = simulate_gait()
TIME, TRUE = GAIT.basis.time, GAIT.q
MARKERS = compute_synthetic_markers(MODEL.parameters, MODEL.markers, TRUE)
SEGMENTS = np.array(MODEL.markers.segments)


def problem_of(markers: Array, time: Array = TIME) -> MotionProblem:
    recording = Recording(source="made up", time=time, labels=MODEL.markers.labels, markers=markers)
    return build_trial_problem("walk", MODEL, recording, ControlPointRule())


def smoothed(problem: MotionProblem, hz: float) -> Motion:
    return track_motion(apply_bandwidth(problem, MODEL.parameters, hz), MODEL.parameters)


def asked(problem: MotionProblem) -> float:
    return DenseMotion(problem, MODEL.parameters).choose_cutoff()


def white(seed: int, deviation: float) -> Array:
    return np.random.default_rng(seed).normal(0, deviation, MARKERS.shape)


def slow(seed: int) -> Array:
    """Skin movement: 5 mm, below 2 Hz."""
    rng = np.random.default_rng(seed)
    omega, phase = rng.uniform(2, 12, (2, *MARKERS.shape[1:]))
    return np.asarray(0.005 * np.sin(omega * TIME[:, None, None] + phase))


@pytest.mark.parametrize(
    "noise",
    [white(1, 0.001), white(2, 0.0003), white(3, 0.0005) + slow(3)],
    ids=["1mm", "fine", "slow"],
)
def test_choice_is_near_the_best_on_truth(noise: Array) -> None:
    problem = problem_of(MARKERS + noise)
    inner = slice(20, -20)  # accelerations at the ends lean on one side

    def errors(hz: float) -> Array:
        motion, true = (
            smoothed(problem, hz),
            [GAIT.basis.evaluate(GAIT.coefficients, k) for k in (0, 2)],
        )
        found = (motion.q, motion.acceleration)
        gaps = [(a - b)[inner, 3:] for a, b in zip(found, true, strict=True)]
        return np.sqrt([np.mean(gap**2) for gap in gaps])

    best = np.min([errors(hz) for hz in np.geomspace(3.0, 25.0, 9)], axis=0)
    # what is made least is the error of the coordinates; their accelerations would have a little
    # less
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
    assert hz == pytest.approx(compute_highest_cutoff(problem.basis)) == 25.0
    motion = smoothed(problem, hz)
    assert motion.converged and np.abs(motion.q - TRUE).max() < 5e-4


def test_the_penalty_limits_the_motion_not_the_nodes() -> None:
    problem = problem_of(MARKERS + white(5, 0.001))
    for hz in (4.0, 8.0, 16.0):
        chosen = apply_bandwidth(problem, MODEL.parameters, hz)
        finer = build_spline_basis(TIME, 2 * chosen.basis.control_points)
        information = compute_frame_information(problem, problem.build_body(MODEL.parameters))
        fine = replace(problem, basis=finer, smoothing=build_smoothing(finer, information, hz))
        motion, reference = (track_motion(p, MODEL.parameters) for p in (chosen, fine))
        apart = (motion.acceleration - reference.acceleration)[20:-20]
        # 2 % with 8 Hz; with 16 Hz what differs is noise
        assert np.mean(apart**2) < 0.1**2 * np.mean(reference.acceleration[20:-20] ** 2)
        assert motion.cutoff_hz == pytest.approx(0.863 * hz, rel=1e-3)


def test_one_dense_motion_foretells_the_others() -> None:
    """Coordinates taken to be uncoupled: near what tracking with that cut-off makes of them."""
    dense = DenseMotion(problem_of(MARKERS + white(6, 0.001)), MODEL.parameters)
    basis = dense.problem.basis
    body = dense.problem.build_body(MODEL.parameters)
    for hz in (4.0, 8.0):
        foretold = dense.smooth_at(hz)
        problem = replace(dense.problem, smoothing=build_smoothing(basis, dense.information, hz))
        coefficients = track_coefficients(problem, body, dense.coefficients).x
        change, gap = (
            basis.evaluate(coefficients - other)
            for other in (dense.coefficients, foretold.coefficients)
        )
        in_markers = [np.vdot(x @ dense.information, x) for x in (gap, change)]
        assert in_markers[0] < 0.1 * in_markers[1]
        rms = np.sqrt(problem.compute_marker_cost(coefficients, body) / problem.data.weight.sum())
        assert foretold.rms == pytest.approx(rms, rel=0.03)


def test_information_does_not_depend_on_gaps() -> None:
    """A marker lost for half of the trial counts half throughout: no frame is without
    information.
    """
    problem = problem_of(MARKERS)
    weight = problem.data.weight.copy()
    weight[:, ::2] = 0.0
    body = problem.build_body(MODEL.parameters)
    whole, half = (
        compute_frame_information(p, body) for p in (problem, problem.with_weight(weight))
    )
    np.testing.assert_allclose(whole, whole.T)
    seen = np.ix_(problem.active, problem.active)
    assert np.linalg.eigvalsh(whole[seen])[0] > 0
    np.testing.assert_allclose(half, 0.5 * whole, atol=0.1 * np.abs(whole).max())


@pytest.mark.parametrize("every, first", [(8, 208), (4, 208), (2, 208), (1, 12), (1, 20), (1, 60)])
def test_slow_cameras_and_short_trials(every: int, first: int) -> None:
    noisy = MARKERS + white(7, 0.0005)
    problem = problem_of(noisy[:first:every], TIME[:first:every])
    hz = asked(problem)
    assert LOWEST_HZ <= hz <= compute_highest_cutoff(problem.basis)
    motion = smoothed(problem, hz)
    assert motion.converged and motion.basis.control_points <= len(motion.time) + 5
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
        motion = smoothed(problem, asked(problem))
        assert motion.converged and np.abs(motion.q - TRUE[:1]).max() < 0.01
    assert asked(problem_of(still + white(9, 0.0003))) < 4.0


def test_markers_with_nothing_to_spare_say_nothing() -> None:
    """Three markers hold the pelvis' six coordinates with three to spare; two of a segment more
    leave none to all.
    """
    kept = [
        int(k)
        for s in dict.fromkeys(SEGMENTS)
        for k in np.flatnonzero(s == SEGMENTS)[: 3 if s == "pelvis" else 1]
    ]
    lone = np.full_like(MARKERS, np.nan)
    lone[:, kept] = MARKERS[:, kept]
    assert np.isfinite(asked(problem_of(lone)))


def test_a_long_trial_is_looked_at_where_most_happens() -> None:
    frames = int(3 * MAX_SEARCH_S * 25)
    time, moves = np.arange(frames) / 25.0, np.zeros(frames)
    moves[900:1100] = 1.0
    still = np.repeat(MARKERS[:1], frames, axis=0)
    still += 0.01 * np.sin(8 * time)[:, None, None] * moves[:, None, None]
    problem = problem_of(still, time)
    for chosen in (find_busiest_frames(problem), find_busiest_frames(problem, moves)):
        assert len(chosen) == MAX_SEARCH_S * 25 + 1
        assert chosen[0] <= 900 and chosen[-1] >= 1099
    assert find_busiest_frames(problem_of(MARKERS)).tolist() == list(range(len(TIME)))
    assert len(DenseMotion(problem, MODEL.parameters).problem.basis.time) == len(chosen)


RIGHT_LEG = ("pelvis", "thigh_r", "shank_r")
FREE = ("knee_r.thigh.sup", "knee_r.shank.sup")
PARAMETERS = perturbed_parameters(np.random.default_rng(61))


def penalised(
    rng: np.random.Generator, *, frames: int = 40, nodes: int = 9
) -> tuple[MotionProblem, Array]:
    """A trial with noise and a penalty that couples all coordinates, and the nodes of its true
    motion.
    """
    problem, true = random_trial(
        rng, PARAMETERS, free=FREE, frames=frames, nodes=nodes, segments=RIGHT_LEG
    )
    half = rng.normal(size=(true.shape[1], true.shape[1]))
    rough = build_smoothing(problem.basis, half @ half.T + np.eye(len(half)), 3.0)
    return replace(noisy(problem, rng), smoothing=rough), true


def whole(problem: MotionProblem) -> Array:
    """(nn * nq, nn * nq) the penalty's matrix, node by node."""
    return np.kron(problem.penalty.roughness.matrix.toarray(), problem.penalty.coupling)


def test_roughness_is_the_integral_of_squared_derivatives() -> None:
    basis = build_spline_basis(np.linspace(0.0, 1.3, 50), 14)
    coefficients = np.random.default_rng(62).normal(size=(14, 2))
    spline = BSpline(basis.knots, coefficients, DEGREE)
    fine = np.linspace(0.0, 1.3, 200_001)
    expected = np.trapezoid(spline.derivative(3)(fine) ** 2, fine, axis=0)
    expected += (2 * np.pi * TENSION_HZ) ** 4 * np.trapezoid(
        spline.derivative(1)(fine) ** 2, fine, axis=0
    )
    rough = build_roughness(basis.knots)
    np.testing.assert_allclose(
        np.diag(coefficients.T @ rough.matrix @ coefficients), expected, rtol=1e-8
    )
    assert rough.evaluate(coefficients, np.eye(2))[0] == pytest.approx(expected.sum(), rel=1e-8)
    tolerance = {"rtol": 1e-9, "atol": 1e-9 * expected.max()}
    np.testing.assert_allclose(
        rough.evaluate(coefficients, np.eye(2))[1], rough.matrix @ coefficients, **tolerance
    )
    dense = rough.matrix.toarray()
    np.testing.assert_allclose(
        from_band(rough.band[:, :ORDER]), dense, rtol=0, atol=1e-12 * dense.max()
    )
    assert rough.evaluate(coefficients + 1e6, np.eye(2))[0] == pytest.approx(
        expected.sum(), rel=1e-6
    )


def test_cost_and_gradients() -> None:
    rng = np.random.default_rng(63)
    problem, true = penalised(rng)
    body = problem.build_body(PARAMETERS)
    coefficients = true + rng.normal(0, 0.02, true.shape)
    cost, by_nodes, by_values = problem.compute_gradients(coefficients, body)
    plain = replace(problem, smoothing=None)
    plain_cost, plain_by_nodes, plain_by_values = plain.compute_gradients(coefficients, body)
    assert (
        cost
        == problem.compute_cost(coefficients, body)
        > plain_cost
        == problem.compute_marker_cost(coefficients, body)
    )
    np.testing.assert_array_equal(by_values, plain_by_values)

    def total(x: Array) -> Array:
        return np.array([problem.compute_cost(x.reshape(coefficients.shape), body)])

    assert_derivative(2 * by_nodes.reshape(1, -1), total, coefficients.ravel(), relative=1e-6)
    assert np.abs(by_nodes - plain_by_nodes).max() > 1e-3 * np.abs(plain_by_nodes).max()


@pytest.mark.parametrize("curved", [False, True])
def test_equations_hold_the_penalty(curved: bool) -> None:
    problem, true = penalised(np.random.default_rng(64))
    closed = problem.with_free(())
    for trial in (closed,) if curved else (closed, problem):
        body = trial.build_body(PARAMETERS)
        equations = trial.assemble_equations(true, body, curved=curved)
        plain = replace(trial, smoothing=None).assemble_equations(true, body, curved=curved)
        matrix = whole(trial)
        added = from_band(equations.band) - from_band(plain.band)
        np.testing.assert_allclose(
            added, matrix, rtol=0, atol=1e-12 * np.abs(from_band(equations.band)).max()
        )
        gradient = (equations.node_gradient - plain.node_gradient).ravel()
        np.testing.assert_allclose(
            gradient, matrix @ true.ravel(), rtol=0, atol=1e-9 * np.abs(gradient).max()
        )
        assert equations.cost == pytest.approx(
            plain.cost + true.ravel() @ matrix @ true.ravel(), rel=1e-9
        )
        np.testing.assert_array_equal(equations.mixed, plain.mixed)


def test_tracking_ends_where_a_dense_solver_does() -> None:
    problem, true = penalised(np.random.default_rng(65))
    problem = problem.with_free(())
    body = problem.build_body(PARAMETERS)
    root = np.linalg.cholesky(whole(problem) + 1e-12 * np.eye(true.size)).T

    def residual(x: Array) -> Array:
        gap = problem.compute_positions(x.reshape(true.shape), body) - problem.data.measured
        return np.concatenate([gap.ravel(), root @ x])

    reference = least_squares(
        residual, true.ravel(), tr_solver="exact", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    result = track_coefficients(problem, body, true, DescentSettings(gain=1e-15))
    assert result.cost == pytest.approx(2 * reference.cost, rel=1e-8)
    assert result.cost > 1.01 * problem.compute_marker_cost(result.x, body)
    np.testing.assert_allclose(result.x.ravel(), reference.x, atol=1e-6)


def test_smoothing_survives_and_idle_coordinates_keep_their_start() -> None:
    problem, true = penalised(np.random.default_rng(66))
    lost = without_segments(problem.with_free(()), "shank_r")
    for other in (lost, problem.with_measured(problem.data.measured + 0.1)):
        assert other.smoothing is problem.smoothing
    idle = ~lost.active
    assert idle.any() and not idle.all()
    tracked = track_coefficients(lost, lost.build_body(PARAMETERS), true)
    np.testing.assert_array_equal(tracked.x[:, idle], true[:, idle])
    assert np.abs(tracked.x[:, ~idle] - true[:, ~idle]).max() > 1e-6


def test_smoother_is_a_dense_hat_matrix_and_its_trace_a_sum_of_gains() -> None:
    rng = np.random.default_rng(67)
    basis, hz = build_spline_basis(np.arange(90) / 60.0, 50), 5.0
    b = BSpline.design_matrix(basis.time, basis.knots, DEGREE).toarray()
    rough, rate = build_roughness(basis.knots).matrix.toarray(), compute_frame_rate(basis)
    hat = b @ np.linalg.solve(b.T @ b + rate * (2 * np.pi * hz) ** -6.0 * rough, b.T)
    assert compute_stiffness(basis, hz) == pytest.approx(rate * (2 * np.pi * hz) ** -6.0)
    smoother = Smoother(basis)
    series, coefficients = rng.normal(size=(90, 3)), rng.normal(size=(50, 3))
    passed = basis.evaluate(smoother.smooth(basis.matrices[0].T @ series, hz))
    np.testing.assert_allclose(passed, hat @ series, atol=1e-8)
    lost = b @ coefficients - hat @ b @ coefficients
    np.testing.assert_allclose(
        basis.evaluate(smoother.compute_loss(coefficients, hz)), lost, atol=1e-8
    )
    mu = eigh(rough, b.T @ b, eigvals_only=True)
    reinsch = (rate * np.maximum(mu, 0.0)) ** (1 / 6) / (2 * np.pi)
    gains = 1 / (1 + (reinsch / hz) ** 6)
    assert np.trace(hat) == pytest.approx(gains.sum(), rel=1e-6)


@pytest.mark.parametrize(
    "hz, gain", [(3.0, 1 / (1 + 0.5**6)), (6.0, 0.5), (12.0, 1 / (1 + 2.0**6))]
)
def test_half_of_an_oscillation_passes_at_the_cut_off(hz: float, gain: float) -> None:
    time = np.arange(1000) / 200.0
    basis = build_spline_basis(time, 505)
    wave = np.sin(2 * np.pi * hz * time)[:, None]
    passed = basis.evaluate(Smoother(basis).smooth(basis.matrices[0].T @ wave, 6.0))
    middle = slice(250, 750)
    assert float((passed * wave)[middle].sum() / (wave**2)[middle].sum()) == pytest.approx(
        gain, abs=0.005
    )
