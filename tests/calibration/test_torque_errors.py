"""Standard errors of torques and coordinates: sums of squares of finite differences; blocks of long trials change
nothing. Their size is in `test_coverage`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from gaitcal.calibration import error_sources as moves_module
from gaitcal.calibration import torque_errors
from gaitcal.calibration.error_sources import (
    ErrorSources,
    MotionSensitivity,
    _product_squares,
    coordinate_standard_errors,
    marker_moves,
    nominal_influence,
    source_of,
)
from gaitcal.calibration.joint_calibration import JointSearch
from gaitcal.calibration.torque_errors import torque_standard_errors
from gaitcal.dynamics.axis_errors import AxisErrors, ErrorSource
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.plate_errors import PlateErrors
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import IP_NAMES, JP_INDEX, Parameters, gait_parameters
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import TrialProblem, trial_problem
from gaitcal.synthetic.motion import NODES, gait_motion, marker_noise, residual_free_wrench, synthetic_markers
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
    moves = MotionSensitivity(
        shift=rng.normal(0, 0.005, (len(free), others)),
        nodes=rng.normal(0, 0.01, (nodes.size, own)),
        sensitivity=rng.normal(0, 1.0, (nodes.size, len(free))),
        own=(ErrorSource.MOTION,) * own,
        others=(ErrorSource.JOINT_MARKERS, ErrorSource.SKIN),
    )
    spread = 0.1 * parameters.inertial[:, None] * rng.normal(size=(len(IP_NAMES), 4))
    influence = ErrorSources(free, moves.shift, tuple(f"source {k}" for k in range(others)))
    errors: list[tuple[Array, Array, Array]] = []
    still, rigid = np.zeros(nodes.shape), np.zeros(len(IP_NAMES))
    order = [free.index(name) for name in FREE]
    errors += [(column.reshape(nodes.shape), np.zeros(len(FREE)), rigid) for column in moves.nodes.T]
    errors += [(-(moves.sensitivity @ s).reshape(nodes.shape), s[order], rigid) for s in moves.shift.T]
    errors += [(still, np.zeros(len(FREE)), column) for column in spread.T]
    changes = np.array([moved_torques(problem, nodes, parameters, wrench, error) for error in errors])
    dense = np.sqrt((changes**2).sum(axis=0))
    errors_found = torque_standard_errors(problem, nodes, parameters, wrench, influence, spread, moves)
    found = errors_found.every
    np.testing.assert_allclose(found, dense, rtol=0, atol=DIFFERENCES * dense.max())
    groups = {
        ErrorSource.MOTION: slice(0, own),
        ErrorSource.JOINT_MARKERS: slice(own, own + 1),
        ErrorSource.SKIN: slice(own + 1, own + others),
        ErrorSource.INERTIA: slice(own + others, None),
    }
    assert set(errors_found.by_source) == set(groups)
    for source, columns in groups.items():
        expected = (changes[columns] ** 2).sum(axis=0)
        tolerance = DIFFERENCES * dense.max() ** 2
        np.testing.assert_allclose(errors_found.by_source[source], expected, rtol=0, atol=tolerance, err_msg=source.key)
    of_inertia = np.sqrt((changes[own + others :] ** 2).sum(axis=0))
    assert np.median(of_inertia / dense) > 0.05  # so that its absence would show

    by_node = np.array([problem.basis.evaluate(by_nodes) for by_nodes, _, _ in errors[: own + others]])
    coordinates = np.sqrt((by_node**2).sum(axis=0))
    np.testing.assert_allclose(coordinate_standard_errors(problem, moves), coordinates, rtol=1e-10)


def test_directions_of_axes_add_their_own_part_to_torques_and_to_coordinates_that_markers_move() -> None:
    rng = np.random.default_rng(53)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, frames=14, nodes=7)
    weight = problem.data.weight.copy()
    weight[[problem.chain.segments[s].startswith("forearm") for s in problem.data.segment]] = 0.0
    problem = problem.with_weight(weight)
    wrench, known, axes = rng.normal(0, 300, (14, 2, 6)), nominal_influence(FREE), AxisErrors(parameters)
    exact, moved = (
        torque_standard_errors(problem, nodes, parameters, wrench, known, None, axes=a) for a in (None, axes)
    )
    assert ErrorSource.FRAMES not in exact.by_source
    for source, variance in exact.by_source.items():
        np.testing.assert_array_equal(moved.by_source[source], variance)
    q, v, a = (problem.basis.evaluate(nodes, k) for k in range(3))
    expected = (axes.torque_moves(q, v, a, wrench) ** 2).sum(axis=2)
    np.testing.assert_allclose(moved.by_source[ErrorSource.FRAMES], expected, rtol=1e-9, atol=1e-12)
    moves, turned = marker_moves(problem, nodes, parameters, known), axes.coordinate_errors(q)
    plain, whole = coordinate_standard_errors(problem, moves), coordinate_standard_errors(problem, moves, turned)
    held = ~problem.active
    assert held.any()
    np.testing.assert_array_equal(whole[:, held], plain[:, held])
    np.testing.assert_allclose(whole[:, ~held], np.hypot(plain, turned)[:, ~held], rtol=1e-12)


def test_force_plates_add_their_own_part_and_change_no_other() -> None:
    rng = np.random.default_rng(52)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, frames=14, nodes=7)
    wrench = rng.normal(0, 300, (14, 2, 6))
    known = nominal_influence(FREE)
    exact, moved = (
        torque_standard_errors(problem, nodes, parameters, wrench, known, None, plates=plates)
        for plates in (None, PlateErrors(place=0.003, gain=0.01, clock=0.002))
    )
    assert ErrorSource.PLATES not in exact.by_source
    for source, variance in exact.by_source.items():
        np.testing.assert_array_equal(moved.by_source[source], variance)
    rates = np.gradient(wrench, problem.basis.time, axis=0)
    q, v, a = (problem.basis.evaluate(nodes, k) for k in range(3))
    before = Dynamics(parameters).forces(q, v, a, wrench)
    expected = np.zeros_like(before)
    for other in plate_changes(wrench, rates):
        expected += (Dynamics(parameters).forces(q, v, a, wrench + other) - before) ** 2
    found = moved.by_source[ErrorSource.PLATES]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * expected.max())
    np.testing.assert_allclose(moved.every**2, exact.every**2 + found, rtol=1e-9)


def plate_changes(wrench: Array, rates: Array) -> Iterator[Array]:
    """What one standard deviation of 3 mm, 1 % and 2 ms each makes of the wrenches."""
    yield 0.002 * rates
    for foot in range(2):
        for axis in (None, *np.eye(3)):
            out = np.zeros_like(wrench)
            if axis is None:
                out[:, foot] = 0.01 * wrench[:, foot]
            else:
                out[:, foot, 3:] = np.cross(0.003 * axis, wrench[:, foot, :3])
            yield out


def test_columns_of_an_influence_belong_to_sources_by_their_names() -> None:
    """Trials may be called anything: `skin/R.Knee/x` is a marker coordinate of a trial called skin."""
    cases = {
        "markers/walk/3": ErrorSource.JOINT_MARKERS,
        "hip_r/R.Knee/x": ErrorSource.JOINT_MARKERS,
        "skin/R.Knee/x": ErrorSource.JOINT_MARKERS,
        "nominal/R.Knee/z": ErrorSource.JOINT_MARKERS,
        "bandwidth/R.Knee/z": ErrorSource.JOINT_MARKERS,
        "nominal/hip_r.pelvis.ant": ErrorSource.JOINT_NOMINAL,
        "skin/gait/knee_angle_r/shank_r/tx": ErrorSource.SKIN,
        "skin/gait/knee_angle_r^2/shank_r/rz": ErrorSource.SKIN,
        "skin/found": ErrorSource.SKIN,
        "bandwidth/walk": ErrorSource.BANDWIDTH,
        "posture/walk/12": ErrorSource.POSTURE,
        "posture/R.Knee/x": ErrorSource.JOINT_MARKERS,
    }
    assert {name: source_of(name) for name in cases} == cases


def test_sources_of_an_influence_stay_apart_when_they_are_compressed() -> None:
    """Many columns of one source become few with the same covariance."""
    rng = np.random.default_rng(53)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, frames=14, nodes=7)
    names = problem.with_free(FREE).chain.free
    clusters = [*(f"markers/other/{k}" for k in range(90)), *(f"nominal/{name}" for name in names), "skin/found"]
    influence = ErrorSources(names, rng.normal(0, 0.01, (len(names), len(clusters))), tuple(clusters))
    moves = marker_moves(problem, nodes, parameters, influence)
    for source in (ErrorSource.JOINT_MARKERS, ErrorSource.JOINT_NOMINAL, ErrorSource.SKIN):
        before = influence.parameters[:, [k for k, name in enumerate(clusters) if source_of(name) is source]]
        after = moves.shift[:, [k for k, name in enumerate(moves.others) if name is source]]
        np.testing.assert_allclose(after @ after.T, before @ before.T, rtol=0, atol=1e-12 * before.size)
        assert after.shape[1] <= len(names)
    assert set(moves.own) == {ErrorSource.MOTION}


def test_unknowns_that_nothing_moves_have_no_part() -> None:
    """A whole block of columns of zeros among the sources, as of parameters that are known exactly."""
    rng = np.random.default_rng(54)
    left, right = rng.normal(size=(5, 80)), np.zeros((80, 80))
    right[:10, :10] = rng.normal(size=(10, 10))
    np.testing.assert_allclose(_product_squares(left, right), ((left @ right) ** 2).sum(axis=1))
    np.testing.assert_array_equal(_product_squares(left, np.zeros((80, 80))), 0.0)


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
    fit = JointSearch([problem], model.parameters, free, [start]).run()
    influence = nominal_influence(free)
    wrench = residual_free_wrench(model.parameters, motion)

    moves = marker_moves(problem, fit.nodes[0], fit.parameters, influence)

    def errors() -> tuple[np.ndarray, np.ndarray]:
        torques = torque_errors.torque_standard_errors(problem, fit.nodes[0], fit.parameters, wrench, influence, None)
        return torques.every, coordinate_standard_errors(problem, moves)

    torques, coordinates = errors()
    assert torques.shape == (len(time), len(FORCES))
    assert coordinates.shape == (len(time), len(COORDINATES))
    assert (torques > 0).all() and (coordinates > 0).all()
    for module in (torque_errors, moves_module):
        monkeypatch.setattr(module, "BLOCK", 17)
    for found, whole in zip(errors(), (torques, coordinates), strict=True):
        np.testing.assert_allclose(found, whole, rtol=1e-9)
