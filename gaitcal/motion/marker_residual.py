"""From markers to normal equations, frame by frame, without ever forming a marker Jacobian.

Marker m of segment s is at x_m = o_s + R_s l_m; residual r_m = x_m - measured_m with weight w_m >= 0 in each frame
(0 where it was not seen). With J_k = [v; w] the spatial velocity (about the laboratory origin) that variable k gives
to everything after it, cost, half gradient and Gauss-Newton matrix of  sum_m w_m |r_m|^2  are

    g_k  = J_k . sum_{m after k} w_m [r_m; x_m x r_m]
    H_kl = J_k . Y_l J_l          (l after k),     Y_l = sum_{m after l} w_m [1, -x~_m; x~_m, -x~_m x~_m].

Y_l is the spatial inertia of point masses w_m at the markers, and H is therefore the joint-space inertia matrix of
that model: what `pin.crba` gives for it (tested), here for all frames at once and with weights that may differ in
every frame. Composite inertias are summed from the tips to the root, once per segment.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.model.kinematics import forward, jacobian, segment_poses

Array = NDArray[np.float64]
IntArray = NDArray[np.intp]

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class MarkerData:
    """Measured markers of one trial, sorted by segment; axes (marker, xyz, frame)."""

    segment: IntArray
    """(nm,) index into the chain's segments, not decreasing."""
    local: Array
    """(nm, 3) m, position in the segment frame."""
    measured: Array
    """(nm, 3, nf) m; any finite number where the weight is zero."""
    weight: Array
    """(nm, nf) >= 0."""

    def frames(self, part: slice) -> MarkerData:
        """The same for some frames."""
        return MarkerData(self.segment, self.local, self.measured[:, :, part], self.weight[:, part])


@dataclass(frozen=True)
class FrameEquations:
    """Cost and normal equations of every frame of a stretch."""

    cost: float
    """m^2, sum over markers and frames."""
    gradient: Array
    """(nq + np, nf) half gradient."""
    hessian: Array
    """(nf, npairs) entries of the Gauss-Newton matrix at `VariablePairs`."""


class VariablePairs:
    """Which pairs of variables (coordinates, then free joint parameters) of a chain move a common marker."""

    def __init__(self, chain: Chain, seen: NDArray[np.bool_]) -> None:
        support = chain.support * seen
        active = np.asarray(support.any(axis=1))
        nq = len(chain.coordinates)
        within = ((support[:, None, :] <= support[None, :, :]).all(axis=2)) & active[:, None] & active[None, :]
        """within[l, k]: what l moves, k moves too."""
        first, second = np.nonzero(np.tril(within | within.T))
        self.deep = np.where(within[first, second], first, second)
        self.shallow = np.where(within[first, second], second, first)
        self.first, self.second = first, second
        self.coordinates = np.flatnonzero(first < nq)
        self.mixed = np.flatnonzero((first >= nq) & (second < nq))
        self.parameters = np.flatnonzero(second >= nq)
        self.active = active


def marker_positions(chain: Chain, constants: ChainConstants, data: MarkerData, q: Array) -> Array:
    """(nm, 3, nf) m, model markers for coordinates (nf, nq)."""
    axes, origins = segment_poses(chain, constants, forward(chain, constants, q))
    return _place(data, axes, origins)


def _place(data: MarkerData, axes: Array, origins: Array) -> Array:
    nf = origins.shape[-1]
    out = np.empty((len(data.segment), 3, nf))
    for s, markers in _groups(data.segment):
        block = np.matmul(data.local[markers], axes[s].reshape(3, 3 * nf)).reshape(-1, 3, nf)
        block += origins[s]
        out[markers] = block
    return out


def _groups(segment: IntArray) -> list[tuple[int, slice]]:
    edges = np.flatnonzero(np.diff(segment)) + 1
    bounds = [0, *edges.tolist(), len(segment)]
    return [(int(segment[a]), slice(a, b)) for a, b in pairwise(bounds)]


def marker_cost(chain: Chain, constants: ChainConstants, data: MarkerData, q: Array) -> float:
    """Sum of w |r|^2 over markers and frames, m^2."""
    r = marker_positions(chain, constants, data, q) - data.measured
    return float(np.einsum("mf,mif,mif->", data.weight, r, r))


