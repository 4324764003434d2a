"""How rough a motion is: the penalty that limits its bandwidth, whatever the number of its nodes.

    tr(N^T R N K),      R_ab = int b_a''' b_b''' + (2 pi f_0)^4 b_a' b_b' dt,      K = rate (2 pi f)^-6 W

is added to the marker cost: P-splines with a penalty on derivatives themselves (O'Sullivan 1986; Eilers and Marx 1996).
W (nq, nq) is what one frame's markers know of the coordinates (`bandwidth.py`). Were every frame to know just W, an
oscillation of nu Hz would pass with the gain 1 / (1 + (nu / f)^6), in every coordinate alike: half of it at f, 71 %
(-3 dB) at 0.863 f. The second term is a little tension, nothing to what moves (5e-7 at 1 Hz for f = 7 Hz): where no
marker is seen for long, up to the end of a trial, the jerk alone would let a coordinate fly off along a parabola.

A derivative of a spline is a spline with the coefficients D n, so that R is a sum of D^T Q D with Q the products of
B-splines of lower degree. Cost and gradient are taken from D N: in R N the large numbers of R would cancel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

from gaitcal.arrays import Array, BoolArray
from gaitcal.motion.spline import DEGREE, ORDER, SplineBasis

PENALISED = 3
"""The derivative that is penalised: the jerk, which leaves accelerations free at the ends."""
HALF_POWER = float((np.sqrt(2.0) - 1.0) ** (1.0 / (2 * PENALISED)))
"""Where the gain is -3 dB, in units of f."""
TENSION_HZ = 0.5
"""f_0: in a gap longer than about a third of a second coordinates come to rest."""
NODES_AT_ONCE = 256
"""Rows of the band worked on together, to bound memory."""
KEPT_BYTES = 16 << 20
"""Of half a Hessian that is kept: smaller ones are added again and again."""


@dataclass(frozen=True)
class Roughness:
    """R on some knots, as a sum of D^T Q D."""

    terms: tuple[tuple[csr_array, csr_array], ...]
    """D (nn - k, nn) and Q (nn - k, nn - k), k being the derivative."""

    @cached_property
    def matrix(self) -> csr_array:
        """(nn, nn) R."""
        return csr_array(sum(by_node.T @ products @ by_node for by_node, products in self.terms))

    @cached_property
    def band(self) -> Array:
        """(nn, 6) R[a, a + d]."""
        out = np.zeros((self.matrix.shape[0], ORDER))
        for d in range(ORDER):
            diagonal = self.matrix.diagonal(d)
            out[: len(diagonal), d] = diagonal
        return out

    def cost(self, nodes: Array, coupling: Array) -> float:
        """tr(N^T R N K) for N (nn, k) and K (k, k)."""
        derivatives = ((by_node @ nodes, products) for by_node, products in self.terms)
        return sum(float(np.vdot(values, products @ values @ coupling)) for values, products in derivatives)

    def both(self, nodes: Array, coupling: Array) -> tuple[float, Array]:
        """tr(N^T R N K), and (nn, k) R N K."""
        cost, out = 0.0, np.zeros_like(nodes)
        for (by_node, products), back in zip(self.terms, self._back, strict=True):
            values = by_node @ nodes
            pull = products @ values @ coupling
            cost += float(np.vdot(values, pull))
            out += back @ pull
        return cost, out

    def times(self, nodes: Array) -> Array:
        """(nn, k) R N."""
        _, out = self.both(nodes, np.eye(nodes.shape[1]))
        return out

    @cached_property
    def _back(self) -> tuple[csr_array, ...]:
        """(nn, nn - k) D^T of each term."""
        return tuple(by_node.T.tocsr() for by_node, _ in self.terms)


@dataclass(frozen=True, kw_only=True)
class Smoothing:
    """The penalty of one trial, m^2."""

    roughness: Roughness
    """Of its knots, 1/s^5."""
    coupling: Array
    """(nq, nq) K."""
    cutoff_hz: float
    """f: half of an oscillation at it passes."""

    def of_active(self, active: BoolArray) -> Smoothing:
        """The same without the coordinates that are not `active` (nq,): nothing draws them from where they are."""
        if active.all():
            return self  # with all that is worked out already
        return replace(self, coupling=np.where(active[:, None] & active, self.coupling, 0.0))

    def scaled(self, share: float) -> Smoothing:
        """`share` times the penalty."""
        return replace(self, coupling=share * self.coupling)

    def cost(self, nodes: Array) -> float:
        """m^2, for nodes (nn, nq)."""
        return self.roughness.cost(nodes, self.coupling)

    def both(self, nodes: Array) -> tuple[float, Array]:
        """Cost, and (nn, nq) half its gradient."""
        return self.roughness.both(nodes, self.coupling)

    def gradient(self, nodes: Array) -> Array:
        """(nn, nq) half gradient of the cost."""
        _, out = self.both(nodes)
        return out

    def add_to(self, band: Array) -> None:
        """Add half the Hessian to `band` (nn * nq, 6 nq), in the layout of `NormalEquations`, in place."""
        if band.nbytes <= KEPT_BYTES:
            band += self._whole
        else:
            self._add_blocks(band)

    @cached_property
    def _whole(self) -> Array:
        """(nn * nq, 6 nq) half the Hessian: it is the same at all nodes."""
        nq = len(self.coupling)
        out = np.zeros((len(self.roughness.band) * nq, ORDER * nq))
        self._add_blocks(out)
        return out

    def _add_blocks(self, band: Array) -> None:
        nq, rough = len(self.coupling), self.roughness.band
        blocks = band.reshape(-1, nq, ORDER * nq)
        j, i = np.indices((nq, nq))
        # Of node blocks a, a + d the entry (coordinate j, coordinate i) stands at column d nq + i - j of row j.
        for d in range(ORDER):
            low = d * nq - (nq - 1) if d else 0
            pattern = np.zeros((nq, (d + 1) * nq - low))
            kept = (i >= j) if d == 0 else np.full(i.shape, True)
            pattern[j[kept], (d * nq + i - j - low)[kept]] = self.coupling[j[kept], i[kept]]
            for start in range(0, len(blocks), NODES_AT_ONCE):
                part = slice(start, start + NODES_AT_ONCE)
                blocks[part, :, low : low + pattern.shape[1]] += rough[part, d, None, None] * pattern


def smoothing(basis: SplineBasis, information: Array, cutoff_hz: float) -> Smoothing:
    """The penalty that passes half of an oscillation at `cutoff_hz`, for W = `information` (nq, nq)."""
    coupling = stiffness(basis, cutoff_hz) * information
    return Smoothing(roughness=roughness(basis.knots), coupling=coupling, cutoff_hz=cutoff_hz)


def frame_rate(basis: SplineBasis) -> float:
    """Hz, of the frames of a trial on average."""
    return (len(basis.time) - 1) / float(basis.time[-1] - basis.time[0])


def stiffness(basis: SplineBasis, cutoff_hz: float) -> float:
    """s^5, rate (2 pi f)^-6."""
    omega = 2 * np.pi * cutoff_hz
    return frame_rate(basis) / omega ** (2 * PENALISED)


def roughness(knots: Array) -> Roughness:
    """R of quintic splines on `knots` (nn + 6,)."""
    return _roughness(knots.tobytes())


@lru_cache(maxsize=16)
def _roughness(stored: bytes) -> Roughness:
    """Trials of the same length, and the parts of one, have the same knots."""
    knots = np.frombuffer(stored)
    tension = float(2 * np.pi * TENSION_HZ) ** (2 * PENALISED - 2)
    jerk = derivative(knots, PENALISED), csr_array(products_of(knots, PENALISED))
    rate = derivative(knots, 1), csr_array(tension * products_of(knots, 1))
    return Roughness((jerk, rate))


def derivative(knots: Array, order: int) -> csr_array:
    """(nn - k, nn) D: coefficients of the k-th derivative, by differences of coefficients (de Boor)."""
    out = eye_array(len(knots) - ORDER, format="csr")
    for k in range(order):
        degree, own = DEGREE - k, knots[k : len(knots) - k]
        count = out.shape[0] - 1
        scale = degree / (own[1 + degree : 1 + degree + count] - own[1 : 1 + count])
        out = diags_array(scale) @ (out[1:] - out[:-1])
    return csr_array(out)


def products_of(knots: Array, order: int) -> csr_array:
    """(nn - k, nn - k) Q of the B-splines of the k-th derivative, exact by Gauss points in every span."""
    from scipy.interpolate import BSpline  # only fits ask for it

    degree, own = DEGREE - order, knots[order : len(knots) - order]
    edges = own[degree : len(own) - degree]
    x, w = np.polynomial.legendre.leggauss(degree + 1)
    half = 0.5 * np.diff(edges)
    points = (edges[:-1, None] + half[:, None] * (1.0 + x)).ravel()
    values = BSpline.design_matrix(points, own, degree)
    return csr_array(values.T @ diags_array((half[:, None] * w).ravel()) @ values)
