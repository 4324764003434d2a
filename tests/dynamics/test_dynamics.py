"""Inverse dynamics: energy and momentum, regressor identities, and finite differences."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.dynamics.derivatives import compute_force_derivatives, compute_root_residual
from gaitcal.dynamics.inverse_dynamics import (
    BLOCK,
    FEET,
    FORCES,
    Dynamics,
    compute_pelvis_residual,
    inverse_dynamics,
)
from gaitcal.dynamics.joint_kinetics import HELD
from gaitcal.model.chain import build_linkage
from gaitcal.model.linkage import COORDINATES, LOWER_BODY
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    JP_INDEX,
    compute_dynamic_parameters,
    list_gait_parameters,
    list_leg_parameters,
)
from gaitcal.synthetic.synthetic_motion import simulate_gait
from gaitcal.tracking.motion import MarkerErrors, Motion
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_state

RNG = np.random.default_rng(12)
FORCE = 1e-9
"""N, N·m: rounding of sums of a few thousand N at lever arms of metres."""
STEP_S = 1e-4
"""Step of central differences in time."""


def test_power_of_all_forces_is_the_rate_of_energy() -> None:
    """Generalised forces and ground reactions work on the body; reactions are locked, and
    do none.
    """
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, 6)
    dynamics = Dynamics(parameters)
    tau, placed = dynamics.compute_forces(q, v, a, wrench), dynamics.place(q)
    body = build_linkage(parameters)
    data = body.model.createData()
    for f in range(len(q)):
        before, after = (
            pin.computeMechanicalEnergy(
                body.model, data, q[f] + t * v[f] + 0.5 * t * t * a[f], v[f] + t * a[f]
            )
            for t in (-STEP_S, STEP_S)
        )
        moving = range(len(COORDINATES))
        ground = sum(
            float(
                v[f]
                @ (placed.moves(foot)[moving] * (placed.columns_by_frame[f, moving] @ wrench[f, k]))
            )
            for k, foot in enumerate(FEET)
        )
        power = float(tau[f, : len(COORDINATES)] @ v[f])
        assert power + ground == pytest.approx((after - before) / (2 * STEP_S), rel=1e-6, abs=1e-3)


def test_ground_reactions_act_as_external_forces_on_the_feet() -> None:
    """What `pin.rnea` makes of wrenches in the axes of the feet's joints is -J^T w, held parameters
    included.
    """
    dynamics = Dynamics(perturbed_parameters(RNG), HELD)
    q, v, a, wrench = random_state(RNG, 4)
    made = dynamics.compute_forces(q, v, a, wrench) - dynamics.compute_forces(q, v, a)
    np.testing.assert_allclose(
        made,
        dynamics.compute_ground_forces(dynamics.place(q), wrench[..., None])[..., 0],
        atol=FORCE,
    )


def test_a_part_of_the_body_has_the_forces_that_it_has_in_the_whole() -> None:
    """Nothing above the hips changes a leg's torques; frames are worked on in blocks."""
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, BLOCK + 3)
    legs, whole = Dynamics(parameters, segments=LOWER_BODY), Dynamics(parameters)
    names = [name for name in legs.forces_of if not name.startswith("pelvis")]
    found = legs.compute_forces(q, v, a, wrench)[:, [legs.forces_of.index(name) for name in names]]
    expected = whole.compute_forces(q, v, a, wrench)[
        :, [whole.forces_of.index(name) for name in names]
    ]
    np.testing.assert_allclose(found, expected, atol=FORCE)


def test_the_residual_force_needs_no_place_of_the_ground_reactions() -> None:
    dynamics, at = Dynamics(perturbed_parameters(RNG)), random_state(RNG, 4)
    expected = compute_pelvis_residual(at[0], dynamics.compute_forces(*at))[:, :3]
    np.testing.assert_allclose(dynamics.compute_residual_force(*at), expected, atol=FORCE)


