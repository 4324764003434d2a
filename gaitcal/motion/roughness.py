"""How rough a motion is: the penalty that limits its bandwidth, whatever the number of its nodes.

    tr(N^T R N K),      R_ab = int b_a''' b_b''' dt,      K = rate (2 pi f)^-6 W

is added to the marker cost: P-splines with a penalty on the derivative itself (O'Sullivan 1986; Eilers and Marx 1996).
W (nq, nq) is what one frame's markers know of the coordinates (`bandwidth.py`). Were every frame to know just W, an
oscillation of nu Hz would pass with the gain 1 / (1 + (nu / f)^6), in every coordinate alike: half of it at f, 71 %
(-3 dB) at 0.863 f.

The third derivative of a quintic spline is a quadratic one with the coefficients D n, so that R = D^T Q D with Q the
products of quadratic B-splines. Cost and gradient are taken from D N: in R N the large numbers of R would cancel.

A coordinate by itself, of G = B^T B, keeps  tr (G + rate (2 pi f)^-6 R)^-1 G  of its nodes: the sum of the gains
1 / (1 + (nu_j / f)^6) over its Demmler-Reinsch frequencies,  R u = mu G u,  nu_j = (rate mu_j)^(1/6) / 2 pi.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array, diags_array, eye_array

from gaitcal.arrays import Array, BoolArray
from gaitcal.motion.spline import DEGREE, ORDER, SplineBasis

PENALISED = 3
"""The derivative that is penalised: the jerk, whose penalty leaves accelerations finite and free at the ends."""
HALF_POWER = float((np.sqrt(2.0) - 1.0) ** (1.0 / (2 * PENALISED)))
"""Where the gain is -3 dB, in units of f."""
NODES_AT_ONCE = 256
"""Rows of the band worked on together, to bound memory."""


@dataclass(frozen=True, kw_only=True)
class Smoothing:
    """The penalty of one trial, m^2."""

    jerk: csr_array
    """(nn - 3, nn) D, 1/s^3."""
    products: csr_array
    """(nn - 3, nn - 3) Q, s."""
    coupling: Array
    """(nq, nq) K."""
    cutoff_hz: float
    """f: half of an oscillation at it passes."""

    @cached_property
    def band(self) -> Array:
        """(nn, 6) R[a, a + d]."""
        matrix = self.jerk.T @ self.products @ self.jerk
        out = np.zeros((self.jerk.shape[1], ORDER))
        for d in range(ORDER):
            diagonal = matrix.diagonal(d)
            out[: len(diagonal), d] = diagonal
        return out

    def of_active(self, active: BoolArray) -> Smoothing:
        """The same without the coordinates that are not `active` (nq,): nothing draws them from where they are."""
        kept = np.where(active[:, None] & active, self.coupling, 0.0)
        return Smoothing(jerk=self.jerk, products=self.products, coupling=kept, cutoff_hz=self.cutoff_hz)

    def cost(self, nodes: Array) -> float:
        """m^2, for nodes (nn, nq)."""
        jerk = self.jerk @ nodes
        return float(np.vdot(jerk, self.products @ jerk @ self.coupling))

    def gradient(self, nodes: Array) -> Array:
        """(nn, nq) half gradient of the cost."""
        out: Array = self.jerk.T @ (self.products @ (self.jerk @ nodes)) @ self.coupling
        return out

    def add_to(self, band: Array) -> None:
        """Add half the Hessian to `band` (nn * nq, 6 nq), in the layout of `NormalEquations`, in place."""
        nq = len(self.coupling)
        blocks = band.reshape(-1, nq, ORDER * nq)
        j, i = np.indices((nq, nq))
        # Of node blocks a, a + d the entry (coordinate j, coordinate i) stands at column d nq + i - j of row j.
        for d in range(ORDER):
            low = d * nq - (nq - 1) if d else 0
            pattern = np.zeros((nq, d * nq + nq - low))
            kept = (i >= j) if d == 0 else np.full(i.shape, True)
            pattern[j[kept], (d * nq + i - j - low)[kept]] = self.coupling[j[kept], i[kept]]
            for start in range(0, len(blocks), NODES_AT_ONCE):
                part = slice(start, start + NODES_AT_ONCE)
                blocks[part, :, low : low + pattern.shape[1]] += self.band[part, d, None, None] * pattern


def smoothing(basis: SplineBasis, information: Array, cutoff_hz: float) -> Smoothing:
    """The penalty that passes half of an oscillation at `cutoff_hz`, for W = `information` (nq, nq)."""
    jerk, products = _jerk(basis.knots), _products(basis.knots[PENALISED:-PENALISED])
    coupling = _stiffness(basis, cutoff_hz) * information
    return Smoothing(jerk=jerk, products=products, coupling=coupling, cutoff_hz=cutoff_hz)


class Smoother:
    """The penalty at work on one coordinate alone: A = B (G + rate (2 pi f)^-6 R)^-1 B^T, its splines told as nodes."""

    def __init__(self, basis: SplineBasis, cutoff_hz: float) -> None:
        self.basis, self.gram, self.rough = basis, gram(basis), _roughness(basis.knots)
        self._set(cutoff_hz)

    def with_cutoff(self, cutoff_hz: float) -> Smoother:
        """The same with another cut-off."""
        other = copy(self)
        other._set(cutoff_hz)
        return other

    def _set(self, cutoff_hz: float) -> None:
        self.stiffness = _stiffness(self.basis, cutoff_hz)
        band = self.gram.copy()
        for d in range(ORDER):
            diagonal = self.rough.diagonal(d)
            band[d, : len(diagonal)] += self.stiffness * diagonal
        band[0] += 1e-14 * band[0].max()
        self._factor = cholesky_banded(band, lower=True)

    def nodes(self, right: Array) -> Array:
        """(nn, k) of series y (nf, k), from B^T y (nn, k)."""
        out: Array = cho_solve_banded((self._factor, True), right)
        return out

    def lost(self, nodes: Array) -> Array:
        """(nn, k) what smoothing takes from a spline of these nodes, as nodes."""
        return self.nodes(self.stiffness * (self.rough @ nodes))

    def kept(self) -> float:
        """Degrees of freedom that are left, tr A."""
        return float(np.trace(self.nodes(dense(self.gram))))


def gram(basis: SplineBasis) -> Array:
    """(6, nn) lower band of G = B^T B."""
    out = np.zeros((ORDER, basis.nodes))
    for first, frames in basis.spans:
        products = basis.value[frames].T @ basis.value[frames]
        for d in range(ORDER):
            out[d, first : first + ORDER - d] += np.diagonal(products, -d)
    return out


def dense(band: Array) -> Array:
    """(nn, nn) the symmetric matrix of a lower band (6, nn)."""
    nn = band.shape[1]
    out = np.diag(band[0])
    for d in range(1, min(ORDER, nn)):
        out += np.diag(band[d, : nn - d], d) + np.diag(band[d, : nn - d], -d)
    return out


def frame_rate(basis: SplineBasis) -> float:
    """Hz, of the frames of a trial on average."""
    return (len(basis.time) - 1) / float(basis.time[-1] - basis.time[0])


def _stiffness(basis: SplineBasis, cutoff_hz: float) -> float:
    omega = 2 * np.pi * cutoff_hz
    return frame_rate(basis) / omega ** (2 * PENALISED)


def _roughness(knots: Array) -> csr_array:
    """(nn, nn) R."""
    jerk = _jerk(knots)
    return csr_array(jerk.T @ _products(knots[PENALISED:-PENALISED]) @ jerk)


def _jerk(knots: Array) -> csr_array:
    """(nn - 3, nn) D: coefficients of the third derivative, by differences of coefficients (de Boor)."""
    out = eye_array(len(knots) - ORDER, format="csr")
    for k in range(PENALISED):
        degree, own = DEGREE - k, knots[k : len(knots) - k]
        count = out.shape[0] - 1
        scale = degree / (own[1 + degree : 1 + degree + count] - own[1 : 1 + count])
        out = diags_array(scale) @ (out[1:] - out[:-1])
    return csr_array(out)


def _products(knots: Array) -> csr_array:
    """(n, n) Q of the quadratic B-splines on `knots`, exact by three Gauss points a span."""
    degree = DEGREE - PENALISED
    edges = knots[degree : len(knots) - degree]
    x, w = np.polynomial.legendre.leggauss(PENALISED)
    half = 0.5 * np.diff(edges)
    points = (edges[:-1, None] + half[:, None] * (1.0 + x)).ravel()
    values = BSpline.design_matrix(points, knots, degree)
    return csr_array(values.T @ diags_array((half[:, None] * w).ravel()) @ values)