def frame_equations(
    chain: Chain, constants: ChainConstants, pairs: VariablePairs, data: MarkerData, q: Array, *, hessian: bool = True
) -> FrameEquations:
    """Cost, half gradient and (optionally) Gauss-Newton matrix of every frame."""
    poses = forward(chain, constants, q)
    axes, origins = segment_poses(chain, constants, poses)
    columns = jacobian(chain, constants, poses)
    moments, cost = _segment_moments(data, _place(data, axes, origins), len(chain.segments), inertia=hessian)
    composite, of_variable = _composites(chain, moments)
    force = composite[:, :6]
    gradient = np.einsum("kif,kif->kf", columns, force[of_variable])
    if not hessian:
        return FrameEquations(cost, gradient, np.empty((q.shape[0], 0)))
    carried = _apply_inertia(composite[:, 6:], of_variable, columns)
    left = np.ascontiguousarray(columns.transpose(2, 0, 1))
    right = np.ascontiguousarray(carried.transpose(2, 1, 0))
    products = np.matmul(left, right)
    flat = products.reshape(len(products), -1)
    return FrameEquations(cost, gradient, flat[:, pairs.shallow * len(columns) + pairs.deep])


def _segment_moments(data: MarkerData, x: Array, segments: int, *, inertia: bool) -> tuple[Array, float]:
    """(ns, 6 or 16, nf): force and moment of the residuals, then mass, first and second moments of the weights."""
    r = x - data.measured
    w = data.weight[:, None, :]
    wr = w * r
    nm, nf = data.weight.shape
    rows = np.empty((nm, 16 if inertia else 6, nf))
    rows[:, :3] = wr
    rows[:, 3] = x[:, 1] * wr[:, 2] - x[:, 2] * wr[:, 1]
    rows[:, 4] = x[:, 2] * wr[:, 0] - x[:, 0] * wr[:, 2]
    rows[:, 5] = x[:, 0] * wr[:, 1] - x[:, 1] * wr[:, 0]
    if inertia:
        wx = w * x
        rows[:, 6] = data.weight
        rows[:, 7:10] = wx
        for k, (i, j) in enumerate(_PAIRS):
            np.multiply(wx[:, i], x[:, j], out=rows[:, 10 + k])
    out = np.zeros((segments, rows.shape[1], nf))
    for s, markers in _groups(data.segment):
        np.sum(rows[markers], axis=0, out=out[s])
    return out, float(np.vdot(wr, r))


def _composites(chain: Chain, moments: Array) -> tuple[Array, IntArray]:
    """Sums over what each variable moves, for each distinct set of segments; and which set a variable has."""
    sets, of_variable = np.unique(chain.support, axis=0, return_inverse=True)
    ns, rows, nf = moments.shape
    return np.matmul(sets, moments.reshape(ns, rows * nf)).reshape(len(sets), rows, nf), of_variable.ravel()


def _apply_inertia(inertia: Array, of_variable: IntArray, columns: Array) -> Array:
    """(nk, 6, nf) Y_k J_k: linear momentum m v - h x w, and moment h x v + (tr S) w - S w."""
    y = inertia[of_variable]
    mass, h, s = y[:, 0], (y[:, 1], y[:, 2], y[:, 3]), y[:, 4:]
    v, w = (columns[:, 0], columns[:, 1], columns[:, 2]), (columns[:, 3], columns[:, 4], columns[:, 5])
    trace = s[:, 0] + s[:, 1] + s[:, 2]
    second = ((s[:, 0], s[:, 3], s[:, 4]), (s[:, 3], s[:, 1], s[:, 5]), (s[:, 4], s[:, 5], s[:, 2]))
    out = np.empty_like(columns)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = mass * v[i] - h[j] * w[k] + h[k] * w[j]
        out[:, 3 + i] = h[j] * v[k] - h[k] * v[j] + (trace - second[i][i]) * w[i]
        out[:, 3 + i] -= second[i][j] * w[j] + second[i][k] * w[k]
    return out
