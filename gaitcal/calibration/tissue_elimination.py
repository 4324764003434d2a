"""Eliminate the soft tissue of each kind of task after the motions; joint parameters remain.

Trials share the joint parameters p; those of one kind of task k share the columns of its soft
tissue z_k besides, which no other kind has. With the motions eliminated (`reduced_problem.py`) and
a prior z_k ~ N(m_k, Lambda_k^-1), the normal equations of p and all z are an arrow,

    [ S_1           C_1 ] [dz_1]     [g_1]     S_k = sum_t S_zz + Lambda_k,
    [       S_2     C_2 ] [dz_2] = - [g_2]     C_k = sum_t S_zp,
    [ C_1^T C_2^T   P   ] [dp  ]     [g_p]     P   = sum_t S_pp + Lambda_p,
                                               g_k = sum_t g_z + Lambda_k (z_k - m_k),

    S_k, C_k and g_k summed over the trials t of kind k, P over all,

with a corner that is solved by the Schur complements of its kinds. With S_k = L_k L_k^T and Y_k =
L_k^-1 C_k,

    H = P - sum_k Y_k^T Y_k,       g = g_p - sum_k Y_k^T L_k^-1 g_k,
    dz_k = -L_k^-T (L_k^-1 g_k + Y_k dp).

At given p the kinds are independent of each other: time and memory grow with their number, and not
with its cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.soft_tissue_artefact import TissuePrior


@dataclass(frozen=True)
class KindPrior:
    """Prior of the soft tissue of one kind of task, z ~ N(mean, covariance)."""

    keys: tuple[str, ...]
    mean: Array  # (nz,) m, rad
    covariance: Array  # (nz, nz)

    @cached_property
    def root(self) -> Array:
        """(nz, nz) F, lower triangular, F F^T the covariance."""
        return np.asarray(np.linalg.cholesky(self.covariance), float)

    @cached_property
    def precision(self) -> Array:
        """(nz, nz) Lambda."""
        inverse = np.linalg.inv(self.root)
        return np.asarray(inverse.T @ inverse, float)


def split_by_kind(tissue: TissuePrior, unknowns: Sequence[Sequence[str]]) -> tuple[KindPrior, ...]:
    """Split a prior of soft tissue by kinds of task.

    Parameters
    ----------
    tissue : TissuePrior
        Prior of the columns of all kinds, independent between kinds.
    unknowns : sequence of sequence of str
        Names of the unknowns of each kind; columns that no kind has are left out.

    Returns
    -------
    tuple of KindPrior
        One for each kind.

    Raises
    ------
    ValueError
        Two kinds share a column or are correlated, so they cannot be eliminated separately.
    """
    kinds = []
    for names in unknowns:
        opened = set(names)
        kinds.append([i for i, key in enumerate(tissue.keys) if key in opened])
    taken = [i for places in kinds for i in places]
    coupling = tissue.covariance.copy()
    for places in kinds:
        coupling[np.ix_(places, places)] = 0.0
    if len(set(taken)) < len(taken) or coupling[np.ix_(taken, taken)].any():
        raise ValueError("kinds of task share soft tissue, or their priors are correlated")
    out = []
    for places in kinds:
        keys = tuple(tissue.keys[i] for i in places)
        out.append(KindPrior(keys, tissue.mean[places], tissue.covariance[np.ix_(places, places)]))
    return tuple(out)


@dataclass(frozen=True)
class EliminatedKind:
    """Soft tissue of one kind, eliminated at z; all kinds share the order of joint parameters."""

    prior: KindPrior
    z: Array  # (nz,) m, rad, where its trials were solved
    root: Array  # (nz, nz) L, lower triangle
    halfway: Array  # (nz, np) Y
    forward: Array  # (nz,) L^-1 g_k
    cost: float  # at z, prior included
    hessian: Array  # (np, np) sum S_pp - Y^T Y
    gradient: Array  # (np,) half gradient, z following

    @property
    def reduction(self) -> float:
        """Predicted decrease of the cost by the step of z."""
        return float(self.forward @ self.forward)

    @property
    def step(self) -> Array:
        """(nz,) step from z to the minimum at the same joint parameters."""
        return -self.solve_upper(self.forward)

    @cached_property
    def sensitivity(self) -> Array:
        """(nz, np) L^-T Y = -dz/dp."""
        return self.solve_upper(self.halfway)

    def solve_lower(self, columns: Array) -> Array:
        """Compute L^-1 times columns (nz, nc)."""
        if not len(columns):
            return columns
        return np.asarray(
            solve_triangular(self.root, columns, lower=True, check_finite=False), float
        )

    def solve_upper(self, columns: Array) -> Array:
        """Compute L^-T times a vector or columns."""
        if not len(columns):
            return columns
        return np.asarray(
            solve_triangular(self.root, columns, lower=True, trans=1, check_finite=False), float
        )

    def solve(self, columns: Array) -> Array:
        """Compute S_k^-1 times columns (nz, nc)."""
        return self.solve_upper(self.solve_lower(columns))


def eliminate_tissue(
    prior: KindPrior, z: Array, hessian: Array, gradient: Array, cost: float
) -> EliminatedKind:
    """Eliminate the soft tissue of one kind.

    Parameters
    ----------
    prior : KindPrior
        Prior of its columns.
    z : (nz,) array
        Where its trials were solved, m and rad.
    hessian : (np + nz, np + nz) array
        Sum over its trials, motions eliminated, joint parameters first.
    gradient : (np + nz,) array
        Half gradient, likewise.
    cost : float
        Likewise.

    Returns
    -------
    EliminatedKind
        Contribution of the kind to the problem in p.
    """
    count = len(gradient) - len(z)
    corner = hessian[count:, count:] + prior.precision
    from_mean = z - prior.mean
    pull = prior.precision @ from_mean
    root = np.asarray(np.linalg.cholesky(corner), float)
    right = np.column_stack([hessian[count:, :count], gradient[count:] + pull])
    if len(z):
        right = np.asarray(solve_triangular(root, right, lower=True, check_finite=False), float)
    halfway, forward = np.ascontiguousarray(right[:, :-1]), np.ascontiguousarray(right[:, -1])
    return EliminatedKind(
        prior=prior,
        z=z,
        root=root,
        halfway=halfway,
        forward=forward,
        cost=cost + float(from_mean @ pull),
        hessian=hessian[:count, :count] - halfway.T @ halfway,
        gradient=gradient[:count] - halfway.T @ forward,
    )


class Arrow:
    """Hessian of joint parameters and all soft tissue; unknowns in the order p, z_1, z_2, ...

    Parameters
    ----------
    kinds : sequence of EliminatedKind
        Kinds of task.
    precision : (np, np) array
        Lambda_p.
    null : float, optional
        Without a prior of joint parameters: share of the largest eigenvalue below which eigenvalues
        count as zero in the inverse. Their directions are unobservable.
    """

    def __init__(
        self, kinds: Sequence[EliminatedKind], precision: Array, null: float | None = None
    ) -> None:
        self.kinds, self.precision = kinds, precision
        self.information = np.zeros_like(precision)
        """(np, np) information of the trials and of the prior of soft tissue on joint parameters.
        """
        for kind in kinds:
            self.information += kind.hessian
        hessian = self.information + precision
        if null is None or not hessian.size:
            covariance = np.linalg.inv(hessian)
        else:
            covariance = np.linalg.pinv(hessian, rcond=null, hermitian=True)
        self.covariance = np.asarray(covariance, float)
        """(np, np) of joint parameters, by noise and priors."""
        ends = len(precision) + np.cumsum([0, *(len(kind.z) for kind in kinds)])
        self.places: list[IntArray] = [np.arange(a, b) for a, b in pairwise(ends)]
        """Of each kind, places of its columns among all unknowns."""
        self.size = int(ends[-1])

    def solve(self, columns: Array) -> Array:
        """Multiply the inverse by columns (np + nz, nc); most columns are zero in most kinds."""
        count, out = len(self.precision), np.zeros(columns.shape)
        by_joint = columns[:count].copy()
        solved = list[tuple[IntArray, Array]]()
        for kind, places in zip(self.kinds, self.places, strict=True):
            nonzero = np.flatnonzero(columns[places].any(axis=0))
            half = kind.solve_lower(columns[np.ix_(places, nonzero)])
            by_joint[:, nonzero] -= kind.halfway.T @ half
            solved.append((nonzero, kind.solve_upper(half)))
        out[:count] = self.covariance @ by_joint
        for kind, places, (nonzero, moved) in zip(self.kinds, self.places, solved, strict=True):
            out[places] = -kind.sensitivity @ out[:count]
            out[np.ix_(places, nonzero)] += moved
        return out

    def multiply_by_precision(self, columns: Array) -> Array:
        """Multiply the priors' precision by columns (np + nz, nc)."""
        count, out = len(self.precision), np.zeros(columns.shape)
        out[:count] = self.precision @ columns[:count]
        for kind, places in zip(self.kinds, self.places, strict=True):
            nonzero = np.flatnonzero(columns[places].any(axis=0))
            out[np.ix_(places, nonzero)] = kind.prior.precision @ columns[np.ix_(places, nonzero)]
        return out

    def count_effective_parameters(self) -> float:
        """Count the unknowns that trials determine, not priors: tr(H^-1 (H - Lambda))."""
        found = float(np.sum(self.covariance * self.information))
        for kind in self.kinds:
            moved = kind.sensitivity
            found += len(kind.z) - float(np.trace(kind.solve(kind.prior.precision)))
            found -= float(np.sum((moved @ self.covariance) * (kind.prior.precision @ moved)))
        return found
