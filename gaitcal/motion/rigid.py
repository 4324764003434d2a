"""Each segment alone: the rigid motion that fits its markers best, frame by frame.

With weights w_m, model positions l_m and measured x_m about their weighted means, the best rotation is
R = U diag(1, 1, det(U V^T)) V^T from the singular value decomposition  sum_m w_m x_m l_m^T = U D V^T
(Kabsch 1976). What then remains is the rigid-segment floor: no linkage of these segments can fit better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLLINEAR = 1e-3
"""Ratio of the second to the first singular value of a marker cluster below which its turn is undetermined."""


@dataclass(frozen=True)
class RigidFit:
    """Rigid motion of one segment."""

    rotation: Array
    """(nf, 3, 3) segment to laboratory."""
    origin: Array
    """(nf, 3) m, of the segment frame."""
    determined: NDArray[np.bool_]
    """(nf,) whether at least three markers that are not on one line were seen."""
    residual: Array
    """(nm, nf) m, distances; NaN where the weight is zero."""


def rigid_fit(local: Array, measured: Array, weight: Array) -> RigidFit:
    """Fit local positions (nm, 3) to measured ones (nm, 3, nf) with weights (nm, nf)."""
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1.0)
    x_mean = np.einsum("mf,mif->fi", weight, measured) / safe[:, None]
    l_mean = np.einsum("mf,mi->fi", weight, local) / safe[:, None]
    spread = np.einsum("mf,mif,mj->fij", weight, measured, local)
    spread -= total[:, None, None] * x_mean[:, :, None] * l_mean[:, None, :]
    u, d, vt = np.linalg.svd(spread)
    sign = np.sign(np.linalg.det(u @ vt))
    u[:, :, 2] *= sign[:, None]
    rotation = u @ vt
    origin = x_mean - np.einsum("fij,fj->fi", rotation, l_mean)
    seen = (weight > 0).sum(axis=0)
    determined = (seen >= 3) & (d[:, 1] > COLLINEAR * d[:, 0])
    model = np.einsum("fij,mj->mif", rotation, local) + origin.T[None]
    residual = np.linalg.norm(model - measured, axis=1)
    few = (seen > 0) & ~determined
    if few.any():
        residual[:, few] = _undetermined_residual(local, measured[:, :, few], weight[:, few])
    residual[weight <= 0] = np.nan
    return RigidFit(rotation, origin, determined, residual)


def _undetermined_residual(local: Array, measured: Array, weight: Array) -> Array:
    """Distances where one or two markers are seen: two fit up to the change of their distance, one exactly."""
    out = np.zeros(weight.shape)
    for f in range(weight.shape[1]):
        seen = np.flatnonzero(weight[:, f] > 0)
        if len(seen) < 2:
            continue
        w = weight[seen, f]
        l_c = local[seen] - np.average(local[seen], axis=0, weights=w)
        x_c = measured[seen, :, f] - np.average(measured[seen, :, f], axis=0, weights=w)
        u, _, vt = np.linalg.svd((w[:, None] * x_c).T @ l_c)
        u[:, 2] *= np.sign(np.linalg.det(u @ vt))
        out[seen, f] = np.linalg.norm(l_c @ (u @ vt).T - x_c, axis=1)
    return out
