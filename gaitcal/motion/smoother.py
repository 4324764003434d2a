"""The penalty at work on one coordinate alone, whose samples y (nf,) all weigh 1.

    y -> A y = B (G + rho R)^-1 B^T y,       G = B^T B,       rho = rate (2 pi f)^-6,

keeps  tr A = sum_j 1 / (1 + (nu_j / f)^6)  degrees of freedom: the gains at the Demmler-Reinsch frequencies nu_j,

    R u_j = mu_j G u_j,       nu_j = (rate mu_j)^(1/6) / 2 pi        (Demmler and Reinsch 1975).

Splines are told by their nodes, series by B^T y.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gaitcal.arrays import Array
from gaitcal.motion.roughness import Roughness, roughness, stiffness
from gaitcal.motion.spline import ORDER, SplineBasis

FLOOR = 1e-14
"""Of the largest diagonal entry: two nodes between the same frames."""


class Smoother:
    """A of one basis and one cut-off."""

    def __init__(self, basis: SplineBasis, cutoff_hz: float, known: tuple[Array, Roughness] | None = None) -> None:
        """`known`: G and R of the basis, where they were worked out before."""
        self.basis = basis
        self.gram, self.rough = known or (gram(basis), roughness(basis.knots))
        self.stiffness = stiffness(basis, cutoff_hz)
        band = self.gram + self.stiffness * self.rough.band.T
        band[0] += FLOOR * band[0].max()
        self._factor = cholesky_banded(band, lower=True)

    def with_cutoff(self, cutoff_hz: float) -> Smoother:
        """The same with another cut-off."""
        return Smoother(self.basis, cutoff_hz, (self.gram, self.rough))

    def nodes(self, right: Array) -> Array:
        """(nn, k) nodes of A y, from B^T y (nn, k)."""
        out: Array = cho_solve_banded((self._factor, True), right)
        return out

    def lost(self, nodes: Array) -> Array:
        """(nn, k) nodes of y - A y, for splines y with nodes (nn, k)."""
        return self.nodes(self.stiffness * self.rough.times(nodes))

    def kept(self) -> float:
        """Tr A."""
        nn = self.basis.nodes
        whole = np.diag(self.gram[0])
        for d in range(1, min(ORDER, nn)):
            whole += np.diag(self.gram[d, : nn - d], d) + np.diag(self.gram[d, : nn - d], -d)
        return float(np.trace(self.nodes(whole)))


def gram(basis: SplineBasis) -> Array:
    """(6, nn) lower band of G."""
    values, _, _ = basis.matrices
    whole = (values.T @ values).tocsr()
    out = np.zeros((ORDER, basis.nodes))
    for d in range(min(ORDER, basis.nodes)):
        out[d, : basis.nodes - d] = whole.diagonal(-d)
    return out


def onto(basis: SplineBasis, series: Array) -> Array:
    """(nn, k) B^T y of series y (nf, k)."""
    out: Array = basis.matrices[0].T @ series
    return out
