"""The seven torques of each leg, for disturbed parameters and motions, with the ground reaction in either frame.

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
from numpy.typing import NDArray

from gaitcal.dynamics.inverse_dynamics import FEET, unloaded_forces, with_reactions
from gaitcal.model.build import build_linkage
from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.kinematics import forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES, SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.motion.spline import SplineBasis

Array = NDArray[np.float64]

TORQUES = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "knee_adduction",
    "ankle_angle",
    "subtalar_angle",
)
"""The seven torques of a leg, without the side; the knee's adduction is a reaction."""
LEG_TORQUES: tuple[str, ...] = tuple(f"{name}_{side}" for side in SIDES for name in TORQUES)
"""Both legs: the order of every axis of 14 torques."""
LEG_SEGMENTS: tuple[str, ...] = tuple(f"{s}_{side}" for side in SIDES for s in ("thigh", "shank", "talus", "foot"))


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
        names = self._chain.coordinates
        self._joint = [self.linkage.model.getJointId(name) for name in names]
        self._half_turn = [
            pin.SE3(np.eye(3) if e.sign > 0 else _half_turn(e.axis), np.zeros(3)) for e in self._chain.elements
        ]
        self.rows = np.array([self.linkage.index(name) for name in LEG_TORQUES])
        """Places of the 14 torques among the coordinates of the linkage."""
        self._moved = np.array([names.index(name) for name in LEG_TORQUES])
        self._foot = [self._chain.segments.index(foot) for foot in FEET]
        self._own = [[i for i, name in enumerate(LEG_TORQUES) if name.endswith(f"_{side}")] for side in SIDES]
        self._here = [(k, COORDINATES.index(name)) for k, name in enumerate(names) if name in COORDINATES]
        self._massive = [s for s in MASSIVE_SEGMENTS if s in LEG_SEGMENTS]

    def disturb(self, parameters: Parameters) -> ChainConstants:
        """Put other parameters of the legs into the model; returns the constants of its chain."""
        constants = self._chain.constants(parameters.joint, parameters.zero_angles)
        placements, inertias = self.linkage.model.jointPlacements, self.linkage.model.inertias
        turns = self._half_turn
        for k, parent in enumerate(self._chain.parents):
            offset = pin.SE3(constants.offset_rotation[k], constants.offset_translation[k]) * turns[k]
            placements[self._joint[k]] = offset if parent < 0 else turns[parent].actInv(offset)
        rows = table(parameters.inertial)
        for segment in self._massive:
            s = self._chain.segments.index(segment)
            frame = int(self._chain.segment_frame[s])
            place = turns[frame].actInv(pin.SE3(constants.segment_rotation[s], constants.segment_translation[s]))
            row = rows[MASSIVE_SEGMENTS.index(segment)]
            inertia = pin.Inertia(float(row[0]), row[1:4], np.diag(row[4:7]))
            inertias[self._joint[frame]] = place.act(inertia)
        return constants

    def feet(self, constants: ChainConstants, q: Array) -> FootPose:
        """Poses of the feet for coordinates (nf, 27)."""
        poses = forward(self._chain, constants, self._leg_coordinates(q))
        axes, origins = segment_poses(self._chain, constants, poses)
        return FootPose(axes[self._foot], origins[self._foot])

    def torques(
        self, constants: ChainConstants, basis: SplineBasis, nodes: Array, wrench: Array, undisturbed: FootPose
    ) -> tuple[Array, Array]:
        """(nf, 14) N·m with the wrenches (nf, 2, 6) fixed in the laboratory, and carried along with the feet.

        The model must hold the parameters that `constants` belong to (`disturb`).
        """
        q, v, a = (basis.evaluate(nodes, k) for k in range(3))
        states = (with_reactions(self.linkage, values) for values in (q, v, a))
        free = unloaded_forces(self.linkage, self._data, *states)[:, self.rows]
        poses = forward(self._chain, constants, self._leg_coordinates(q))
        columns = jacobian(self._chain, constants, poses)[self._moved]
        axes, origins = segment_poses(self._chain, constants, poses)
        laboratory = wrench.transpose(1, 2, 0)
        carried = carry(laboratory, undisturbed, FootPose(axes[self._foot], origins[self._foot]))
        out = []
        for wrenches in (laboratory, carried):
            tau = free.copy()
            for foot, own in enumerate(self._own):
                tau[:, own] -= np.einsum("kif,if->fk", columns[own], wrenches[foot])
            out.append(tau)
        return out[0], out[1]

    def _leg_coordinates(self, q: Array) -> Array:
        out = np.zeros((len(q), len(self._chain.coordinates)))
        for here, there in self._here:
            out[:, here] = q[:, there]
        return out


def carry(wrench: Array, before: FootPose, after: FootPose) -> Array:
    """(2, 6, nf) wrenches about the laboratory origin, carried along from one pose of the feet to another."""
    out = np.empty_like(wrench)
    force, moment = wrench[:, :3], wrench[:, 3:] - _cross(before.origin, wrench[:, :3])
    for turned, vector in ((out[:, :3], force), (out[:, 3:], moment)):
        local = np.einsum("sjif,sif->sjf", before.axes, vector)
        turned[:] = np.einsum("sjif,sjf->sif", after.axes, local)
    out[:, 3:] += _cross(after.origin, out[:, :3])
    return out


def _cross(a: Array, b: Array) -> Array:
    """Cross product over axis 1."""
    out = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out


def _half_turn(axis: int) -> Array:
    """(3, 3) a half turn that reverses an axis."""
    kept = (axis + 1) % 3
    diagonal = -np.ones(3)
    diagonal[kept] = 1.0
    return np.diag(diagonal)
