"""The vectorised kinematics against Pinocchio, and the published linkage's geometry."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.model.build import build_linkage, build_model
from gaitcal.model.chain import Chain
from gaitcal.model.inertial_parameters import (
    IP_NAMES,
    dynamic_jacobian,
    dynamic_parameters,
    full_set,
    placed_dynamic_parameters,
    symmetric_set,
    table,
)
from gaitcal.model.joint_parameters import JP_INDEX, JP_NAMES, gait_parameters, isolated_parameters
from gaitcal.model.kinematics import forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES, ISOLATED_JOINTS, JOINTS, SEGMENTS, Source
from gaitcal.model.parameters import published_subject
from tests.derivatives import assert_derivative, perturbed_parameters

EXACT = 1e-13
"""m, rad: the same arithmetic in another order."""


def test_counts_are_those_of_the_paper() -> None:
    assert (len(SEGMENTS), len(COORDINATES), len(JP_NAMES), len(IP_NAMES)) == (14, 27, 98, 84)
    assert [len(isolated_parameters(j)) for j in ISOLATED_JOINTS] == [6, 9, 12, 6, 9, 12]
    assert len(gait_parameters("r")) == 17
    assert len(symmetric_set().names) == 36 and len(full_set().names) == 84


def test_every_joint_parameter_enters_exactly_once() -> None:
    used = [e.name for joint in JOINTS for e in joint.elements if e.source is Source.JOINT_PARAMETER]
    assert sorted(used) == sorted(JP_NAMES)


@pytest.mark.parametrize("free", [(), JP_NAMES])
def test_poses_and_jacobian_agree_with_pinocchio(free: tuple[str, ...]) -> None:
    rng = np.random.default_rng(1)
    parameters = perturbed_parameters(rng)
    linkage = build_linkage(parameters, free)
    chain = Chain(free=free)
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    q = rng.normal(0, 0.5, (5, 27))
    poses = forward(chain, constants, q)
    axes, origins = segment_poses(chain, constants, poses)
    columns = jacobian(chain, constants, poses)
    order = [linkage.index(name) for name in (*chain.coordinates, *chain.free)]
    data = linkage.model.createData()
    for f in range(len(q)):
        full = np.zeros(linkage.model.nq)
        full[order] = np.concatenate([q[f], parameters.joint[[JP_INDEX[n] for n in chain.free]]])
        pin.computeJointJacobians(linkage.model, data, full)
        pin.updateFramePlacements(linkage.model, data)
        np.testing.assert_allclose(data.J[:, order], columns[:, :, f].T, atol=EXACT)
        for s, name in enumerate(chain.segments):
            place = data.oMf[linkage.model.getFrameId(name)]
            np.testing.assert_allclose(place.translation, origins[s, :, f], atol=EXACT)
            np.testing.assert_allclose(place.rotation, axes[s, :, :, f].T, atol=EXACT)


def test_built_model_has_the_coordinates_in_order() -> None:
    model = build_model(published_subject())
    assert list(model.names)[1:] == list(COORDINATES)
    assert model.nv == 27


def test_published_subject_stands_as_documented() -> None:
    """Ankle centre 72 mm in front of and 31 mm above the heel, foot turned 6 degrees medially, at zero coordinates."""
    p = published_subject()
    chain = Chain()
    constants = chain.constants(p.joint, p.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, np.zeros((1, 27))))
    at = {name: i for i, name in enumerate(chain.segments)}
    for side, sign in (("r", 1.0), ("l", -1.0)):
        foot, shank = axes[at[f"foot_{side}"], :, :, 0], axes[at[f"shank_{side}"], :, :, 0]
        # the talus angle is printed with three decimals of a degree: 1e-5 rad
        np.testing.assert_allclose(foot[1], shank[1], atol=1e-5)
        turn = np.rad2deg(np.arctan2(foot[0] @ shank[2], foot[0] @ shank[0]))
        np.testing.assert_allclose(turn, -6.0 * sign, atol=1e-3)
        ankle = origins[at[f"talus_{side}"], :, 0] - origins[at[f"foot_{side}"], :, 0]
        # the foot point is printed with 0.01 mm
        np.testing.assert_allclose(foot[:2] @ ankle, [0.072, 0.031], atol=2e-5)


def test_left_is_the_mirror_image_of_right() -> None:
    p = published_subject()
    chain = Chain()
    constants = chain.constants(p.joint, p.zero_angles)
    q = np.zeros((1, 27))
    rng = np.random.default_rng(2)
    legs = rng.normal(0, 0.3, 6)
    q[0, 6:12] = q[0, 12:18] = legs
    arms = rng.normal(0, 0.3, 3)
    q[0, 21:24] = q[0, 24:27] = arms
    _, origins = segment_poses(chain, constants, forward(chain, constants, q))
    at = {name: i for i, name in enumerate(chain.segments)}
    for name in SEGMENTS:
        if name.endswith("_r"):
            right, left = origins[at[name], :, 0], origins[at[name[:-2] + "_l"], :, 0]
            np.testing.assert_allclose(right * [1, 1, -1], left, atol=EXACT)


def test_dynamic_parameters_are_those_of_pinocchio_and_differentiate() -> None:
    inertial = published_subject().inertial
    for row, phi in zip(table(inertial), dynamic_parameters(inertial), strict=True):
        inertia = pin.Inertia(row[0], row[1:4], np.diag(row[4:7]))
        np.testing.assert_allclose(inertia.toDynamicParameters(), phi, atol=1e-15)
    jac = dynamic_jacobian(inertial)
    whole = np.zeros((12, 10, 12, 7))
    for s in range(12):
        whole[s, :, s] = jac[s]
    assert_derivative(whole.reshape(120, 84), lambda x: dynamic_parameters(x), inertial)


def test_moved_dynamic_parameters_are_those_of_the_moved_body() -> None:
    rng = np.random.default_rng(3)
    place = pin.SE3.Random()
    row = table(published_subject().inertial)[1] + rng.normal(0, 1e-3, 7)
    inertia = pin.Inertia(row[0], row[1:4], np.diag(row[4:7]))
    moved = placed_dynamic_parameters(place.rotation, place.translation) @ inertia.toDynamicParameters()
    np.testing.assert_allclose(moved, place.act(inertia).toDynamicParameters(), atol=1e-13)
