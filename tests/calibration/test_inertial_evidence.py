"""Inertial parameters move where the residual asks for it: the noise against simulation, the fit
against algebra.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration.error_sources import make_nominal_errors
from gaitcal.calibration.inertial_calibration import (
    ConsistentSettings,
    LoadedMotion,
    LogChart,
    RootEquations,
    TorqueScale,
    assemble_root_equations,
    differentiate_by_inertial,
)
from gaitcal.calibration.inertial_evidence import (
    STRONG,
    LoadedProblem,
    PlateNoise,
    ResidualNoise,
    compute_fixed_spread,
    compute_log_bayes_factor,
    estimate_residual_noise,
    fit_by_evidence,
    keep_nominal,
)
from gaitcal.calibration.torque_errors import factor_inertial_covariance
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Dynamics, compute_pelvis_residual
from gaitcal.dynamics.measurement_errors import PlateErrors
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    MASSIVE_SEGMENTS,
    Parameters,
    is_physical,
    make_full_set,
    make_symmetric_set,
    view_as_table,
)
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench, simulate_gait
from gaitcal.tracking.motion import track_motion
from gaitcal.tracking.spline import ControlPointRule, build_spline_basis, compute_frame_rate
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from tests.derivatives import noisy
from tests.messages import check_text
from tests.synthetic_studies import made_recording

MODEL, MOTION = published_model(), simulate_gait()
SUBJECT, TRUE = MODEL.subject, MODEL.parameters
SETTINGS = ConsistentSettings()
WHICH = make_symmetric_set()
ROUNDING = 1e-9
EXACT = PlateErrors(position=0.0, gain=0.0, time_offset=0.0)
USUAL = ControlPointRule()


def problem_of(noise: float, seed: int = 0, rule: ControlPointRule = USUAL) -> MotionProblem:
    """The published walk, its markers moved by white noise (m)."""
    problem = build_trial_problem("walk", MODEL, made_recording(MOTION), rule)
    return noisy(problem, np.random.default_rng(seed), noise)


def reactions() -> GroundReactions:
    """That leave no residual with the true inertial parameters, valid but for the ends."""
    wrench = compute_residual_free_wrench(TRUE, MOTION)
    inside = np.zeros(len(wrench), dtype=bool)
    inside[10:-10] = True
    down = np.ones((len(wrench), 2), dtype=bool)
    legs = np.stack([inside] * 2, axis=1)
    return GroundReactions(
        wrench=wrench, valid=inside, valid_legs=legs, loaded=down, resting=down, notes=()
    )


def loaded(noise: float, seed: int = 0, rule: ControlPointRule = USUAL) -> LoadedProblem:
    problem = problem_of(noise, seed, rule)
    coefficients = track_motion(problem, TRUE).coefficients
    return LoadedProblem(problem=problem, coefficients=coefficients, reactions=reactions())


def state(trial: LoadedProblem, valid: BoolArray | None = None) -> tuple[Array, Array, Array]:
    """Coordinates and their derivatives in valid frames, or in all."""
    q, v, a = (trial.problem.basis.evaluate(trial.coefficients, k) for k in range(3))
    return (q, v, a) if valid is None else (q[valid], v[valid], a[valid])


def residual_of(trial: LoadedProblem, state: tuple[Array, Array, Array]) -> Array:
    """(n, 6) the pelvis residual of true parameters in valid frames."""
    wrench = trial.reactions.wrench[trial.reactions.valid]
    return compute_pelvis_residual(state[0], Dynamics(TRUE).compute_forces(*state, wrench))


def system(trial: LoadedProblem, parameters: Parameters) -> RootEquations:
    motion = LoadedMotion(
        state=state(trial), wrench=trial.reactions.wrench, valid=trial.reactions.valid
    )
    return assemble_root_equations([motion], parameters, SUBJECT, TorqueScale.BODY_HEIGHT, 0.2)


def noise_of(
    trial: LoadedProblem, parameters: Parameters, plates: PlateNoise | None = None
) -> ResidualNoise:
    none = replace(make_nominal_errors(("hip_r.pelvis.ant",)), effects=np.zeros((1, 1)))
    chart = LogChart(parameters.inertial, WHICH)
    return estimate_residual_noise(
        [trial], parameters, none, SUBJECT, chart, SUBJECT.height, plates
    )


def changed(masses: float) -> Parameters:
    """Nominal parameters of which the shanks are that much too heavy, and the trunk too light."""
    rows = view_as_table(TRUE.inertial.copy())
    shanks = [MASSIVE_SEGMENTS.index(f"shank_{side}") for side in "rl"]
    before = rows[shanks, 0].sum()
    rows[shanks, 0] *= 1.0 + masses
    rows[MASSIVE_SEGMENTS.index("head_trunk"), 0] -= rows[shanks, 0].sum() - before
    return TRUE.with_inertial(rows.ravel())


def mass_error(inertial: Array) -> float:
    return float(
        np.sqrt(np.mean((view_as_table(inertial)[:, 0] - view_as_table(TRUE.inertial)[:, 0]) ** 2))
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_what_noise_makes_moves_no_mass(seed: int) -> None:
    """10 mm of noise, true masses: the residual is what was to be expected, and the parameters stay
    where they are.
    """
    trial = loaded(0.010, seed)
    noise = noise_of(trial, TRUE)
    found = fit_by_evidence(system(trial, TRUE), TRUE.inertial, WHICH, noise)
    assert not found.moved
    np.testing.assert_array_equal(found.inertial, TRUE.inertial)
    assert found.rms_force > 5.0, "there is a residual"
    assert found.rms_force < 1.5 * noise.rms_force and found.rms_moment < 1.5 * noise.rms_moment
    check_text(found.message)


def test_masses_that_are_wrong_move_towards_the_truth() -> None:
    """Shanks half as heavy again, 2 mm of noise: decisive, nearer, possible, as heavy as before,
    and told.
    """
    trial, wrong = loaded(0.002, 3), changed(0.5)
    found = fit_by_evidence(system(trial, wrong), wrong.inertial, WHICH, noise_of(trial, wrong))
    assert found.moved and found.converged
    assert mass_error(found.inertial) < 0.6 * mass_error(wrong.inertial)
    assert is_physical(found.inertial).all()
    assert view_as_table(found.inertial)[:, 0].sum() == pytest.approx(
        view_as_table(TRUE.inertial)[:, 0].sum(), abs=1e-9
    )
    force, moment = system(trial, wrong).compute_rms(wrong.inertial)
    assert found.rms_force < force and found.rms_moment < moment
    assert "stay the table's" not in found.message
    check_text(found.message)
    spread = factor_inertial_covariance(keep_nominal(wrong.inertial, WHICH))
    known = factor_inertial_covariance(found)
    narrower = (known**2).sum(axis=1) / np.maximum((spread**2).sum(axis=1), 1e-300)
    free = (spread**2).sum(axis=1) > 0
    assert narrower[free].min() < 0.5, "what the residual tells is better known than by the table"


def test_people_scatter_about_nominal_values() -> None:
    """Masses by a tenth, at unchanged total, of feet by more; centres by 10 mm; second moments by
    15 %.
    """
    kept = keep_nominal(TRUE.inertial, WHICH)
    errors = view_as_table(np.sqrt((factor_inertial_covariance(kept) ** 2).sum(axis=1)))
    thigh, foot = (MASSIVE_SEGMENTS.index(name) for name in ("thigh_r", "foot_r"))
    rows = view_as_table(TRUE.inertial)
    assert errors[foot, 0] / rows[foot, 0] == pytest.approx(SETTINGS.foot_mass_spread, rel=0.05)
    assert errors[thigh, 2] == pytest.approx(SETTINGS.centre_spread, rel=ROUNDING)
    assert 0.5 * SETTINGS.mass_spread < errors[thigh, 0] / rows[thigh, 0] < SETTINGS.mass_spread
    assert (
        0.5 * SETTINGS.moment_spread
        < errors[thigh, 4] / rows[thigh, 4]
        < 1.5 * SETTINGS.moment_spread
    )


def test_mass_centres_that_no_fit_moves_scatter_too() -> None:
    """By as much as others; masses and moments are the fit's, pelvis and trunk symmetric."""
    rest = view_as_table(np.sqrt((compute_fixed_spread(TRUE.inertial, WHICH) ** 2).sum(axis=1)))
    known = view_as_table(
        np.sqrt((factor_inertial_covariance(keep_nominal(TRUE.inertial, WHICH)) ** 2).sum(axis=1))
    )
    limbs = np.array([name.endswith(("_r", "_l")) for name in MASSIVE_SEGMENTS])
    feet = np.array([name.startswith("foot") for name in MASSIVE_SEGMENTS])
    np.testing.assert_allclose(
        (rest + known)[limbs & ~feet, 1:4], SETTINGS.centre_spread, rtol=1e-6
    )
    np.testing.assert_allclose((rest + known)[feet, 1:4], SETTINGS.foot_centre_spread, rtol=1e-6)
    np.testing.assert_allclose((rest + known)[~limbs, 1:3], SETTINGS.centre_spread, rtol=1e-6)
    assert not rest[~limbs, 3].any() and not rest[:, 0].any() and not rest[:, 4:].any()
    assert compute_fixed_spread(TRUE.inertial, make_full_set()).shape[1] == 0


