"""The combined fit ends at the minimum of its cost: markers, loads and the spread of the inertial variables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from gaitcal.calibration.combined import DESCENT, CombinedSettings, CombinedTrial, combined_fit
from gaitcal.calibration.inertial_chart import ConsistentSettings, LogChart
from gaitcal.dynamics.inverse_dynamics import Dynamics, pelvis_residual
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters, gait_parameters, symmetric_set, table
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import trial_problem
from gaitcal.synthetic.motion import gait_motion, marker_noise, residual_free_wrench, synthetic_markers
from tests.derivatives import Array

SHARE = 0.02
SPREAD = ConsistentSettings(mass_spread=0.02, centre_spread=0.004, moment_spread=0.05)
"""So narrow that it shows beside the loads."""
NEAR = 1e-4
"""Of the largest change of a quantity (mass, place of the mass centre, moment); both solvers end far nearer."""


@pytest.mark.slow
def test_inertial_parameters_end_where_a_dense_solver_puts_them() -> None:
    """Joint parameters and motion of the end given, by SciPy over all frames."""
    model, motion = published_model(), gait_motion()
    rng = np.random.default_rng(71)
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    noisy = markers + marker_noise(motion.basis.time, markers.shape[1], rng, 0.003)
    recording = Recording(source="gait", time=motion.basis.time, labels=model.markers.labels, markers=noisy)
    problem = trial_problem("gait", model, recording, NodeRule(fixed=20))
    heavier = model.parameters.inertial.copy()
    heavier[[0, 7]] *= (1.1, 0.95)
    wrench = residual_free_wrench(model.parameters.with_inertial(heavier), motion)
    constants = problem.constants(model.parameters)
    start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    nodes = track_nodes(problem, constants, start).nodes
    valid = np.arange(len(motion.basis.time)) % 3 != 0

    chart = LogChart(model.parameters.inertial, symmetric_set())
    trial = CombinedTrial(problem, nodes, wrench, valid)
    settings = CombinedSettings(load_share=SHARE, spread=SPREAD, descent=replace(DESCENT, gain=1e-12))
    found = combined_fit([trial], model.parameters, gait_parameters("r"), symmetric_set(), model.subject, settings)
    assert found.converged
    square = ((problem.positions(nodes, constants) - problem.data.measured) ** 2).sum(axis=1) / 3.0
    of_each = np.sqrt((problem.data.weight * square).sum() / (problem.data.weight > 0).sum())
    assert found.marker_sigma == pytest.approx(of_each, rel=1e-9)

    q, v, a = (problem.basis.evaluate(found.nodes[0], k)[valid] for k in range(3))
    weight = model.subject.weight

    def loads(parameters: Parameters) -> Array:
        residual = pelvis_residual(q, Dynamics(parameters).forces(q, v, a, wrench[valid]))
        residual[:, 3:] /= model.subject.height
        return residual.ravel() / (SHARE * weight)

    def cost(x: Array) -> Array:
        return np.concatenate([loads(found.parameters.with_inertial(chart.inertial(x))), x / chart.spread(SPREAD)])

    # MINPACK of older SciPy ends early on differences of one side
    dense = least_squares(cost, np.zeros(chart.size), jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    expected = table(chart.inertial(dense.x))
    moved = np.abs(expected - table(model.parameters.inertial)).max(axis=0)
    gap = np.abs(table(found.parameters.inertial) - expected).max(axis=0)
    assert (gap <= NEAR * moved).all()
