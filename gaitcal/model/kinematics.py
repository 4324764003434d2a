"""Kinematics of a linkage in all frames: segment placements and Jacobian columns, by Pinocchio.

    R_s(t), o_s(t)      axes and origin of segment s in the laboratory,
    J_k(t) = [v; w]     spatial velocity about the laboratory origin per unit of variable k,

as `pin.computeJointJacobians` gives them: a rotation about the unit axis a through the point c is
[c x a; a], a translation along a is [a; 0]. Pinocchio works on one frame at a time. What it has
computed is read from its memory, through views that are made once: copying attribute by
attribute takes three times as long as the computation.

The frame index is the last one here, so that what follows is one pass over contiguous memory. A
variable of a secondary motion (`motion/soft_tissue.py`) has the column of the joint that it moves,
times d amount / d variable.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, BoolArray, IntArray, stretches
from gaitcal.model import linkage
from gaitcal.model.chain import LinkageModel, chain_of
from gaitcal.model.parameters import Parameters

BLOCK = 512
"""Frames at a time: bounds what is held of all joints of a long recording."""


@dataclass(frozen=True, kw_only=True)
class SecondaryMotion:
    """What joints do besides moving along their coordinates (`linkage.SECONDARY`)."""

    amounts: dict[str, Array]
    """Coordinate -> (4, nf) m, rad: translations along x and y, then rotations about x and y."""
    regressors: dict[str, tuple[Array, Array]]
    """Coordinate -> (nf,) of each of `BENDS`: d amount / d variable."""

    def frames(self, part: slice | IntArray) -> "SecondaryMotion":
        """Take some frames."""
        return SecondaryMotion(
            amounts={name: values[:, part] for name, values in self.amounts.items()},
            regressors={name: (a[part], b[part]) for name, (a, b) in self.regressors.items()},
        )


class _Memory:
    """NumPy's array interface of a `std::vector` of Pinocchio, of `count` doubles an element."""

    def __init__(self, elements: Sequence[Any], first: Array, second: Array, count: int) -> None:
        start, after = (x.__array_interface__["data"][0] for x in (first, second))
        self.elements = elements
        self.__array_interface__ = {
            "data": (start, False),
            "shape": (len(elements), count),
            "strides": (after - start, 8),
            "typestr": "<f8",
            "version": 3,
        }


def view_placements(placements: Sequence[pin.SE3]) -> Array:
    """View a `std::vector<SE3>` as (n, 12): the three axes one after the other, then the origin."""
    return np.asarray(_Memory(placements, placements[0].rotation, placements[1].rotation, 12))


def view_forces(forces: Sequence[pin.Force]) -> Array:
    """View a `std::vector<Force>` as (n, 6): force, then moment."""
    return np.asarray(_Memory(forces, forces[0].linear, forces[1].linear, 6))


