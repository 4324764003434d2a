"""Splines against SciPy, tracking against a dense SciPy reference, starts, gaps, headings,
curvature and memory.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.model.chain import LinkageModel
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.tracking import motion
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.motion import track_coefficients
from gaitcal.tracking.rigid import compute_rigid_distances, fit_rigid
from gaitcal.tracking.spline import (
    DEGREE,
    ControlPointRule,
    build_spline_basis,
    compute_cutoff,
    convert_to_bspline,
)
from gaitcal.tracking.trial_problem import MotionProblem
from scripts.tools.benchmark import tasks
from tests.derivatives import (
    Array,
    assert_derivative,
    from_band,
    noisy,
    seeded_trial,
    started,
    with_gaps,
)


@given(st.integers(6, 40), st.integers(30, 120), st.integers(0, 2**31))
@settings(max_examples=30)
def test_spline_and_derivatives_are_scipys(nodes: int, frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, frames)) / 100.0
    basis = build_spline_basis(time, nodes)
    values = rng.normal(size=(nodes, 2))
    reference = convert_to_bspline(basis, values)
    for k in range(3):
        expected = reference(time, k)
        np.testing.assert_allclose(
            basis.evaluate(values, k), expected, rtol=0, atol=1e-11 * np.abs(expected).max()
        )


def test_spline_fit_finds_a_curve_of_its_own_space() -> None:
    basis = build_spline_basis(np.linspace(0, 2, 200), 25)
    coefficients = np.random.default_rng(7).normal(size=(25, 3))
    np.testing.assert_allclose(basis.fit(basis.evaluate(coefficients)), coefficients, atol=1e-8)


@pytest.mark.parametrize(("rate", "spans"), [(25.0, 17), (200.0, 40)])
def test_spans_last_a_twentieth_of_a_second_or_three_frames_of_slow_cameras(
    rate: float, spans: int
) -> None:
    assert ControlPointRule().count_control_points(np.arange(2 * rate + 1) / rate) == spans + DEGREE


def test_effective_cutoff_is_where_the_fit_passes_71_percent() -> None:
    time = np.arange(4000) / 1000.0
    coefficients = ControlPointRule(per_second=15.0).count_control_points(time)
    basis = build_spline_basis(time, coefficients)
    middle = slice(1000, 3000)
    gains = []
    for phase in (
        0.0,
        np.pi / 2,
    ):  # near the knots' Nyquist frequency the gain depends on phase; the mean does not
        wave = np.sin(2 * np.pi * compute_cutoff(time, coefficients) * time + phase)[:, None]
        passed = basis.evaluate(basis.fit(wave))
        gains.append(
            float((passed[middle].T @ wave[middle])[0, 0] / (wave[middle].T @ wave[middle])[0, 0])
        )
    assert np.mean(gains) == pytest.approx(np.sqrt(0.5), abs=0.01)


@pytest.mark.parametrize("zero", [False, True])
def test_tracking_recovers_a_motion_exactly(zero: bool) -> None:
    _, parameters, problem, true = seeded_trial(8, frames=80, nodes=12)
    body, start = started(problem, parameters)
    start = np.zeros_like(true) if zero else start
    result = track_coefficients(
        problem, body, start, DescentSettings(first_damping=1e-3 if zero else 0.0)
    )
    assert result.converged
    assert np.sqrt(result.cost / problem.data.weight.sum()) < 1e-12
    np.testing.assert_allclose(
        problem.basis.evaluate(result.x), problem.basis.evaluate(true), atol=1e-9
    )


@given(st.floats(-np.pi, np.pi), st.integers(0, 2**31))
@settings(max_examples=10)
def test_any_heading_is_tracked(heading: float, seed: int) -> None:
    _, parameters, problem, _ = seeded_trial(seed, frames=50, nodes=8)
    turn = make_axis_rotation(1, heading)
    turned = (
        np.einsum("ij,mjf->mif", turn, problem.data.measured)
        + np.array([3.0, 0.0, -2.0])[None, :, None]
    )
    problem = problem.with_measured(turned)
    result = track_coefficients(problem, *started(problem, parameters))
    # The turned motion lies in the spline space only as far as Euler angles turn with it.
    assert np.sqrt(result.cost / problem.data.weight.sum()) < 0.005


def test_rigid_fit_finds_the_rigid_motion_and_says_where_it_cannot() -> None:
    rng = np.random.default_rng(11)
    local = rng.normal(0, 0.1, (5, 3))
    rotation = make_axis_rotation(0, 0.4) @ make_axis_rotation(2, 1.1)
    measured = (local @ rotation.T + [1.0, 2.0, 3.0])[:, :, None].repeat(3, axis=2)
    weight = np.ones((5, 3))
    weight[2:, 1] = 0.0
    fit = fit_rigid(local, measured, weight)
    np.testing.assert_allclose(fit.rotation[0], rotation, atol=1e-12)
    np.testing.assert_allclose(fit.origin[2], [1.0, 2.0, 3.0], atol=1e-12)
    assert fit.determined.tolist() == [True, False, True]
    assert np.nanmax(compute_rigid_distances(local, measured, weight)) < 1e-12


EXACT = DescentSettings(gain=1e-13)


def misplaced_trial() -> tuple[MotionProblem, LinkageModel, Array]:
    """Markers of little weight 0.3 m from where the model has them, as on arms held otherwise in
    the static trial.
    """
    rng, parameters, problem, _ = seeded_trial(44, frames=60, nodes=10)
    local, weight = problem.data.local.copy(), problem.data.weight.copy()
    wrong = np.arange(len(local)) % 3 == 0
    local[wrong] += 0.3 * rng.normal(size=(int(wrong.sum()), 3))
    weight[wrong] = 0.05
    placed = replace(problem.data.placed, local=local)
    problem = replace(problem, data=replace(problem.data, placed=placed, weight=weight))
    return problem, *started(problem, parameters)


def test_the_curved_matrix_is_the_derivative_of_the_gradient() -> None:
    """With weights that change and markers that are missing."""
    rng, parameters, problem, true = seeded_trial(41, frames=25, nodes=7)
    problem, body = with_gaps(problem, rng), problem.build_body(parameters)
    coefficients = true + rng.normal(0, 0.05, true.shape)
    found = problem.assemble_equations(coefficients, body, curved=True)
    plain = problem.assemble_equations(coefficients, body)

    def gradient(x: Array) -> Array:
        return problem.compute_gradient(x.reshape(coefficients.shape), body)[1]

    assert_derivative(from_band(found.band), gradient, coefficients.ravel())
    np.testing.assert_array_equal(found.node_gradient, plain.node_gradient)
    assert (
        np.abs(found.band - plain.band).max() > 1e-3 * np.abs(plain.band).max()
    )  # far above the tolerance


def test_tracking_ends_where_gauss_newton_does_not() -> None:
    problem, body, start = misplaced_trial()
    found = track_coefficients(problem, body, start, EXACT)
    assert found.converged and found.curved
    size = np.abs(problem.compute_gradient(start, body)[1]).max()
    assert np.abs(problem.compute_gradient(found.x, body)[1]).max() < 1e-9 * size
    without = track_coefficients(problem, body, start, replace(EXACT, curved_tries=0))
    assert without.steps > 2 * found.steps
    assert found.cost <= without.cost * (1 + 1e-9)


SAME = 1e-5
"""m, rad: how near to the minimum tracking ends at its own tolerance."""
FEW = 14
"""Steps; it takes 11, and 17 with factors that are never given up."""


def noisy_trial() -> tuple[MotionProblem, LinkageModel, Array]:
    rng, parameters, problem, _ = seeded_trial(30, frames=80, nodes=10)
    problem = noisy(problem, rng)
    return problem, *started(problem, parameters)


def test_the_last_steps_form_no_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, body, start = noisy_trial()
    calls: list[str] = []

    def counted(name: str) -> Callable[..., object]:
        plain = getattr(MotionProblem, name)
        return lambda *a, **k: (calls.append(name), plain(*a, **k))[1]

    for name in ("assemble_motion_equations", "compute_gradient"):
        monkeypatch.setattr(MotionProblem, name, counted(name))
    kept = track_coefficients(problem, body, start)
    with_keeping = list(calls)
    calls.clear()
    fresh = track_coefficients(problem, body, start, DescentSettings(keep_within=0.0))
    assert with_keeping[-1] == "compute_gradient" and "compute_gradient" not in calls
    assert with_keeping.count("assemble_motion_equations") < calls.count(
        "assemble_motion_equations"
    )
    exact = track_coefficients(problem, body, fresh.x, DescentSettings(gain=1e-15))
    for found in (kept, fresh):
        assert found.converged
        np.testing.assert_allclose(found.x, exact.x, rtol=0, atol=SAME)


def test_a_kept_factor_that_no_longer_serves_is_formed_anew() -> None:
    """Kept from however far away, the end is the same: too slow a step asks for a new matrix."""
    problem, body, start = noisy_trial()
    far = start + np.random.default_rng(31).normal(0, 0.3, start.shape)
    exact = track_coefficients(problem, body, start, DescentSettings(gain=1e-15))
    found = track_coefficients(problem, body, far, DescentSettings(gain=1e-10, keep_within=np.inf))
    assert found.converged and found.steps < FEW
    np.testing.assert_allclose(found.x, exact.x, rtol=0, atol=SAME)


SLOPE_GIB = 0.3
"""Growth from 5 000 to 20 000 frames; 0.18 GiB are needed. Ten times that is what 1.5 GiB leave for
100 000 frames.
"""


@pytest.mark.parametrize("first_damping", [0.0, 1e-3])
def test_large_matrices_are_factored_in_place(
    monkeypatch: pytest.MonkeyPatch, first_damping: float
) -> None:
    rng, parameters, problem, true = seeded_trial(6)
    body = problem.build_body(parameters)
    settings = DescentSettings(first_damping=first_damping)
    start = true + rng.normal(0, 0.3, true.shape)  # far enough off that some steps are refused
    plain = track_coefficients(problem, body, start, settings)
    monkeypatch.setattr(motion, "LARGE_MATRIX_BYTES", 0)
    lean = track_coefficients(problem, body, start, settings)
    assert (lean.steps, lean.converged) == (plain.steps, plain.converged)
    np.testing.assert_allclose(lean.x, plain.x, rtol=0, atol=1e-9)
    assert lean.cost == pytest.approx(plain.cost, rel=1e-6, abs=1e-18)


@pytest.mark.slow
def test_memory_of_a_long_recording() -> None:
    short, long = (tasks.usage(frames, 100.0) for frames in (5_000, 20_000))
    assert long["rms_mm"] < 2.5
    assert long["peak_gib"] < min(0.8, short["peak_gib"] + SLOPE_GIB)
