"""The part of the Hessian that Gauss-Newton leaves out: how the markers curve, weighted by the residuals.

With the notation of `marker_residual.py`, r_m already multiplied by its weight, the second derivative of marker m by
variables k before l (k = l too) is  w_k x (v_l + w_l x x_m), so that the half Hessian of the cost gains

    sum_{m after l} r_m . (w_k x (v_l + w_l x x_m))  =  w_k . p_l,     p_l = v_l x F_l + C_l w_l - tr(C_l) w_l,
    F_l = sum r_m,     C_l = sum x_m r_m^T.

Far from the measured markers this term is large: with joint parameters 10 mm and 10 degrees off, Gauss-Newton alone
converges by a factor of about two a step, with it by factors of hundreds; with markers 300 mm from where the model has
them, Gauss-Newton does not converge at all without damping.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def curvature_pulls(columns: Array, force: Array, first: Array) -> Array:
    """(nk, 3, nf) p_l, for J_l (nk, 6, nf), F_l (nk, 3, nf) and C_l (nk, 3, 3, nf)."""
    v, w = columns[:, :3], columns[:, 3:]
    trace = first[:, 0, 0] + first[:, 1, 1] + first[:, 2, 2]
    out = np.empty_like(w)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[:, i] = v[:, j] * force[:, k] - v[:, k] * force[:, j] - trace * w[:, i]
        out[:, i] += first[:, i, 0] * w[:, 0] + first[:, i, 1] * w[:, 1] + first[:, i, 2] * w[:, 2]
    return out
