"""Inverse dynamics: against Pinocchio with external forces, regressor identities, and finite differences."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.dynamics.derivatives import FRAMES_AT_ONCE, force_derivatives, root_residual
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics, inverse_dynamics, pelvis_residual
from gaitcal.dynamics.joint_kinetics import HELD
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_INDEX, JP_NAMES, dynamic_parameters, gait_parameters, leg_parameters
from gaitcal.model.subject_model import build_linkage
from gaitcal.motion.motion import MarkerErrors, Motion
from gaitcal.synthetic.motion import gait_motion
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_state

RNG = np.random.default_rng(12)
FORCE = 1e-9
"""N, N·m: rounding of sums of a few thousand N at lever arms of metres."""


def test_forces_agree_with_pinocchio_with_external_forces() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, 6)
    forces = Dynamics(parameters).forces(q, v, a, wrench)
    linkage = build_linkage(parameters)
    data = linkage.model.createData()
    for f in range(len(q)):
        pin.forwardKinematics(linkage.model, data, q[f])
        external = [pin.Force.Zero() for _ in range(linkage.model.njoints)]
        for k, foot in enumerate(FEET):
            joint = linkage.segment_joint[foot]
            external[joint] = data.oMi[joint].actInv(pin.Force(wrench[f, k]))
        tau = pin.rnea(linkage.model, data, q[f], v[f], a[f], external)
        np.testing.assert_allclose(forces[f, : len(COORDINATES)], tau, atol=FORCE)


def test_the_residual_force_needs_no_place_of_the_ground_reactions() -> None:
    dynamics, at = Dynamics(perturbed_parameters(RNG)), random_state(RNG, 4)
    expected = pelvis_residual(at[0], dynamics.forces(*at))[:, :3]
    np.testing.assert_allclose(dynamics.residual_force(*at), expected, atol=FORCE)


def test_residual_is_the_wrench_that_the_whole_body_needs() -> None:
    """Against the rate of change of momentum about the pelvis origin, laboratory axes."""
    parameters = perturbed_parameters(RNG)
    q, v, a, _ = random_state(RNG, 5)
    residual = pelvis_residual(q, Dynamics(parameters).forces(q, v, a, np.zeros((5, 2, 6))))
    linkage = build_linkage(parameters)
    data = linkage.model.createData()
    weight = parameters.mass * 9.81
    for f in range(5):
        pin.computeCentroidalMomentumTimeVariation(linkage.model, data, q[f], v[f], a[f])
        centre = pin.centerOfMass(linkage.model, data, q[f])
        force = data.dhg.linear + [0.0, weight, 0.0]
        moment = data.dhg.angular + np.cross(centre - q[f, :3], force)
        np.testing.assert_allclose(residual[f, :3], force, atol=FORCE)
        np.testing.assert_allclose(residual[f, 3:], moment, atol=FORCE)


def test_regressors_times_parameters_are_forces_and_residual() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, _ = random_state(RNG, 5)
    dynamics = Dynamics(parameters)
    forces, phi = dynamics.forces(q, v, a, np.zeros((5, 2, 6))), dynamic_parameters(parameters.inertial)
    every = np.einsum("fisk,sk->fi", dynamics.regressor(q, v, a), phi)
    np.testing.assert_allclose(every, forces, atol=FORCE)
    root = np.einsum("fisk,sk->fi", dynamics.root_regressor(q, v, a), phi)
    np.testing.assert_allclose(root, pelvis_residual(q, forces), atol=FORCE)


def test_force_derivatives_by_finite_differences() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, 1)
    free = (*leg_parameters("l"), *gait_parameters("r"), "back.trunk.sup", "elbow_r.forearm.front")
    found = force_derivatives(parameters, free, q, v, a, wrench)
    dynamics = Dynamics(parameters)
    assert_derivative(found.by_position[0], lambda x: dynamics.forces(x[None], v, a, wrench)[0], q[0])
    assert_derivative(found.by_velocity[0], lambda x: dynamics.forces(q, x[None], a, wrench)[0], v[0])
    assert_derivative(found.by_acceleration[0], lambda x: dynamics.forces(q, v, x[None], wrench)[0], a[0])
    names = found.free
    start = parameters.joint[[JP_INDEX[name] for name in names]]
    assert_derivative(
        found.by_parameter[0], lambda x: Dynamics(parameters.with_joint(names, x)).forces(q, v, a, wrench)[0], start
    )


def test_force_derivatives_are_those_of_pinocchio() -> None:
    """All joint parameters free, more frames than are worked on together, no ground reaction."""
    parameters = perturbed_parameters(RNG)
    q, v, a, _ = random_state(RNG, FRAMES_AT_ONCE + 3)
    found = force_derivatives(parameters, JP_NAMES, q, v, a, np.zeros((len(q), 2, 6)), HELD)
    linkage = build_linkage(parameters, JP_NAMES, reactions=True)
    index = [[linkage.index(name) for name in names] for names in ((*FORCES, *HELD), COORDINATES, found.free)]
    rows, moving, held = (np.array(places) for places in index)
    data = linkage.model.createData()
    for f in (0, FRAMES_AT_ONCE - 1, len(q) - 1):
        full = np.zeros((3, linkage.model.nv))
        for k, values in enumerate((q, v, a)):
            full[k][moving] = values[f]
        full[0][held] = parameters.joint[[JP_INDEX[name] for name in found.free]]
        dq, dv, da = pin.computeRNEADerivatives(linkage.model, data, *full)
        da = np.triu(da) + np.triu(da, 1).T
        wanted = (dq[np.ix_(rows, moving)], dv[np.ix_(rows, moving)], da[np.ix_(rows, moving)], dq[np.ix_(rows, held)])
        told = (found.by_position, found.by_velocity, found.by_acceleration, found.by_parameter)
        for own, other in zip(told, wanted, strict=True):
            np.testing.assert_allclose(own[f], other, atol=1e-12 * np.abs(other).max())


def test_moments_are_the_forces_by_name() -> None:
    """Of the model's own parameters, not its nominal ones; figures over valid frames alone, by hand."""
    true = gait_motion()
    model = replace(published_model(), parameters=perturbed_parameters(RNG))
    nf = len(true.basis.time)
    errors = MarkerErrors((), (), np.empty(0), np.empty((nf, 0)))
    shape = {"basis": true.basis, "coefficients": true.coefficients, "errors": errors}
    motion = Motion(name="walk", coordinates=COORDINATES, converged=True, **shape)
    wrench = RNG.normal(0, 300, (nf, 2, 6))
    forces = Dynamics(model.parameters).forces(motion.q, motion.velocity, motion.acceleration, wrench)
    moments = inverse_dynamics(model, motion, wrench)
    np.testing.assert_array_equal(np.hstack([moments.tau, moments.knee_adduction]), forces)
    assert (*moments.coordinates, "knee_adduction_r", "knee_adduction_l") == FORCES
    residual = np.hstack([moments.residual_force, moments.residual_moment])
    np.testing.assert_allclose(residual, pelvis_residual(motion.q, forces), atol=FORCE)
    assert moments.bwh == pytest.approx(model.subject.mass * 9.81 * model.subject.height, rel=1e-12)
    some = replace(moments, residual_force=np.array([[3.0, 0, 0], [90, 9, 9]]), residual_moment=np.full((2, 3), 2.0))
    assert some.residual_rms(np.array([True, False])) == pytest.approx((np.sqrt(3.0), 2.0), rel=1e-12)


def test_pelvis_residual_derivatives_by_finite_differences() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, 1)
    free = gait_parameters("r")
    found = root_residual(parameters, free, q, v, a, wrench)

    def value(q: Array, v: Array, a: Array, p: Array) -> Array:
        return pelvis_residual(q, Dynamics(parameters.with_joint(found.free, p)).forces(q, v, a, wrench))[0]

    p = parameters.joint[[JP_INDEX[name] for name in found.free]]
    np.testing.assert_allclose(found.value[0], value(q, v, a, p), atol=FORCE)
    assert_derivative(found.by_position[0], lambda x: value(x[None], v, a, p), q[0])
    assert_derivative(found.by_velocity[0], lambda x: value(q, x[None], a, p), v[0])
    assert_derivative(found.by_acceleration[0], lambda x: value(q, v, x[None], p), a[0])
    assert_derivative(found.by_parameter[0], lambda x: value(q, v, a, x), p)
