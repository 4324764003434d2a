"""Torques of the legs: against the whole body's inverse dynamics, and wrenches carried with the feet."""

from __future__ import annotations

import numpy as np

from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import IP_NAMES, Parameters
from gaitcal.published.draw import LEG_TORQUES, FootPose, LegTorques, MonteCarloContext, carry
from tests.derivatives import Array, perturbed_parameters

TORQUE = 1e-9
"""N·m: rounding of sums of a few thousand N at lever arms of metres."""


def whole_body(context: MonteCarloContext, parameters: Parameters, nodes: Array) -> Array:
    q, v, a = (context.basis.evaluate(nodes, k) for k in range(3))
    forces = Dynamics(parameters).forces(q, v, a, context.case.wrench)
    return forces[:, [FORCES.index(name) for name in LEG_TORQUES]]


def test_a_disturbed_model_has_the_torques_of_a_model_built_anew(context: MonteCarloContext) -> None:
    rng = np.random.default_rng(6)
    legs = LegTorques(context.case.parameters)
    for _ in range(3):  # one after the other in the same instance: nothing of one is left in the next
        parameters = perturbed_parameters(rng)
        parameters = parameters.with_inertial(parameters.inertial * rng.uniform(0.8, 1.2, len(IP_NAMES)))
        nodes = context.case.nodes + rng.normal(0, 0.02, context.case.nodes.shape)
        constants = legs.disturb(parameters)
        laboratory, _ = legs.torques(constants, context.basis, nodes, context.case.wrench, context.feet)
        np.testing.assert_allclose(laboratory, whole_body(context, parameters, nodes), rtol=0, atol=TORQUE)


def test_both_frames_agree_where_nothing_is_disturbed(context: MonteCarloContext) -> None:
    case = context.case
    constants = context.legs.disturb(case.parameters)
    laboratory, carried = context.legs.torques(constants, context.basis, case.nodes, case.wrench, context.feet)
    np.testing.assert_array_equal(laboratory, context.torques)
    np.testing.assert_allclose(carried, laboratory, rtol=0, atol=TORQUE)


def test_a_carried_wrench_is_constant_in_the_foot() -> None:
    rng = np.random.default_rng(7)

    def pose() -> FootPose:
        turns = np.linalg.qr(rng.normal(size=(2, 5, 3, 3)))[0]
        return FootPose(turns.transpose(0, 3, 2, 1), rng.normal(size=(2, 3, 5)))

    def in_foot(wrench: Array, at: FootPose) -> Array:
        force = wrench[:, :3]
        moment = wrench[:, 3:] - np.cross(at.origin, force, axis=1)
        return np.concatenate([np.einsum("sjif,sif->sjf", at.axes, part) for part in (force, moment)], axis=1)

    wrench, before, after = rng.normal(size=(2, 6, 5)), pose(), pose()
    np.testing.assert_allclose(in_foot(carry(wrench, before, after), after), in_foot(wrench, before), atol=1e-12)


def test_moving_the_whole_person_matters_to_wrenches_of_the_laboratory_only(context: MonteCarloContext) -> None:
    """10 mm forward with the person: carried wrenches come along, so that no torque changes."""
    case = context.case
    nodes = case.nodes.copy()
    nodes[:, COORDINATES.index("pelvis_tx")] += 0.010
    constants = context.legs.disturb(case.parameters)
    laboratory, carried = context.legs.torques(constants, context.basis, nodes, case.wrench, context.feet)
    np.testing.assert_allclose(carried, context.torques, rtol=0, atol=TORQUE)
    flexion = LEG_TORQUES.index("hip_flexion_l")
    assert np.abs(laboratory - context.torques)[:, flexion].max() > 0.009 * np.abs(case.wrench[:, 1, 1]).max()
