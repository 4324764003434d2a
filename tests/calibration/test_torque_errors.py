"""Standard errors of torques and coordinates: sums of squares of finite differences; blocks of long trials change
nothing. Their size is in `test_coverage`.
"""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration import torque_errors
from gaitcal.calibration.influence import Influence, influence_of
from gaitcal.calibration.joint_calibration import calibrate_joints
from gaitcal.calibration.torque_errors import MarkerMoves, coordinate_standard_errors, torque_standard_errors
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.dynamics.torque_sources import Source
from gaitcal.model.joint_parameters import JP_INDEX, gait_parameters
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import NodeRule, TrialProblem, trial_problem
from gaitcal.recording import Recording
from gaitcal.synthetic.measurements import marker_noise, residual_free_wrench, synthetic_markers
from gaitcal.synthetic.motion import NODES, gait_motion
from tests.derivatives import Array, perturbed_parameters, random_trial

DIFFERENCES = 1e-6
"""Relative to the largest error: what central differences can tell."""
STEP = 1e-4
"""Of one standard deviation; the forces are cubic at most in the inertial parameters."""
FREE = gait_parameters("r")


def moved_torques(
    problem: TrialProblem, nodes: Array, parameters: Parameters, wrench: Array, error: tuple[Array, Array, Array]
) -> Array:
    """(nf, 29) change of the generalised forces by one source of error: of the nodes (nn, nq), of `FREE` and of the
    inertial parameters (84,), by central differences.
    """
    by_nodes, by_joint, by_inertial = error
    at = parameters.joint[[JP_INDEX[name] for name in FREE]]

    def torques(step: float) -> Array:
        moved = parameters.with_joint(FREE, at + step * by_joint)
        moved = moved.with_inertial(parameters.inertial + step * by_inertial)
        return Dynamics(moved).forces(*(problem.basis.evaluate(nodes + step * by_nodes, k) for k in range(3)), wrench)

    return (torques(STEP) - torques(-STEP)) / (2 * STEP)


def test_torque_errors_are_what_every_source_moves_by_itself() -> None:
    """The sum of squares over marker coordinates, with joint parameters and motion, and over inertial parameters."""
    rng = np.random.default_rng(51)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, frames=14, nodes=7)
    wrench = rng.normal(0, 300, (14, 2, 6))
    free = problem.with_free(FREE).chain.free
    assert set(free) == set(FREE)
    own, others = 3, 2
    moves = MarkerMoves(
        shift=rng.normal(0, 0.005, (len(free), own + others)),
        nodes=rng.normal(0, 0.01, (nodes.size, own)),
        sensitivity=rng.normal(0, 1.0, (nodes.size, len(free))),
        sources=(Source.MOTION,) * own + (Source.JOINT_MARKERS, Source.SKIN),
    )
    spread = 0.1 * parameters.inertial[:, None] * rng.normal(size=(84, 4))
    influence = Influence(free, moves.shift, tuple(f"source {k}" for k in range(own + others)))
    errors: list[tuple[Array, Array, Array]] = []
    still, rigid = np.zeros(nodes.shape), np.zeros(84)
    order = [free.index(name) for name in FREE]
    for k in range(own + others):
        by_nodes = -moves.sensitivity @ moves.shift[:, k] + (moves.nodes[:, k] if k < own else 0.0)
        errors.append((by_nodes.reshape(nodes.shape), moves.shift[order, k], rigid))
    errors += [(still, np.zeros(len(FREE)), column) for column in spread.T]
    changes = np.array([moved_torques(problem, nodes, parameters, wrench, error) for error in errors])
    dense = np.sqrt((changes**2).sum(axis=0))
    errors_found = torque_standard_errors(problem, nodes, parameters, wrench, influence, spread, moves)
    found = errors_found.every
    np.testing.assert_allclose(found, dense, rtol=0, atol=DIFFERENCES * dense.max())
    of_inertia = np.sqrt((changes[own + others :] ** 2).sum(axis=0))
    assert np.median(of_inertia / dense) > 0.05  # so that its absence would show

    by_node = np.array([problem.basis.evaluate(by_nodes) for by_nodes, _, _ in errors[: own + others]])
    coordinates = np.sqrt((by_node**2).sum(axis=0))
    np.testing.assert_allclose(coordinate_standard_errors(problem, moves), coordinates, rtol=1e-10)


def test_blocks_of_frames_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    model, motion = published_model(), gait_motion()
    time = motion.basis.time
    markers = synthetic_markers(model.parameters, model.markers, motion.q)
    noise = marker_noise(time, markers.shape[1], np.random.default_rng(3), 0.005)
    recording = Recording(source="made up", time=time, labels=model.markers.labels, markers=markers + noise)
    problem = trial_problem("gait", model, recording, NodeRule(fixed=NODES))
    free = gait_parameters("r")
    closed = problem.with_free(())
    start = starting_nodes(closed.chain, closed.constants(model.parameters), problem.data, problem.basis)
    fit = calibrate_joints([problem], model.parameters, free, [start])
    wrench = residual_free_wrench(model.parameters, motion)

    moves = torque_errors.marker_moves(problem, fit.nodes[0], fit.parameters, influence_of([problem], fit))

    def errors() -> tuple[np.ndarray, np.ndarray]:
        torques = torque_errors.torque_standard_errors(
            problem, fit.nodes[0], fit.parameters, wrench, influence_of([problem], fit), None
        )
        return torques.every, torque_errors.coordinate_standard_errors(problem, moves)

    torques, coordinates = errors()
    assert torques.shape == (len(time), 29)
    assert coordinates.shape == (len(time), 27)
    assert (torques > 0).all() and (coordinates > 0).all()
    for module in (torque_errors,):
        monkeypatch.setattr(module, "BLOCK", 17)
    for found, whole in zip(errors(), (torques, coordinates), strict=True):
        np.testing.assert_allclose(found, whole, rtol=1e-9)
