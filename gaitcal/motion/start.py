"""Where tracking starts: rigid fits of the segments turned into coordinates, frame by frame.

The root follows its own markers; every joint then takes the angles that bring the child's orientation nearest to its
rigid fit. For one turn q about axis e between constant rotations P and Q, the q that maximises
trace(R^T P Re(q) Q) is  atan2(G_cb - G_bc, G_bb + G_cc),  G = P^T R Q^T, (b, c) the axes after e; several turns are
visited one after the other until they settle. Frames in which a segment is not determined are interpolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.motion.marker_residual import MarkerData
from gaitcal.motion.rigid import RigidFit, rigid_fit
from gaitcal.motion.spline import SplineBasis

Array = NDArray[np.float64]

SWEEPS = 6


def starting_nodes(chain: Chain, constants: ChainConstants, data: MarkerData, basis: SplineBasis) -> Array:
    """(nn, nq) nodes to start from."""
    return basis.fit(starting_coordinates(chain, constants, data))


def starting_coordinates(chain: Chain, constants: ChainConstants, data: MarkerData) -> Array:
    """(nf, nq) coordinates from rigid fits, continuous in time."""
    nf = data.measured.shape[-1]
    q = np.zeros((nf, len(chain.coordinates)))
    fits = {
        s: rigid_fit(data.local[data.segment == s], data.measured[data.segment == s], data.weight[data.segment == s])
        for s in np.unique(data.segment).tolist()
    }
    root = fits.get(0)
    if root is not None and root.determined.any():
        q[:, :6] = _root_coordinates(root)
    rotations: dict[int, Array] = {}
    for s in range(len(chain.segments)):
        path = _path(chain, s)
        own = [k for k in path if k >= 6 and not any(chain.support[k, t] for t in range(s))]
        base = rotations.get(_parent_segment(chain, s, own))
        if s == 0:
            rotations[0] = _chain_rotation(chain, constants, path, q) @ constants.segment_rotation[0]
            continue
        pending = own if base is not None else []
        fit = fits.get(s)
        if fit is not None and fit.determined.any() and pending:
            above = path[: path.index(pending[0])]
            _fit_turns(chain, constants, above, pending, s, fit, q)
        rotations[s] = _chain_rotation(chain, constants, path, q)
    return q


def _parent_segment(chain: Chain, segment: int, own: list[int]) -> int:
    moved = chain.support[own[0]] if own else chain.support[_path(chain, segment)[-1]]
    above = [t for t in range(segment) if not moved[t] and set(_path(chain, t)) <= set(_path(chain, segment))]
    return above[-1] if above else 0


def _path(chain: Chain, segment: int) -> list[int]:
    path, k = [], int(chain.segment_frame[segment])
    while k >= 0:
        path.append(k)
        k = chain.parents[k]
    return path[::-1]


def _root_coordinates(fit: RigidFit) -> Array:
    """(nf, 6) from R = Rz(tilt) Rx(list) Ry(rotation)."""
    r = fit.rotation
    tilt = np.arctan2(-r[:, 0, 1], r[:, 1, 1])
    lean = np.arcsin(np.clip(r[:, 2, 1], -1.0, 1.0))
    turn = np.arctan2(-r[:, 2, 0], r[:, 2, 2])
    angles = np.stack([tilt, lean, turn], axis=1)
    return np.hstack([_fill(fit.origin, fit.determined), _fill(_unwrap(angles, fit.determined), fit.determined)])


def _unwrap(angles: Array, known: NDArray[np.bool_]) -> Array:
    out = angles.copy()
    out[known] = np.unwrap(angles[known], axis=0)
    out[known] -= 2 * np.pi * np.round(np.median(out[known], axis=0) / (2 * np.pi))
    return out


def _fill(values: Array, known: NDArray[np.bool_]) -> Array:
    """Interpolate frames that are not known; the ends keep the nearest known value."""
    if known.all():
        return values
    frames = np.arange(len(values))
    return np.stack([np.interp(frames, frames[known], column[known]) for column in values.T], axis=1)


def _turn(axis: int, angle: Array) -> Array:
    """(nf, 3, 3) rotations about one axis."""
    out = np.zeros((len(angle), 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[:, axis, axis] = 1.0
    out[:, a, a] = out[:, b, b] = np.cos(angle)
    out[:, b, a] = np.sin(angle)
    out[:, a, b] = -out[:, b, a]
    return out


def _chain_rotation(chain: Chain, constants: ChainConstants, path: list[int], q: Array) -> Array:
    rotation = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    for k in path:
        rotation = rotation @ constants.offset_rotation[k]
        e = chain.elements[k]
        if e.rotates:
            rotation = rotation @ _turn(e.axis, e.sign * q[:, k])
    return rotation


def _fit_turns(
    chain: Chain, constants: ChainConstants, above: list[int], own: list[int], segment: int, fit: RigidFit, q: Array
) -> None:
    """Angles of the turns `own` that bring the segment nearest to its rigid fit, written into `q`."""
    base = _chain_rotation(chain, constants, above, q)
    target = base.transpose(0, 2, 1) @ fit.rotation @ constants.segment_rotation[segment].T
    angles = np.zeros((len(q), len(own)))
    for _ in range(SWEEPS if len(own) > 1 else 1):
        for i, k in enumerate(own):
            before = np.broadcast_to(np.eye(3), target.shape)
            for j, m in enumerate(own[:i]):
                before = before @ constants.offset_rotation[m] @ _turn(chain.elements[m].axis, angles[:, j])
            before = before @ constants.offset_rotation[k]
            after = np.broadcast_to(np.eye(3), target.shape)
            for j, m in enumerate(own[i + 1 :], start=i + 1):
                after = after @ constants.offset_rotation[m] @ _turn(chain.elements[m].axis, angles[:, j])
            g = before.transpose(0, 2, 1) @ target @ after.transpose(0, 2, 1)
            b, c = (chain.elements[k].axis + 1) % 3, (chain.elements[k].axis + 2) % 3
            angles[:, i] = np.arctan2(g[:, c, b] - g[:, b, c], g[:, b, b] + g[:, c, c])
    signs = np.array([chain.elements[k].sign for k in own])
    q[:, own] = _fill(_unwrap(angles, fit.determined), fit.determined) * signs