class Kinematics:
    """A linkage in all frames of a motion.

    Parameters
    ----------
    body : the linkage with its parameters.
    q : (nf, nq) coordinates, m and rad.
    secondary : prescribed motions of the knees; the body must have joints for them.
    columns : whether Jacobian columns are wanted.

    Attributes
    ----------
    segments : (ns, 4, 3, nf) axes x, y, z of each segment and its origin (m), laboratory.
    columns : (n, 6, nf) [v; w] about the laboratory origin per unit of each variable of the chain.
    """

    def __init__(
        self, body: LinkageModel, q: Array, secondary: SecondaryMotion | None = None, *, columns: bool = True
    ) -> None:
        chain, nf = body.chain, len(q)
        if secondary is None and any(name in linkage.SECONDARY_VARIABLES for name in chain.free):
            raise ValueError("free variables of secondary motions need the motions that they are of")
        self.chain = chain
        local = body.segment_frames
        self.segments = np.empty((len(chain.segments), 4, 3, nf))
        self.columns = np.empty((len(chain.at_variables), 6, nf) if columns else (0, 6, nf))
        for part in stretches(nf, BLOCK):
            values = body.configurations(q[part])
            if secondary is not None:
                for name, joints in chain.at_secondary.items():
                    if name in secondary.amounts:  # not of a knee that no marker shows
                        values[:, joints] = secondary.amounts[name][:, part].T
            placements, jacobians = evaluate_joints(body, values, jacobians=columns)
            joint_frames = np.ascontiguousarray(placements[:, chain.segment_joint].transpose(1, 2, 0))
            width = joint_frames.shape[2]
            joint_frames = joint_frames.reshape(-1, 4, 3 * width)
            placed = (local @ joint_frames[:, :3]).reshape(-1, 4, 3, width)
            placed[:, 3] += joint_frames[:, 3].reshape(-1, 3, width)
            self.segments[..., part] = placed
            if columns:
                self.columns[..., part] = jacobians[:, chain.at_variables].transpose(1, 2, 0)
        if columns and secondary is not None:
            for k, name in enumerate(chain.variables):
                if name in linkage.SECONDARY_VARIABLES:
                    coordinate, _, bend = linkage.SECONDARY_VARIABLES[name]
                    self.columns[k] *= secondary.regressors[coordinate][bend]

    @property
    def axes(self) -> Array:
        """(ns, 3, 3, nf): axis j of segment s in [s, j]."""
        return self.segments[:, :3]

    @property
    def origins(self) -> Array:
        """(ns, 3, nf) m."""
        return self.segments[:, 3]

    @cached_property
    def columns_by_frame(self) -> Array:
        """(nf, n, 6) the same as `columns`, frames first."""
        return np.ascontiguousarray(self.columns.transpose(2, 0, 1))

    @cached_property
    def segments_by_frame(self) -> Array:
        """(nf, ns, 4, 3) the same as `segments`, frames first."""
        return np.ascontiguousarray(self.segments.transpose(3, 0, 1, 2))

    def axis(self, name: str) -> Array:
        """Find the axis (nf, 3) about which a variable turns what comes after it."""
        return self.columns_by_frame[:, self.chain.variables.index(name), 3:]

    def frame(self, segment: str) -> Array:
        """Find the axes (nf, 3, 3) of a segment, one a row."""
        return self.segments_by_frame[:, self.chain.segments.index(segment), :3]

    def moves(self, segment: str) -> BoolArray:
        """Tell which of the n variables move a segment."""
        return np.asarray(self.chain.support[:, self.chain.segments.index(segment)] > 0)


def evaluate_joints(body: LinkageModel, values: Array, *, jacobians: bool) -> tuple[Array, Array]:
    """Place all joints at configurations (nf, nv).

    Returns
    -------
    (nf, nv + 1, 12) axes and origin (m) of every joint, the ground first, in the laboratory; and
    (nf, nv, 6) Jacobian columns, none if they are not wanted.
    """
    model = body.model
    placements = np.empty((len(values), model.njoints, 12))
    columns = np.empty((len(values), model.nv, 6) if jacobians else (0, model.nv, 6))
    with body.chain.work_space() as data:
        placed, jacobian = view_placements(data.oMi), data.J.T
        if jacobians:
            for row, placement, column in zip(values, placements, columns, strict=True):
                pin.computeJointJacobians(model, data, row)
                placement[...] = placed
                column[...] = jacobian
        else:
            for row, placement in zip(values, placements, strict=True):
                pin.forwardKinematics(model, data, row)
                placement[...] = placed
    return placements, columns


def coordinate_axes(body: LinkageModel, q: Array) -> tuple[Array, Array]:
    """Place the axes of the coordinates, at coordinates (nf, nq).

    Returns
    -------
    (nf, nq, 3) unit axes that positive values move along or about, and (nf, nq, 3) m the origins of the
    joints' frames on them; laboratory.
    """
    placements, columns = evaluate_joints(body, body.configurations(q), jacobians=True)
    at = body.chain.at_coordinates
    moved = columns[:, at]
    rotates = np.array([body.chain.elements[name].rotates for name in body.chain.coordinates])
    axes = np.where(rotates[:, None], moved[..., 3:], moved[..., :3])
    return axes, placements[:, at + 1, 9:]


def body_poses(parameters: Parameters, q: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    """Place the segments of the whole body at coordinates (nf, nq).

    Returns
    -------
    Segment -> axes (3, 3, nf), one a row, and segment -> origin (3, nf) m, laboratory.
    """
    chain = chain_of()
    found = Kinematics(chain.body(parameters), q, columns=False)
    return (dict(zip(chain.segments, found.axes, strict=True)), dict(zip(chain.segments, found.origins, strict=True)))
