"""Where tracking starts: rigid fits of the segments turned into coordinates, frame by frame.

The root follows its own markers; every joint then takes the angles that bring the child's orientation nearest to its
rigid fit. For one turn q about axis e between rotations P and Q, the q that maximises trace(R^T P Re(q) Q) is
atan2(G_cb - G_bc, G_bb + G_cc),  G = P^T R Q^T, (b, c) the axes after e; several turns of one joint are visited one
after the other until they settle. Frames in which a segment is not determined are interpolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.motion.marker_residual import MarkerData
from gaitcal.motion.rigid import RigidFit, rigid_fit
from gaitcal.motion.spline import SplineBasis

Array = NDArray[np.float64]

SWEEPS = 4
ROOT_COORDINATES = 6


SAMPLES_PER_NODE = 3
"""Frames looked at per spline node: a start needs no more."""


def starting_nodes(chain: Chain, constants: ChainConstants, data: MarkerData, basis: SplineBasis) -> Array:
    """(nn, nq) nodes to start from."""
    nf = len(basis.time)
    wanted = SAMPLES_PER_NODE * basis.nodes
    if nf <= wanted:
        return basis.fit(starting_coordinates(chain, constants, data))
    chosen = np.unique(np.round(np.linspace(0, nf - 1, wanted)).astype(int))
    sampled = MarkerData(data.segment, data.local, data.measured[:, :, chosen], data.weight[:, chosen])
    return basis.at(chosen).fit(starting_coordinates(chain, constants, sampled))


def starting_coordinates(chain: Chain, constants: ChainConstants, data: MarkerData) -> Array:
    """(nf, nq) coordinates from rigid fits, continuous in time."""
    nf = data.measured.shape[-1]
    q = np.zeros((nf, len(chain.coordinates)))
    fits = {s: _fit_of(data, s) for s in np.unique(data.segment).tolist()}
    root = fits.get(0)
    if root is not None and root.determined.any():
        q[:, :ROOT_COORDINATES] = _root_coordinates(root)
    frames: dict[int, Array] = {-1: np.broadcast_to(np.eye(3), (nf, 3, 3))}
    for k in range(ROOT_COORDINATES):
        frames[k] = _next_frame(chain, constants, frames, k, q)
    done = set(range(ROOT_COORDINATES))
    for s in range(1, len(chain.segments)):
        path = _path(chain, s)
        own = [k for k in path if k not in done]
        fit = fits.get(s)
        if own and fit is not None and fit.determined.any():
            target = frames[chain.parents[own[0]]].transpose(0, 2, 1) @ fit.rotation
            q[:, own] = _turns(chain, constants, own, target @ constants.segment_rotation[s].T, fit)
        if own and (fit is not None or not _carries_more(chain, s)):
            for k in own:
                frames[k] = _next_frame(chain, constants, frames, k, q)
            done.update(own)
    return q


def _fit_of(data: MarkerData, segment: int) -> RigidFit:
    own = data.segment == segment
    return rigid_fit(data.local[own], data.measured[own], data.weight[own])


def _carries_more(chain: Chain, segment: int) -> bool:
    """Whether other segments hang on this one: then a segment without markers leaves its turns to them."""
    frame = chain.segment_frame[segment]
    return bool((chain.support[frame] > 0).sum() > 1)


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


def _turned(rotation: Array, axis: int, angle: Array) -> Array:
    """(nf, 3, 3) rotation @ R_axis(angle)."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = rotation.copy()
    out[:, :, a] = c * rotation[:, :, a] + s * rotation[:, :, b]
    out[:, :, b] = c * rotation[:, :, b] - s * rotation[:, :, a]
    return out


def _next_frame(chain: Chain, constants: ChainConstants, frames: dict[int, Array], k: int, q: Array) -> Array:
    rotation = frames[chain.parents[k]] @ constants.offset_rotation[k]
    e = chain.elements[k]
    return _turned(rotation, e.axis, e.sign * q[:, k]) if e.rotates else rotation


def _turns(chain: Chain, constants: ChainConstants, own: list[int], target: Array, fit: RigidFit) -> Array:
    """(nf, n) coordinates whose turns, one after the other, come nearest to the rotations `target`."""
    axes = [chain.elements[k].axis for k in own]
    angles = np.zeros((len(target), len(own)))
    for _ in range(SWEEPS if len(own) > 1 else 1):
        # left-hand sides are peeled off as they are settled, right-hand sides kept from the last sweep
        after = [np.broadcast_to(np.eye(3), target.shape)]
        for i in range(len(own) - 1, 0, -1):
            inner = _turned(np.broadcast_to(constants.offset_rotation[own[i]], target.shape), axes[i], angles[:, i])
            after.append(inner @ after[-1])
        remaining = target
        for i, k in enumerate(own):
            remaining = constants.offset_rotation[k].T @ remaining
            g = remaining @ after[len(own) - 1 - i].transpose(0, 2, 1)
            b, c = (axes[i] + 1) % 3, (axes[i] + 2) % 3
            angles[:, i] = np.arctan2(g[:, c, b] - g[:, b, c], g[:, b, b] + g[:, c, c])
            undo = _turned(np.broadcast_to(np.eye(3), target.shape), axes[i], -angles[:, i])
            remaining = undo @ remaining
    signs = np.array([chain.elements[k].sign for k in own])
    out: Array = _fill(_unwrap(angles, fit.determined), fit.determined) * signs
    return out