def test_what_stays_nominal_makes_scores_as_a_change_of_it_does() -> None:
    """A^T d rho of every column of its spread, squares summed."""
    trial, unmoved = loaded(0.0), compute_fixed_spread(TRUE.inertial, WHICH)
    chart = LogChart(TRUE.inertial, WHICH)
    none = replace(make_nominal_errors(("hip_r.pelvis.ant",)), effects=np.zeros((1, 1)))
    without, with_it = (
        estimate_residual_noise(
            [trial],
            TRUE,
            none,
            SUBJECT,
            chart,
            SUBJECT.height,
            PlateNoise(EXACT, rest=0.0),
            unmoved=u,
        )
        for u in (None, unmoved)
    )
    by_ip = differentiate_by_inertial(system(trial, TRUE).factor, TRUE.inertial)
    scores = (by_ip @ chart.compute_jacobian(np.zeros(chart.size))).T @ by_ip @ unmoved
    expected = scores @ scores.T
    difference = with_it.covariance - without.covariance
    np.testing.assert_allclose(difference, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert with_it.rms_moment > 1.1 * without.rms_moment


def test_a_plate_that_is_off_makes_the_residual_that_is_expected_of_it() -> None:
    """Gain and place alone, against the residual of wrenches so changed."""
    trial = loaded(0.0)
    plates = PlateNoise(PlateErrors(position=0.004, gain=0.0, time_offset=0.0), rest=0.0)
    valid = trial.reactions.valid
    q, v, a = state(trial, valid)
    dynamics, wrench = Dynamics(TRUE), trial.reactions.wrench[valid]
    before = compute_pelvis_residual(q, dynamics.compute_forces(q, v, a, wrench))

    def change(foot: int, moved: Array) -> Array:
        other = wrench.copy()
        other[:, foot] = moved
        return compute_pelvis_residual(q, dynamics.compute_forces(q, v, a, other)) - before

    total = np.zeros(6)
    for foot in range(2):
        for axis in np.eye(3):
            force = wrench[:, foot, :3]
            turned = wrench[:, foot, 3:] + np.cross(plates.errors.position * axis, force)
            total += (change(foot, np.hstack([force, turned])) ** 2).sum(axis=0)
    without = noise_of(trial, TRUE, PlateNoise(EXACT, rest=0.0))
    with_place = noise_of(trial, TRUE, plates)
    expected = float(np.sqrt(total[3:].sum() / (3 * valid.sum())))
    found = float(np.sqrt(with_place.rms_moment**2 - without.rms_moment**2))
    assert found == pytest.approx(expected, rel=1e-6)
    gains = noise_of(
        trial, TRUE, PlateNoise(PlateErrors(position=0.0, gain=0.02, time_offset=0.0), rest=0.0)
    )
    total = np.zeros(6)
    for foot in range(2):
        total += (change(foot, 1.02 * wrench[:, foot]) ** 2).sum(axis=0)
    found = (gains.rms_force**2 - without.rms_force**2, gains.rms_moment**2 - without.rms_moment**2)
    np.testing.assert_allclose(
        found, total.reshape(2, 3).sum(axis=1) / (3 * valid.sum()), rtol=1e-6
    )


def test_what_is_independent_weighs_the_scores_like_white_noise() -> None:
    """sigma^2 A^T A, as often as frames repeat each other: six of sixty a second."""
    trial, rest = loaded(0.0), 0.007
    rate = compute_frame_rate(trial.problem.basis)
    with_rest, without = (
        noise_of(trial, TRUE, PlateNoise(rest=r, memory=0.1)) for r in (rest, 0.0)
    )
    chart = LogChart(TRUE.inertial, WHICH)
    rows = differentiate_by_inertial(
        system(trial, TRUE).factor, TRUE.inertial
    ) @ chart.compute_jacobian(np.zeros(chart.size))
    expected = max(0.1 * rate, 1.0) * rest**2 * rows.T @ rows
    difference = with_rest.covariance - without.covariance
    np.testing.assert_allclose(
        difference, expected, rtol=0, atol=1e-9 * np.abs(without.covariance).max()
    )


def test_half_an_octave_of_the_motion_is_a_source() -> None:
    """A walk without noise in its own spline space, plates without error: what is left is what
    longer spans lose.
    """
    trial, none = (
        loaded(0.0, rule=ControlPointRule(fixed=MOTION.basis.control_points)),
        PlateNoise(EXACT, rest=0.0),
    )
    basis, valid = trial.problem.basis, trial.reactions.valid
    spans = round((basis.control_points - 5) / np.sqrt(2.0))
    longer = build_spline_basis(basis.time, spans + 5)
    fewer = longer.fit(basis.evaluate(trial.coefficients))
    q, v, a = (longer.evaluate(fewer, k)[valid] for k in range(3))
    lost = residual_of(trial, state(trial, valid)) - residual_of(trial, (q, v, a))
    expected = np.sqrt((lost**2).reshape(-1, 2, 3).mean(axis=(0, 2)))
    found = noise_of(trial, TRUE, none)
    np.testing.assert_allclose((found.rms_force, found.rms_moment), expected, rtol=1e-3)
    assert expected.min() > 0.1


def test_expected_residuals_are_those_of_noise_repeated() -> None:
    """Marker noise of 6 mm that lasts for a second, drawn again and again: RMS residuals within a
    third of expected.
    """
    problem, down = problem_of(0.0), reactions()
    rng = np.random.default_rng(5)
    expected, seen = [], []
    for _ in range(6):
        phase = rng.uniform(0.0, 2.0 * np.pi, (*problem.data.measured.shape[:2], 1))
        rate = rng.uniform(0.0, 25.0, phase.shape)
        moved = problem.with_measured(
            problem.data.measured + 0.0085 * np.sin(rate * problem.basis.time + phase)
        )
        coefficients = track_motion(moved, TRUE).coefficients
        trial = LoadedProblem(problem=moved, coefficients=coefficients, reactions=down)
        residual = residual_of(trial, state(trial, down.valid))
        seen.append((residual**2).reshape(-1, 2, 3).mean(axis=(0, 2)))
        noise = noise_of(trial, TRUE, PlateNoise(EXACT, rest=0.0))
        expected.append((noise.rms_force**2, noise.rms_moment**2))
    ratio = np.sqrt(np.mean(expected, axis=0) / np.mean(seen, axis=0))
    assert (ratio > 0.67).all() and (ratio < 1.5).all(), ratio


def test_the_bayes_factor_is_that_of_two_normal_distributions() -> None:
    rng = np.random.default_rng(6)
    scores, slopes = rng.normal(size=5), rng.normal(size=(5, 3))
    wide = np.eye(5) + slopes @ slopes.T

    def log_density(covariance: Array) -> float:
        return float(
            -0.5 * (np.linalg.slogdet(covariance)[1] + scores @ np.linalg.solve(covariance, scores))
        )

    assert compute_log_bayes_factor(scores, slopes) == pytest.approx(
        log_density(wide) - log_density(np.eye(5)), rel=1e-12
    )
    assert (
        compute_log_bayes_factor(np.zeros(5), slopes)
        < 0.0
        < STRONG
        < compute_log_bayes_factor(10.0 * slopes[:, 0], slopes)
    )


def test_a_table_that_may_be_the_wrong_one_widens_what_it_says() -> None:
    chart = LogChart(TRUE.inertial, WHICH)
    plain, wider = (
        chart.compute_spread(SETTINGS),
        chart.compute_spread(replace(SETTINGS, more_of={"thigh.mass": 0.2})),
    )
    for name, before, after in zip(WHICH.names, plain, wider, strict=True):
        widened = name.startswith("thigh") and name.endswith(".mass")
        assert after == pytest.approx(np.hypot(before, 0.2) if widened else before), name
