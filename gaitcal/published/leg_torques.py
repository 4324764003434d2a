"""The torques of each leg, for disturbed parameters and motions, with the ground reaction in either frame.

    tau_k = RNEA_k(q, v, a) - J_k . w,

w the wrench of the ground on the foot, J_k the joint's spatial velocity, both about the laboratory origin
(`dynamics/inverse_dynamics.py`). Fixed in the laboratory w stays as it was measured; carried along with the foot it
turns and moves as the foot frame did, by (R, o) from the undisturbed (R0, o0) at the same instant:

    force' = R R0^T force,      moment' = R R0^T (moment - o0 x force) + o x force'.

The Pinocchio model is built once. A disturbance changes joint placements and inertias in place: the chain's constant
C_k, told between the joint frames of the model, which make a half turn where a coordinate turns about a negative
axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET, unloaded_forces, with_reactions
from gaitcal.model.chain import Chain, ChainConstants, Poses, forward, jacobian, segment_poses
from gaitcal.model.coordinates import COORDINATE_TABLE, LEG_COORDINATES
from gaitcal.model.linkage import COORDINATES, LOWER_BODY, SIDES, joint_elements, joints_above
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, table
from gaitcal.model.subject_model import build_linkage
from gaitcal.motion.spline import SplineBasis

TORQUES = LEG_COORDINATES
"""The torques of a leg, without the side; the knee's adduction is a reaction."""
TORQUE_WORDS = {name: COORDINATE_TABLE[name].title[:1].lower() + COORDINATE_TABLE[name].title[1:] for name in TORQUES}
LEG_TORQUES: tuple[str, ...] = tuple(f"{name}_{side}" for side in SIDES for name in TORQUES)
"""Both legs: the order of every axis of torques."""
OF_FOOT = tuple(
    np.array([k for k, name in enumerate(LEG_TORQUES) if name in carrying])
    for carrying in ({e.name for j in joints_above(foot) for e in joint_elements(j, reactions=True)} for foot in FEET)
)
"""Which of them the wrench on the right foot changes, and which the wrench on the left."""
LEG_SEGMENTS: tuple[str, ...] = LOWER_BODY[1:]


@dataclass(frozen=True)
class FootPose:
    """Poses of both feet."""

    axes: Array
    """(2, 3, 3, nf): axes[s, j] is the j-th unit axis of foot s in the laboratory."""
    origin: Array
    """(2, 3, nf) m."""


class LegTorques:
    """Inverse dynamics of both legs. Holds a Pinocchio model that it changes: one instance for one thread."""

    def __init__(self, parameters: Parameters) -> None:
        self.linkage = build_linkage(parameters, reactions=True)
        self._data = self.linkage.model.createData()
        self._chain = Chain("pelvis", ("pelvis", *LEG_SEGMENTS), reactions=True)
        coordinates = self._chain.coordinates
        self._joint = [self.linkage.model.getJointId(name) for name in coordinates]
        self._half_turn = [
            pin.SE3(np.eye(3) if e.sign > 0 else _half_turn(e.axis), np.zeros(3)) for e in self._chain.elements
        ]
        self.rows = np.array([self.linkage.index(name) for name in LEG_TORQUES])
        """Places of the torques among the coordinates of the linkage."""
        self._moved = np.array([coordinates.index(name) for name in LEG_TORQUES])
        self._foot = [self._chain.segments.index(foot) for foot in FEET]
        free = [name for name in coordinates if name in COORDINATES]  # all but the locked reaction joints
        self._of_chain = [coordinates.index(name) for name in free]
        self._of_body = [COORDINATES.index(name) for name in free]

    def disturb(self, parameters: Parameters) -> ChainConstants:
        """Put other parameters of the legs into the model; returns the constants of its chain."""
        constants = self._chain.constants(parameters.joint, parameters.zero_angles)
        placements, inertias = self.linkage.model.jointPlacements, self.linkage.model.inertias
        turns = self._half_turn
        for k, parent in enumerate(self._chain.parents):
            offset = pin.SE3(constants.offset_rotation[k], constants.offset_translation[k]) * turns[k]
            placements[self._joint[k]] = offset if parent < 0 else turns[parent].actInv(offset)
        for segment, row in zip(MASSIVE_SEGMENTS, table(parameters.inertial), strict=True):
            if segment not in LEG_SEGMENTS:
                continue
            s = self._chain.segments.index(segment)
            frame = int(self._chain.segment_frame[s])
            place = turns[frame].actInv(pin.SE3(constants.segment_rotation[s], constants.segment_translation[s]))
            inertia = pin.Inertia(float(row[0]), row[1:4], np.diag(row[4:7]))
            inertias[self._joint[frame]] = place.act(inertia)
        return constants

    def feet(self, constants: ChainConstants, q: Array) -> FootPose:
        """Poses of the feet for coordinates (nf, 27)."""
        return self._feet(constants, self._frames(constants, q))

    def _frames(self, constants: ChainConstants, q: Array) -> Poses:
        """Where the joints of the legs are, for coordinates (nf, 27)."""
        coordinates = np.zeros((len(q), len(self._chain.coordinates)))
        coordinates[:, self._of_chain] = q[:, self._of_body]
        return forward(self._chain, constants, coordinates)

    def _feet(self, constants: ChainConstants, frames: Poses) -> FootPose:
        axes, origins = segment_poses(self._chain, constants, frames)
        return FootPose(axes[self._foot], origins[self._foot])

    def torques(
        self, constants: ChainConstants, basis: SplineBasis, nodes: Array, wrench: Array, undisturbed: FootPose
    ) -> tuple[Array, Array]:
        """(nf, 14) N·m with the wrenches (nf, 2, 6) fixed in the laboratory, and carried along with the feet.

        The model must hold the parameters that `constants` belong to (`disturb`).
        """
        q, v, a = (basis.evaluate(nodes, k) for k in range(3))
        states = (with_reactions(self.linkage, values) for values in (q, v, a))
        unloaded = unloaded_forces(self.linkage, self._data, *states)[:, self.rows]
        frames = self._frames(constants, q)
        columns = jacobian(self._chain, constants, frames)[self._moved]
        laboratory = wrench.transpose(1, 2, 0)
        carried = carry(laboratory, undisturbed, self._feet(constants, frames))

        def loaded(wrenches: Array) -> Array:
            tau = unloaded.copy()
            for foot, joints in enumerate(OF_FOOT):
                tau[:, joints] -= np.einsum("kif,if->fk", columns[joints], wrenches[foot])
            return tau

        return loaded(laboratory), loaded(carried)


def carry(wrench: Array, before: FootPose, after: FootPose) -> Array:
    """(2, 6, nf) wrenches about the laboratory origin, carried along from one pose of the feet to another."""
    out = np.empty_like(wrench)
    force = wrench[:, :3]
    moment = wrench[:, 3:] - np.cross(before.origin, force, axis=1)
    for turned, vector in ((out[:, :3], force), (out[:, 3:], moment)):
        local = np.einsum("sjif,sif->sjf", before.axes, vector)
        turned[:] = np.einsum("sjif,sjf->sif", after.axes, local)
    out[:, 3:] += np.cross(after.origin, out[:, :3], axis=1)
    return out


def _half_turn(axis: int) -> Array:
    """(3, 3) a half turn that reverses an axis."""
    diagonal = -np.ones(3)
    diagonal[(axis + 1) % 3] = 1.0
    return np.diag(diagonal)
