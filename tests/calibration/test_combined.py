"""The combined fit: the minimum of its cost, what it must achieve, and what spoils nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Stage
from gaitcal.calibration.combined import DESCENT, CombinedProblem, CombinedSettings, fit_combined
from gaitcal.calibration.inertial_calibration import (
    ConsistentSettings,
    LoadedMotion,
    LogChart,
    TorqueScale,
    assemble_root_equations,
    fit_consistent,
)
from gaitcal.calibration.joint_estimate import JointSearch
from gaitcal.dynamics.inverse_dynamics import Dynamics, compute_pelvis_residual
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    Parameters,
    is_physical,
    list_gait_parameters,
    make_symmetric_set,
    view_as_table,
)
from gaitcal.model.subject_model import Subject
from gaitcal.synthetic.synthetic_motion import (
    compute_residual_free_wrench,
    compute_synthetic_markers,
    draw_marker_noise,
    simulate_gait,
)
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.motion import track_coefficients
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from tests.calibration.test_torque_errors import PARAMETERS, smoothed_trial
from tests.derivatives import Array, started
from tests.messages import check_text
from tests.real_studies import load_study

MODEL, MOTION = published_model(), simulate_gait()
WRENCH = compute_residual_free_wrench(MODEL.parameters, MOTION)
EVERY = np.ones(len(MOTION.basis.time), dtype=bool)
SHARE = 0.02
SPREAD = ConsistentSettings(mass_spread=0.02, centre_spread=0.004, moment_spread=0.05)
"""So narrow that it shows beside the loads."""
NEAR = 1e-4
"""Of the largest change of a quantity (mass, place of the mass centre, moment); both solvers end
far nearer.
"""


def noisy_walk(seed: int, *size: float) -> MotionProblem:
    markers = compute_synthetic_markers(MODEL.parameters, MODEL.markers, MOTION.q)
    noisy = markers + draw_marker_noise(
        MOTION.basis.time, markers.shape[1], np.random.default_rng(seed), *size
    )
    recording = Recording(
        source="gait", time=MOTION.basis.time, labels=MODEL.markers.labels, markers=noisy
    )
    return build_trial_problem("gait", MODEL, recording, ControlPointRule(fixed=20))


@pytest.mark.slow
def test_inertial_parameters_end_where_a_dense_solver_puts_them() -> None:
    """Joint parameters and motion of the end given, by SciPy over all frames."""
    model, motion, problem = MODEL, MOTION, noisy_walk(71, 0.003)
    heavier = model.parameters.inertial.copy()
    heavier[[0, 7]] *= (1.1, 0.95)
    wrench = compute_residual_free_wrench(model.parameters.with_inertial(heavier), motion)
    body, start = started(problem, model.parameters)
    coefficients = track_coefficients(problem, body, start).x
    valid = np.arange(len(motion.basis.time)) % 3 != 0

    chart = LogChart(model.parameters.inertial, make_symmetric_set())
    trial = CombinedProblem(problem, coefficients, wrench, valid)
    settings = CombinedSettings(
        load_share=SHARE, spread=SPREAD, descent=replace(DESCENT, gain=1e-12)
    )
    found = fit_combined(
        [trial],
        model.parameters,
        list_gait_parameters("r"),
        make_symmetric_set(),
        model.subject,
        settings,
    )
    assert found.converged
    square = ((problem.compute_positions(coefficients, body) - problem.data.measured) ** 2).sum(
        axis=1
    ) / 3.0
    of_each = np.sqrt((problem.data.weight * square).sum() / (problem.data.weight > 0).sum())
    assert found.marker_sigma == pytest.approx(of_each, rel=1e-9)

    q, v, a = (problem.basis.evaluate(found.coefficients[0], k)[valid] for k in range(3))
    weight = model.subject.weight

    def loads(parameters: Parameters) -> Array:
        residual = compute_pelvis_residual(
            q, Dynamics(parameters).compute_forces(q, v, a, wrench[valid])
        )
        residual[:, 3:] /= model.subject.height
        return residual.ravel() / (SHARE * weight)

    def cost(x: Array) -> Array:
        return np.concatenate(
            [
                loads(found.parameters.with_inertial(chart.compute_inertial(x))),
                x / chart.compute_spread(SPREAD),
            ]
        )

    # MINPACK of older SciPy ends early on differences of one side
    dense = least_squares(
        cost, np.zeros(chart.size), jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-12
    )
    expected = view_as_table(chart.compute_inertial(dense.x))
    moved = np.abs(expected - view_as_table(model.parameters.inertial)).max(axis=0)
    gap = np.abs(view_as_table(found.parameters.inertial) - expected).max(axis=0)
    assert (gap <= NEAR * moved).all()


def test_third_step_explains_the_loads_at_little_cost_to_the_markers() -> None:
    problem = noisy_walk(3)
    free = (*list_gait_parameters("r"), *list_gait_parameters("l"))
    nominal = MODEL.parameters
    joint = JointSearch([problem], nominal, free, [started(problem, nominal)[1]]).run()
    q, v, a = (MOTION.basis.evaluate(joint.coefficients[0], k) for k in range(3))
    loaded = LoadedMotion(state=(q, v, a), wrench=WRENCH, valid=EVERY)
    system = assemble_root_equations(
        [loaded], joint.parameters, MODEL.subject, TorqueScale.BODY_HEIGHT, 0.176
    )
    inertial = fit_consistent(system, nominal.inertial, make_symmetric_set())
    two_steps = joint.parameters.with_inertial(inertial.inertial)
    trial = CombinedProblem(problem, joint.coefficients[0], WRENCH, EVERY)
    third = fit_combined([trial], two_steps, free, make_symmetric_set(), MODEL.subject)

    def squares(parameters: Parameters, coefficients: Array) -> Array:
        """Of force, moment and markers."""
        q, v, a = (MOTION.basis.evaluate(coefficients, k) for k in range(3))
        residual = compute_pelvis_residual(q, Dynamics(parameters).compute_forces(q, v, a, WRENCH))
        cost = problem.compute_cost(coefficients, problem.build_body(parameters))
        return np.array([np.mean(residual[:, :3] ** 2), np.mean(residual[:, 3:] ** 2), cost])

    before, after = (
        squares(two_steps, joint.coefficients[0]),
        squares(third.parameters, third.coefficients[0]),
    )
    assert third.converged
    assert (np.sqrt(after / before) < [0.6, 0.6, 1.1]).all()
    assert is_physical(third.parameters.inertial).all()
    assert third.parameters.mass == pytest.approx(nominal.mass, abs=1e-9)


def test_the_penalty_is_no_marker_error() -> None:
    """The third step weighs markers by their own residual alone."""
    problem, coefficients = smoothed_trial()
    settings, anyone = (
        CombinedSettings(descent=DescentSettings(most_steps=1)),
        Subject("anyone", 70.0, 1.75, "male"),
    )

    def sigma(trial: MotionProblem) -> float:
        loaded = [CombinedProblem(trial, coefficients, None, None)]
        return fit_combined(
            loaded, PARAMETERS, (), make_symmetric_set(), anyone, settings
        ).marker_sigma

    assert sigma(problem) == sigma(replace(problem, smoothing=None)) > 0.0


@pytest.mark.slow
def test_impossible_bodies_are_told_and_spoil_nothing_else(data_dir: Path, tmp_path: Path) -> None:
    """The published cost, scaled by 1 mm, gives negative masses on a real walk: a warning, no error
    bars, no crash.
    """
    text = 'ip = "published"\ntorque_scale = "1mm"\njoint_step = true'
    found = calibrate(load_study("subject01", data_dir.resolve(), tmp_path, text))
    check_text(found.warnings)
    loads = found.trial("walk").loads
    assert (
        loads.errors is None
        and Stage.COMBINED not in loads.moments
        and np.isfinite(loads.final.tau).all()
    )
