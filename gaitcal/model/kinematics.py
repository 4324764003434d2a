"""Kinematics of a chain for all frames at once.

Everything is vectorised over frames, with the frame index last, so that each elementary operation is one pass over
contiguous memory. Poses are kept as the three axis vectors of a frame and its origin, in the laboratory; the columns
of the Jacobian are spatial velocities **about the laboratory origin** [v; w]: a turn about the unit axis a through
the point c is [c x a; a], a slide along a is [a; 0]. They agree with Pinocchio's `computeJointJacobians` (tested).
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.records import dataclass


@dataclass(frozen=True)
class Poses:
    """Poses of the moving frames of a chain."""

    axes: Array
    """(nq, 3, 3, nf): axes[k, j] is the j-th unit axis of frame k in the laboratory."""
    origins: Array
    """(nq, 3, nf) m."""


def forward(chain: Chain, constants: ChainConstants, q: Array) -> Poses:
    """Poses of all moving frames for coordinates `q` (nf, nq), m and rad."""
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
        if not e.rotates:
            axes[k] = frame
            origins[k] += frame[e.axis] * (e.sign * columns[k])
            continue
        # a right-handed turn about one axis mixes the two others: a' = c a + s b, b' = c b - s a
        a, b = (e.axis + 1) % 3, (e.axis + 2) % 3
        c, s = cos[k], sin[k] if e.sign > 0 else -sin[k]
        axes[k, e.axis] = frame[e.axis]
        np.multiply(frame[a], c, out=axes[k, a])
        axes[k, a] += frame[b] * s
        np.multiply(frame[b], c, out=axes[k, b])
        axes[k, b] -= frame[a] * s
    return Poses(axes, origins)


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


def jacobian(chain: Chain, constants: ChainConstants, poses: Poses) -> Array:
    """(nq + np, 6, nf) spatial velocity [v; w] about the laboratory origin per unit of each coordinate and free JP."""
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
        _moments(out[nq:], points, chain.parameter_slides)
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