def test_residual_is_the_wrench_that_the_whole_body_needs() -> None:
    """Against the rate of change of momentum about the pelvis origin, laboratory axes."""
    parameters = perturbed_parameters(RNG)
    q, v, a, _ = random_state(RNG, 5)
    residual = compute_pelvis_residual(
        q, Dynamics(parameters).compute_forces(q, v, a, np.zeros((5, 2, 6)))
    )
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
    dynamics = Dynamics(parameters, HELD)
    forces, phi = (
        dynamics.compute_forces(q, v, a, np.zeros((5, 2, 6))),
        compute_dynamic_parameters(parameters.inertial),
    )
    every = np.einsum("fisk,sk->fi", dynamics.compute_regressor(q, v, a), phi)
    np.testing.assert_allclose(every, forces, atol=FORCE)
    root = np.einsum("fisk,sk->fi", dynamics.compute_root_regressor(q, v, a), phi)
    np.testing.assert_allclose(root, compute_pelvis_residual(q, forces), atol=FORCE)


def test_force_derivatives_by_finite_differences() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, 1)
    free = (
        *list_leg_parameters("l"),
        *list_gait_parameters("r"),
        "back.trunk.sup",
        "elbow_r.forearm.front",
    )
    found = compute_force_derivatives(parameters, free, q, v, a, wrench, HELD)
    dynamics = Dynamics(parameters, HELD)
    assert_derivative(
        found.by_position[0], lambda x: dynamics.compute_forces(x[None], v, a, wrench)[0], q[0]
    )
    assert_derivative(
        found.by_velocity[0], lambda x: dynamics.compute_forces(q, x[None], a, wrench)[0], v[0]
    )
    assert_derivative(
        found.by_acceleration[0], lambda x: dynamics.compute_forces(q, v, x[None], wrench)[0], a[0]
    )
    names = found.free
    start = parameters.joint[[JP_INDEX[name] for name in names]]
    assert_derivative(
        found.by_parameter[0],
        lambda x: Dynamics(parameters.with_joint(names, x), HELD).compute_forces(q, v, a, wrench)[
            0
        ],
        start,
    )


def test_moments_are_the_forces_by_name() -> None:
    """Of the model's own parameters, not its nominal ones; figures over valid frames alone, by
    hand.
    """
    true = simulate_gait()
    model = replace(published_model(), parameters=perturbed_parameters(RNG))
    nf = len(true.basis.time)
    errors = MarkerErrors((), (), np.empty(0), np.empty((nf, 0)))
    shape = {"basis": true.basis, "coefficients": true.coefficients, "errors": errors}
    motion = Motion(name="walk", coordinates=COORDINATES, converged=True, **shape)
    wrench = RNG.normal(0, 300, (nf, 2, 6))
    forces = Dynamics(model.parameters).compute_forces(
        motion.q, motion.velocity, motion.acceleration, wrench
    )
    moments = inverse_dynamics(model, motion, wrench)
    np.testing.assert_array_equal(np.hstack([moments.tau, moments.knee_adduction]), forces)
    assert (*moments.coordinates, "knee_adduction_r", "knee_adduction_l") == FORCES
    residual = np.hstack([moments.residual_force, moments.residual_moment])
    np.testing.assert_allclose(residual, compute_pelvis_residual(motion.q, forces), atol=FORCE)
    assert moments.bwh == pytest.approx(model.subject.mass * 9.81 * model.subject.height, rel=1e-12)
    some = replace(
        moments,
        residual_force=np.array([[3.0, 0, 0], [90, 9, 9]]),
        residual_moment=np.full((2, 3), 2.0),
    )
    assert some.residual_rms(np.array([True, False])) == pytest.approx(
        (np.sqrt(3.0), 2.0), rel=1e-12
    )


def test_pelvis_residual_derivatives_by_finite_differences() -> None:
    parameters = perturbed_parameters(RNG)
    q, v, a, wrench = random_state(RNG, 1)
    free = list_gait_parameters("r")
    found = compute_root_residual(parameters, free, q, v, a, wrench)

    def value(q: Array, v: Array, a: Array, p: Array) -> Array:
        return compute_pelvis_residual(
            q, Dynamics(parameters.with_joint(found.free, p)).compute_forces(q, v, a, wrench)
        )[0]

    p = parameters.joint[[JP_INDEX[name] for name in found.free]]
    np.testing.assert_allclose(found.value[0], value(q, v, a, p), atol=FORCE)
    assert_derivative(found.by_position[0], lambda x: value(x[None], v, a, p), q[0])
    assert_derivative(found.by_velocity[0], lambda x: value(q, x[None], a, p), v[0])
    assert_derivative(found.by_acceleration[0], lambda x: value(q, v, x[None], p), a[0])
    assert_derivative(found.by_parameter[0], lambda x: value(q, v, a, x), p)
