"""Inertial parameters and the third step: exact data, physical results, derivatives, and what the step must achieve."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.calibration.combined import CombinedTrial, combined_fit
from gaitcal.calibration.inertial_calibration import (
    LoadedMotion,
    RootEquations,
    TorqueScale,
    equations_of,
    fit_consistent,
    fit_published,
)
from gaitcal.calibration.inertial_chart import LogChart
from gaitcal.calibration.joint_calibration import JointSearch
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters, full_set, gait_parameters, is_physical, symmetric_set, table
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import trial_problem
from gaitcal.session.calibrate import calibrate
from gaitcal.session.result import Stage
from gaitcal.study.study import Study
from gaitcal.synthetic.motion import gait_motion, marker_noise, residual_free_wrench, synthetic_markers
from tests.derivatives import Array, assert_derivative
from tests.real_studies import write_study

MODEL = published_model()
MOTION = gait_motion()
WRENCH = residual_free_wrench(MODEL.parameters, MOTION)
EVERY = np.ones(len(MOTION.basis.time), dtype=bool)


def equations(nodes: Array, parameters: Parameters) -> RootEquations:
    q, v, a = (MOTION.basis.evaluate(nodes, k) for k in range(3))
    loaded = LoadedMotion(name="gait", q=q, velocity=v, acceleration=a, wrench=WRENCH, valid=EVERY)
    return equations_of([loaded], parameters, MODEL.subject, TorqueScale.BODY_HEIGHT, 0.176)


def seed(rng: np.random.Generator, share: float) -> Array:
    s = symmetric_set().selection
    mean = s.T @ MODEL.parameters.inertial / (s * s).sum(axis=0)
    return MODEL.parameters.inertial + s @ (mean * rng.uniform(-share, share, s.shape[1]))


def test_exact_loads_leave_nothing_and_keep_the_correct_seed() -> None:
    found = fit_published(equations(MOTION.nodes, MODEL.parameters), MODEL.parameters.inertial, symmetric_set())
    assert max(found.rms_force, found.rms_moment) < 1e-9
    np.testing.assert_allclose(found.inertial, MODEL.parameters.inertial, atol=1e-9)


@pytest.mark.parametrize("which", [symmetric_set(), full_set()], ids=["36", "84"])
def test_consistent_inertias_are_possible_and_keep_the_mass(which: object) -> None:
    rng = np.random.default_rng(1)
    system = equations(MOTION.nodes, MODEL.parameters)
    start = seed(rng, 0.05)
    before = system.rms(start)
    found = fit_consistent(system, start, which)  # type: ignore[arg-type]
    assert found.rms_force < before[0]
    assert is_physical(found.inertial).all()
    assert table(found.inertial)[:, 0].sum() == pytest.approx(table(start)[:, 0].sum(), abs=1e-10)


def test_log_chart_derivative() -> None:
    chart = LogChart(MODEL.parameters.inertial, symmetric_set())
    x = np.random.default_rng(2).normal(0, 0.1, chart.size)
    assert_derivative(chart.jacobian(x), chart.inertial, x)
    assert is_physical(chart.inertial(10 * x)).all()


def test_an_impossible_seed_is_refused() -> None:
    bad = MODEL.parameters.inertial.copy()
    bad[4] = -1.0
    with pytest.raises(ValueError, match="physically possible"):
        LogChart(bad, symmetric_set())


def test_third_step_explains_the_loads_at_little_cost_to_the_markers() -> None:
    rng = np.random.default_rng(3)
    markers = synthetic_markers(MODEL.parameters, MODEL.markers, MOTION.q)
    noisy = markers + marker_noise(MOTION.basis.time, markers.shape[1], rng)
    recording = Recording(source="gait", time=MOTION.basis.time, labels=MODEL.markers.labels, markers=noisy)
    problem = trial_problem("gait", MODEL, recording, NodeRule(fixed=20))
    free = (*gait_parameters("r"), *gait_parameters("l"))
    nominal = MODEL.parameters
    start = starting_nodes(problem.chain, problem.constants(nominal), problem.data, problem.basis)
    joint = JointSearch([problem], nominal, free, [start]).run()
    inertial = fit_consistent(equations(joint.nodes[0], joint.parameters), nominal.inertial, symmetric_set())
    two_steps = joint.parameters.with_inertial(inertial.inertial)
    third = combined_fit(
        [CombinedTrial(problem, joint.nodes[0], WRENCH, EVERY)], two_steps, free, symmetric_set(), MODEL.subject
    )

    def residuals(parameters: Parameters, nodes: Array) -> tuple[float, float, float]:
        q, v, a = (MOTION.basis.evaluate(nodes, k) for k in range(3))
        residual = pelvis_residual(q, Dynamics(parameters).forces(q, v, a, WRENCH))
        cost = problem.cost(nodes, problem.constants(parameters))
        return (
            float(np.sqrt(np.mean(residual[:, :3] ** 2))),
            float(np.sqrt(np.mean(residual[:, 3:] ** 2))),
            float(np.sqrt(cost)),
        )

    before, after = residuals(two_steps, joint.nodes[0]), residuals(third.parameters, third.nodes[0])
    assert third.converged
    assert after[0] < 0.6 * before[0]
    assert after[1] < 0.6 * before[1]
    assert after[2] < 1.1 * before[2]
    assert is_physical(third.parameters.inertial).all()
    assert third.parameters.mass == pytest.approx(nominal.mass, abs=1e-9)


def test_third_step_stays_where_nothing_is_left_to_explain() -> None:
    markers = synthetic_markers(MODEL.parameters, MODEL.markers, MOTION.q)
    recording = Recording(source="gait", time=MOTION.basis.time, labels=MODEL.markers.labels, markers=markers + 1e-4)
    problem = trial_problem("gait", MODEL, recording, NodeRule(fixed=20))
    trial = CombinedTrial(problem, MOTION.nodes, WRENCH, EVERY)
    free = gait_parameters("r")
    found = combined_fit([replace(trial)], MODEL.parameters, free, symmetric_set(), MODEL.subject)
    np.testing.assert_allclose(found.parameters.joint, MODEL.parameters.joint, atol=2e-3)


@pytest.mark.slow
def test_impossible_bodies_are_told_and_spoil_nothing_else(data_dir: Path, tmp_path: Path) -> None:
    """The published cost, scaled by 1 mm, gives negative masses on a real walk: a warning, no error bars, no crash."""
    text = 'ip = "published"\ntorque_scale = "1mm"\njoint_step = true'
    found = calibrate(Study.load(write_study("subject01", data_dir.resolve(), tmp_path, text)))
    assert any("no real body" in warning for warning in found.warnings)
    loads = found.trial("walk").loads
    assert loads is not None
    assert loads.errors is None
    assert Stage.COMBINED not in loads.moments
    assert np.isfinite(loads.final.tau).all()
