"""Kinematics of a chain for all frames at once.

Everything is vectorised over frames, with the frame index last, so that each elementary operation is one pass over
contiguous memory. Poses are kept as the three axis vectors of a frame and its origin, in the laboratory; the columns
of the Jacobian are spatial velocities **about the laboratory origin** [v; w]: a turn about the unit axis a through
the point c is [c x a; a], a slide along a is [a; 0]. They agree with Pinocchio's `computeJointJacobians` (tested).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, ChainConstants

Array = NDArray[np.float64]


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
    plain = [np.array_equal(r, np.eye(3)) for r in constants.offset_rotation]
    for k, (parent, e) in enumerate(zip(chain.parents, chain.elements, strict=True)):
        frame, origin = (identity, ground) if parent < 0 else (axes[parent], origins[parent])
        translation = constants.offset_translation[k]
        if translation.any():
            np.matmul(translation, frame.reshape(3, 3 * nf), out=origins[k].reshape(3 * nf))
            origins[k] += origin
        else:
            origins[k] = origin
        if not plain[k]:
            frame = np.matmul(constants.offset_rotation[k].T, frame.reshape(3, 3 * nf)).reshape(3, 3, nf)
        if not e.rotates:
            axes[k] = frame
            origins[k] += frame[e.axis] * (e.sign * columns[k])
            continue
        a, b = (e.axis + 1) % 3, (e.axis + 2) % 3
        c, s = cos[k], sin[k] if e.sign > 0 else -sin[k]
        axes[k, e.axis] = frame[e.axis]
        np.multiply(frame[a], c, out=axes[k, a])
        axes[k, a] += frame[b] * s
        np.multiply(frame[b], c, out=axes[k, b])
        axes[k, b] -= frame[a] * s
    return Poses(axes, origins)


def segment_poses(chain: Chain, constants: ChainConstants, poses: Poses) -> tuple[Array, Array]:
    """Segment axes (ns, 3, 3, nf) (axis j of segment s in [s, j]) and origins (ns, 3, nf), m."""
    frames = poses.axes[chain.segment_frame]
    ns, nf = len(chain.segments), frames.shape[-1]
    flat = frames.reshape(ns, 3, 3 * nf)
    axes = np.matmul(constants.segment_rotation.transpose(0, 2, 1), flat).reshape(ns, 3, 3, nf)
    origins = np.matmul(constants.segment_translation[:, None, :], flat).reshape(ns, 3, nf)
    return axes, origins + poses.origins[chain.segment_frame]


def jacobian(chain: Chain, constants: ChainConstants, poses: Poses) -> Array:
    """(nq + np, 6, nf) spatial velocity [v; w] about the laboratory origin per unit of each coordinate and free JP."""
    nq, n_free, nf = len(chain.coordinates), len(chain.free), poses.origins.shape[-1]
    out = np.empty((nq + n_free, 6, nf))
    for k, e in enumerate(chain.elements):
        axis = poses.axes[k, e.axis] if e.sign > 0 else -poses.axes[k, e.axis]
        _fill(out[k], axis, poses.origins[k] if e.rotates else None)
    if n_free:
        frames = poses.axes[chain.parameter_frame].reshape(n_free, 3, 3 * nf)
        axes = np.matmul(constants.parameter_axis[:, None, :], frames).reshape(n_free, 3, nf)
        points = np.matmul(constants.parameter_point[:, None, :], frames).reshape(n_free, 3, nf)
        points += poses.origins[chain.parameter_frame]
        for k, rotates in enumerate(chain.parameter_rotates):
            _fill(out[nq + k], axes[k], points[k] if rotates else None)
    return out


def _fill(column: Array, axis: Array, point: Array | None) -> None:
    if point is None:
        column[:3] = axis
        column[3:] = 0.0
        return
    column[3:] = axis
    column[0] = point[1] * axis[2] - point[2] * axis[1]
    column[1] = point[2] * axis[0] - point[0] * axis[2]
    column[2] = point[0] * axis[1] - point[1] * axis[0]
