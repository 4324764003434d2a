"""Standard errors of powers and moment vectors: sums of squares of finite differences; with axes, of what stays put."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.calibration import torque_errors
from gaitcal.calibration.error_sources import ErrorSources, MotionSensitivity, nominal_errors
from gaitcal.calibration.torque_errors import ErringForces
from gaitcal.dynamics.axis_errors import AxisErrors, ErrorSource, TorqueErrors
from gaitcal.dynamics.inverse_dynamics import FORCES
from gaitcal.dynamics.joint_kinetics import COMPONENTS, POWERS, VECTOR_FRAMES, MomentFrame, kinetic_values, power_of
from gaitcal.dynamics.plate_errors import PlateErrors
from gaitcal.model.parameters import IP_NAMES, JP_INDEX, gait_parameters
from tests.calibration.test_torque_errors import plate_changes
from tests.derivatives import Array, perturbed_parameters, random_trial

DIFFERENCES = 1e-5
"""Relative to the largest error: what central differences can tell."""
STEP = 1e-4
"""Of one standard deviation."""
UNMOVED = 0.05
"""Of what axes do to the power of one coordinate: rates are told from frames 10 ms apart."""
FREE = gait_parameters("r")
FRAMES, NODES = 10, 6


def assert_errors(found: TorqueErrors, changes: Array) -> None:
    """`changes` (sources, nf, 28 + 63): what each source makes of powers and vectors."""
    assert found.kinetics is not None
    dense = np.sqrt((changes**2).sum(axis=0))
    split = len(POWERS)
    for errors, expected in (
        (found.kinetics.power, dense[:, :split]),
        (found.kinetics.moment.reshape(len(dense), -1), dense[:, split:]),
    ):
        np.testing.assert_allclose(errors, expected, rtol=0, atol=DIFFERENCES * expected.max())


def test_kinetic_errors_are_what_every_source_moves_by_itself() -> None:
    """Torque and rate of a source move together: the errors of a power are not those of its factors."""
    rng = np.random.default_rng(51)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, frames=FRAMES, nodes=NODES)
    wrench = rng.normal(0, 300, (FRAMES, 2, 6))
    free = problem.with_free(FREE).chain.free
    own, others = 3, 2
    moves = MotionSensitivity(
        shift=rng.normal(0, 0.005, (len(free), others)),
        nodes=rng.normal(0, 0.01, (nodes.size, own)),
        sensitivity=rng.normal(0, 1.0, (nodes.size, len(free))),
        own=(ErrorSource.MOTION,) * own,
        others=(ErrorSource.JOINT_MARKERS, ErrorSource.SKIN),
    )
    spread = 0.1 * parameters.inertial[:, None] * rng.normal(size=(len(IP_NAMES), 2))
    start = parameters.joint[[JP_INDEX[name] for name in free]]
    plates = PlateErrors(place=0.003, gain=0.01, clock=0.002)
    rates = np.gradient(wrench, problem.basis.time, axis=0)

    def told(by_nodes: Array, by_joint: Array, by_inertial: Array, by_wrench: Array) -> Array:
        def values(step: float) -> Array:
            moved = parameters.with_joint(free, start + step * by_joint)
            moved = moved.with_inertial(parameters.inertial + step * by_inertial)
            state = (problem.basis.evaluate(nodes + step * by_nodes, k) for k in range(3))
            power, moment = kinetic_values(moved, *state, wrench + step * by_wrench)
            return np.hstack([power, moment.reshape(FRAMES, -1)])

        return (values(STEP) - values(-STEP)) / (2 * STEP)

    still, fixed, rigid, measured = (
        np.zeros_like(nodes),
        np.zeros(len(free)),
        np.zeros(len(IP_NAMES)),
        np.zeros_like(wrench),
    )
    changes = [told(column.reshape(nodes.shape), fixed, rigid, measured) for column in moves.nodes.T]
    for shift in moves.shift.T:
        changes.append(told(-(moves.sensitivity @ shift).reshape(nodes.shape), shift, rigid, measured))
    changes += [told(still, fixed, column, measured) for column in spread.T]
    changes += [told(still, fixed, rigid, other) for other in plate_changes(wrench, rates)]
    influence = ErrorSources(free, moves.shift, tuple(f"source {k}" for k in range(others)))
    found = ErringForces(problem, nodes, parameters, wrench, influence, spread, moves, plates).errors()
    assert_errors(found, np.array(changes))
    assert found.kinetics is not None and found.kinetics.own is not None
    own_part = np.sqrt((np.array(changes[:own]) ** 2).sum(axis=0))[:, : len(POWERS)]
    np.testing.assert_allclose(found.kinetics.own.power, own_part, rtol=0, atol=DIFFERENCES * own_part.max())


def test_directions_of_axes_move_components_but_not_what_a_whole_joint_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hips and back: power is moment times angular velocity, whatever the axes; their torques' errors are those of the
    vector along the joint's axes. A hinge stays where it is. Blocks of frames change nothing.
    """
    rng = np.random.default_rng(53)
    parameters = perturbed_parameters(rng)
    problem, nodes = random_trial(rng, parameters, frames=80, nodes=9)
    wrench, known, axes = rng.normal(0, 300, (80, 2, 6)), nominal_errors(FREE), AxisErrors(parameters)
    exact, turned = (
        ErringForces(problem, nodes, parameters, wrench, known, None, axes=a).errors() for a in (None, axes)
    )
    assert exact.kinetics is not None and turned.kinetics is not None
    inner = slice(2, -2)  # rates of the moves are differences between frames, one-sided at the ends

    def added(name: str) -> float:
        before, after = (power_of(errors, name)[inner] ** 2 for errors in (exact.kinetics, turned.kinetics) if errors)
        return float(np.sqrt(np.mean(after - before)))

    for joint, coordinate in (("hip_r", "hip_rotation_r"), ("hip_l", "hip_adduction_l"), ("lumbar", "lumbar_bending")):
        assert added(joint) < UNMOVED * added(coordinate), joint
    for hinge in ("knee_l", "ankle_r", "elbow_r"):
        assert added(hinge) < UNMOVED * added("hip_rotation_r"), hinge
    jcs = turned.kinetics.moment[:, VECTOR_FRAMES.index(MomentFrame.JCS)]
    for k, name in enumerate(COMPONENTS):
        if name.startswith(("hip", "lumbar")):
            np.testing.assert_allclose(jcs[:, k], turned.every[:, FORCES.index(name)], rtol=1e-7, err_msg=name)
    monkeypatch.setattr(torque_errors, "BLOCK", 7)
    in_parts = ErringForces(problem, nodes, parameters, wrench, known, None, axes=axes).errors().kinetics
    assert in_parts is not None
    np.testing.assert_allclose(in_parts.power, turned.kinetics.power, rtol=1e-9)
    np.testing.assert_allclose(in_parts.moment, turned.kinetics.moment, rtol=1e-9)
