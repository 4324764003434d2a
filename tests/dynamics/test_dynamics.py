"""Inverse dynamics: against Pinocchio with external forces, regressor identities, and finite differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from gaitcal.dynamics.derivatives import force_derivatives
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, GeneralisedForces
from gaitcal.dynamics.root_residual import root_residual
from gaitcal.model.build import build_linkage
from gaitcal.model.inertial_parameters import dynamic_parameters
from gaitcal.model.joint_parameters import JP_INDEX, gait_parameters, leg_parameters
from gaitcal.synthetic.measurements import residual_free_wrench
from gaitcal.synthetic.motion import gait_motion
from tests.derivatives import Array, assert_derivative, perturbed_parameters

RNG = np.random.default_rng(12)
FORCE = 1e-9
"""N, N·m: rounding of sums of a few thousand N at lever arms of metres."""


def state(frames: int) -> tuple[Array, Array, Array, Array]:
    q, v, a = (RNG.normal(0, scale, (frames, 27)) for scale in (0.4, 2.0, 9.0))
    return q, v, a, RNG.normal(0, 300, (frames, 2, 6))


def test_forces_agree_with_pinocchio_with_external_forces() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = state(6)
    found = Dynamics(parameters).forces(q, v, a, wrench)
    linkage = build_linkage(parameters)
    data = linkage.model.createData()
    for f in range(len(q)):
        pin.forwardKinematics(linkage.model, data, q[f])
        external = [pin.Force.Zero() for _ in range(linkage.model.njoints)]
        for k, foot in enumerate(FEET):
            joint = linkage.segment_joint[foot]
            external[joint] = data.oMi[joint].actInv(pin.Force(wrench[f, k]))
        tau = pin.rnea(linkage.model, data, q[f], v[f], a[f], external)
        np.testing.assert_allclose(found.tau[f], tau, atol=FORCE)
    np.testing.assert_allclose(found.residual_force, found.tau[:, :3], atol=FORCE)


def test_residual_is_the_wrench_that_the_whole_body_needs() -> None:
    """Against the rate of change of momentum about the pelvis origin, laboratory axes."""
    parameters = perturbed_parameters(RNG)
    q, v, a, _ = state(5)
    found = Dynamics(parameters).forces(q, v, a, np.zeros((5, 2, 6)))
    linkage = build_linkage(parameters)
    data = linkage.model.createData()
    weight = parameters.mass * 9.81
    for f in range(5):
        pin.computeCentroidalMomentumTimeVariation(linkage.model, data, q[f], v[f], a[f])
        centre = pin.centerOfMass(linkage.model, data, q[f])
        force = data.dhg.linear + [0.0, weight, 0.0]
        moment = data.dhg.angular + np.cross(centre - q[f, :3], force)
        np.testing.assert_allclose(found.residual_force[f], force, atol=FORCE)
        np.testing.assert_allclose(found.residual_moment[f], moment, atol=FORCE)


def test_regressor_times_parameters_is_the_residual() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, _ = state(5)
    dynamics = Dynamics(parameters)
    forces = dynamics.forces(q, v, a, np.zeros((5, 2, 6)))
    wrench = np.einsum("fisk,sk->fi", dynamics.root_regressor(q, v, a), dynamic_parameters(parameters.inertial))
    np.testing.assert_allclose(wrench[:, :3], forces.residual_force, atol=FORCE)
    np.testing.assert_allclose(wrench[:, 3:], forces.residual_moment, atol=FORCE)


def test_knee_reaction_is_the_moment_on_the_shank_about_the_knee_axis() -> None:
    """The ground's part by virtual work: how far the foot moves in a small turn of the reaction joint."""
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = state(4)
    found = Dynamics(parameters).forces(q, v, a, wrench)
    h = 1e-6
    linkage = build_linkage(parameters, reactions=True)
    data = linkage.model.createData()
    at = [linkage.index(name) for name in ("knee_adduction_r", "knee_adduction_l")]
    order = [linkage.index(name) for name in linkage.coordinates if not name.startswith("knee_adduction")]
    for f in range(4):
        full = np.zeros((3, 29))
        full[:, order] = q[f], v[f], a[f]
        tau = pin.rnea(linkage.model, data, *full)
        for k, row in enumerate(at):  # virtual work of the wrench in a small turn of the reaction joint
            work = 0.0
            for sign in (1, -1):
                turned = full[0].copy()
                turned[row] += sign * h
                pin.framesForwardKinematics(linkage.model, data, turned)
                foot = data.oMf[linkage.model.getFrameId(FEET[k])]
                work += sign * float(wrench[f, k] @ pin.log6(foot * _home(linkage, full[0], FEET[k])).vector) / (2 * h)
            np.testing.assert_allclose(found.knee_adduction[f, k], tau[row] - work, rtol=1e-5, atol=1e-4)


def _home(linkage: object, q: Array, frame: str) -> pin.SE3:
    model = linkage.model  # type: ignore[attr-defined]
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame)].inverse()


def flat(forces: GeneralisedForces) -> Array:
    return np.hstack([forces.tau, forces.knee_adduction]).ravel()


def test_force_derivatives_by_finite_differences() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = state(1)
    free = (*leg_parameters("l"), *gait_parameters("r"), "back.trunk.sup", "elbow_r.forearm.front")
    found = force_derivatives(parameters, free, q, v, a, wrench)
    dynamics = Dynamics(parameters)
    assert_derivative(found.by_position[0], lambda x: flat(dynamics.forces(x[None], v, a, wrench)), q[0])
    assert_derivative(found.by_velocity[0], lambda x: flat(dynamics.forces(q, x[None], a, wrench)), v[0])
    assert_derivative(found.by_acceleration[0], lambda x: flat(dynamics.forces(q, v, x[None], wrench)), a[0])
    names = found.free
    start = parameters.joint[[JP_INDEX[name] for name in names]]
    assert_derivative(
        found.by_parameter[0],
        lambda x: flat(Dynamics(parameters.with_joint(names, x)).forces(q, v, a, wrench)),
        start,
    )


def test_synthetic_ground_reactions_leave_no_residual_and_carry_the_body() -> None:
    parameters = perturbed_parameters(RNG)
    motion = gait_motion()
    wrench = residual_free_wrench(parameters, motion)
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    forces = Dynamics(parameters).forces(q, v, a, wrench)
    assert np.abs(forces.residual_force).max() < FORCE
    assert np.abs(forces.residual_moment).max() < FORCE
    vertical = wrench[:, :, 1].sum(axis=1) / (parameters.mass * 9.81)
    assert 0.99 < vertical.mean() < 1.01
    assert vertical.min() > 0.6
    assert vertical.max() < 1.4


def test_pelvis_residual_derivatives_by_finite_differences() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = state(1)
    free = gait_parameters("r")
    found = root_residual(parameters, free, q, v, a, wrench)

    def value(q: Array, v: Array, a: Array, p: Array) -> Array:
        forces = Dynamics(parameters.with_joint(found.free, p)).forces(q, v, a, wrench)
        return np.hstack([forces.residual_force, forces.residual_moment]).ravel()

    p = parameters.joint[[JP_INDEX[name] for name in found.free]]
    np.testing.assert_allclose(found.value.ravel(), value(q, v, a, p), atol=FORCE)
    assert_derivative(found.by_position[0], lambda x: value(x[None], v, a, p), q[0])
    assert_derivative(found.by_velocity[0], lambda x: value(q, x[None], a, p), v[0])
    assert_derivative(found.by_acceleration[0], lambda x: value(q, v, x[None], p), a[0])
    assert_derivative(found.by_parameter[0], lambda x: value(q, v, a, x), p)
