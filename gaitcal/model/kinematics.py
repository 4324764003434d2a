"""Kinematics of a chain for all frames at once.

Everything is vectorised over frames, with the frame index last, so that each elementary operation is one pass over
contiguous memory. Poses are kept as the three axis vectors of a frame and its origin, in the laboratory; the columns
of the Jacobian are spatial velocities **about the laboratory origin** [v; w]: a turn about the unit axis a through
the point c is [c x a; a], a slide along a is [a; 0]. They agree with Pinocchio's `computeJointJacobians` (tested).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.chain import Chain, ChainConstants


@dataclass(frozen=True)
class Poses:
    """Poses of the moving frames of a chain."""

    axes: Array
    """(nq, 3, 3, nf): axes[k, j] is the j-th unit axis of frame k in the laboratory."""
    origins: Array
    """(nq, 3, nf) m."""
    secondary_axes: dict[int, Array] = field(default_factory=dict)
    """Frame -> (3, nf) y about which the last of its joint's secondary motions turns."""


@dataclass(frozen=True, kw_only=True)
class SecondaryMotion:
    """What joints do besides moving along their coordinates (`linkage.SECONDARY`)."""

    amounts: dict[str, Array]
    """Coordinate -> (4, nf) m, rad: slides along x and y, then turns about x and y, before the coordinate moves."""
    regressors: dict[str, tuple[Array, Array]]
    """Coordinate -> (nf,) of each of `BENDS`: d amount / d variable."""

    def frames(self, part: slice | IntArray) -> SecondaryMotion:
        """The same for some frames."""
        return SecondaryMotion(
            amounts={name: values[:, part] for name, values in self.amounts.items()},
            regressors={name: (a[part], b[part]) for name, (a, b) in self.regressors.items()},
        )


def forward(chain: Chain, constants: ChainConstants, q: Array, secondary: SecondaryMotion | None = None) -> Poses:
    """Poses of all moving frames for coordinates `q` (nf, nq), m and rad."""
    given, second = secondary.amounts if secondary else {}, dict[int, Array]()
    nf, nq = q.shape
    columns = np.ascontiguousarray(q.T)
    cos, sin = np.cos(columns), np.sin(columns)
    axes, origins = np.empty((nq, 3, 3, nf)), np.empty((nq, 3, nf))
    identity = np.zeros((3, 3, nf))
    identity[0, 0] = identity[1, 1] = identity[2, 2] = 1.0
    ground = np.zeros((3, nf))
    plain, still = constants.plain_offsets
    for k, (parent, e) in enumerate(zip(chain.parents, chain.elements, strict=True)):
        frame, origin = (identity, ground) if parent < 0 else (axes[parent], origins[parent])
        # X_k = X_parent C_k M_k. Axis vectors are rows here, so that C_k acts as R^T on (3, 3 nf); most C_k only shift,
        # and some do nothing, which saves a pass over all frames each.
        if still[k]:
            origins[k] = origin
        else:
            np.matmul(constants.offset_translation[k], frame.reshape(3, 3 * nf), out=origins[k].reshape(3 * nf))
            origins[k] += origin
        if not plain[k]:
            frame = np.matmul(constants.offset_rotation[k].T, frame.reshape(3, 3 * nf)).reshape(3, 3, nf)
        if (name := chain.coordinates[k]) in given:
            x, y, front, trans = given[name]
            origins[k] += frame[0] * x + frame[1] * y
            frame = _turned(frame, 0, np.cos(front), np.sin(front))
            second[k] = frame[1]
            frame = _turned(frame, 1, np.cos(trans), np.sin(trans))
        if not e.rotates:
            axes[k] = frame
            origins[k] += frame[e.axis] * (e.sign * columns[k])
            continue
        _turned(frame, e.axis, cos[k], sin[k] if e.sign > 0 else -sin[k], out=axes[k])
    return Poses(axes, origins, second)


def _turned(frame: Array, axis: int, c: Array, s: Array, out: Array | None = None) -> Array:
    """(3, 3, nf) axes of a frame after a right-handed turn about one of them, of cosine and sine (nf,)."""
    # it mixes the two others: a' = c a + s b, b' = c b - s a
    out, a, b = np.empty_like(frame) if out is None else out, (axis + 1) % 3, (axis + 2) % 3
    out[axis] = frame[axis]
    np.multiply(frame[a], c, out=out[a])
    out[a] += frame[b] * s
    np.multiply(frame[b], c, out=out[b])
    out[b] -= frame[a] * s
    return out


def segment_transforms(chain: Chain, constants: ChainConstants, poses: Poses) -> Array:
    """(ns, 4, 3, nf) segment poses: three axes and the origin (m) of each, in the laboratory."""
    frames = poses.axes[chain.segment_frame]
    ns, nf = len(chain.segments), frames.shape[-1]
    out: Array = np.matmul(constants.segment_placement, frames.reshape(ns, 3, 3 * nf)).reshape(ns, 4, 3, nf)
    out[:, 3] += poses.origins[chain.segment_frame]
    return out


def segment_poses(chain: Chain, constants: ChainConstants, poses: Poses) -> tuple[Array, Array]:
    """Segment axes (ns, 3, 3, nf) (axis j of segment s in [s, j]) and origins (ns, 3, nf), m."""
    both = segment_transforms(chain, constants, poses)
    return both[:, :3], both[:, 3]


def jacobian(chain: Chain, constants: ChainConstants, poses: Poses, secondary: SecondaryMotion | None = None) -> Array:
    """(nq + np, 6, nf) spatial velocity [v; w] about the laboratory origin per unit of each coordinate and free JP, and
    of each free secondary motion, which must be given where one is free.
    """
    nq, n_free, nf = len(chain.coordinates), len(chain.free), poses.origins.shape[-1]
    out = np.empty((nq + n_free, 6, nf))
    axes = out[:nq, 3:]
    axes[...] = poses.axes[np.arange(nq), chain.coordinate_axis]
    for k in chain.reversed_coordinates:
        np.negative(axes[k], out=axes[k])
    _moments(out[:nq], poses.origins, chain.coordinate_slides)
    if n_free:
        frames = poses.axes[chain.parameter_frame].reshape(n_free, 3, 3 * nf)
        placed = np.matmul(constants.parameter_placement, frames).reshape(n_free, 2, 3, nf)
        out[nq:, 3:] = placed[:, 0]
        points = placed[:, 1]
        points += poses.origins[chain.parameter_frame]
        for k, frame, element, _ in chain.secondary if secondary else ():
            if element.rotates:
                points[k] = poses.origins[frame]  # after both slides
                if element.axis == 1:
                    out[nq + k, 3:] = poses.secondary_axes[frame]  # after the turn about x
        _moments(out[nq:], points, chain.parameter_slides)
        if secondary:
            for k, frame, _, bend in chain.secondary:
                out[nq + k] *= secondary.regressors[chain.coordinates[frame]][bend]
    return out


def _moments(columns: Array, points: Array, slides: IntArray) -> None:
    """Complete columns (n, 6, nf) whose lower half holds the axes: those that `slides` names move, the others turn."""
    slid = columns[slides, 3:]
    v, w = columns[:, :3], columns[:, 3:]
    # v = c x a, component by component: np.cross would make arrays of (n, 3, nf) twice over
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(points[:, j], w[:, k], out=v[:, i])
        v[:, i] -= points[:, k] * w[:, j]
    v[slides], w[slides] = slid, 0.0
