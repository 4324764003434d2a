"""Banded normal equations of whole trials, and the arrow matrix of trials with shared parameters.

    [ H_qq  H_qp ] [dN]     [g_q]        H_qq: ordered by control points, half-bandwidth 6 nq - 1,
    [ H_pq  H_pp ] [dp] = - [g_p]        as six basis functions overlap

H_qq dN = -g_q is solved by LAPACK's banded Cholesky factorisation. Memory is 8 * 6 nq^2 bytes for
each control point, whatever the number of frames. Several trials t that share parameters p meet in
the corner of an arrow,

    [ H_1           C_1 ] [dN_1]     [g_1]       H_t: band of trial t,
    [       H_2     C_2 ] [dN_2] = - [g_2]       C_t: (coefficients of t, parameters)
    [ C_1^T C_2^T   P   ] [dp  ]     [g_p]       P = sum_t H_pp + prior

Elimination of the coefficients leaves the Schur complement S = P - sum_t C_t^T H_t^-1 C_t for the
parameters:

    dp = -S^-1 (g_p - sum_t C_t^T H_t^-1 g_t),
    dN_t = -H_t^-1 g_t - X_t dp,
    X_t = H_t^-1 C_t.

X_t = -dN_t/dp is the sensitivity of the coefficients. With H_t = L L^T and Y = L^-1 C_t, half of
the substitutions are enough:

    C_t^T H_t^-1 C_t = Y^T Y,      C_t^T H_t^-1 g = Y^T L^-1 g,      X_t dp = L^-T (Y dp).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import blas, lapack

from gaitcal.arrays import Array, IntArray
from gaitcal.tracking import descent, marker_residual
from gaitcal.tracking.spline import ORDER, FrameBlock, SplineBasis

RELATIVE_RIDGE = 1e-14
"""Part of its trace that is added to the diagonal of S: unobserved parameters keep their values."""


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """Cost, half gradient and Gauss-Newton matrix of one trial."""

    cost: float
    band: Array  # (nn * nq, 6 nq): transposed lower band of H_qq, LAPACK's layout column by column
    mixed: Array  # (nn * nq, np) H_qp
    parameters: Array  # (np, np) H_pp
    node_gradient: Array  # (nn, nq)
    parameter_gradient: Array  # (np,)

    def scale_cost(self, share: float) -> "NormalEquations":
        """Multiply the cost, and with it gradient and matrix, by `share`."""
        return NormalEquations(**{f.name: share * getattr(self, f.name) for f in fields(self)})


class Assembler:
    """Sum the equations of frames into the normal equations of a trial.

    The sparsity pattern is computed once for a chain and a basis.
    """

    def __init__(
        self,
        pairs: marker_residual.VariablePairs,
        coordinates: int,
        parameters: int,
        basis: SplineBasis,
        pulled: IntArray | None = None,
    ) -> None:
        """`pulled`: coordinates with a prior, which stay free even if no marker depends on them."""
        self.nq, self.np, self.basis, self.pairs = coordinates, parameters, basis, pairs
        # Only pairs (i >= j) of coordinates that move a common marker have entries: about a third
        # of nq (nq + 1) / 2.
        i, j = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        self._i, self._j = i, j
        self._place = pairs.shallow[pairs.coordinates] * coordinates + pairs.deep[pairs.coordinates]
        self._mirror = np.flatnonzero(i != j)
        idle = np.flatnonzero(~pairs.active[:coordinates])
        self._idle = idle if pulled is None else np.setdiff1d(idle, pulled)
        # (nq, np) 1 where the parameter comes after the coordinate, and 1 where it comes before it
        self._later, self._earlier = np.zeros((2, coordinates, parameters))
        deep, shallow = pairs.deep[pairs.mixed], pairs.shallow[pairs.mixed]
        after = deep >= coordinates
        self._later[shallow[after], deep[after] - coordinates] = 1.0
        self._earlier[deep[~after], shallow[~after] - coordinates] = 1.0

    def assemble(
        self, parts: Iterable[tuple[marker_residual.FrameEquations, FrameBlock]]
    ) -> NormalEquations:
        """Sum the equations of all blocks of frames.

        Parameters
        ----------
        parts
            Equations of each block of frames, and the block.

        Returns
        -------
        NormalEquations
            Coordinates that move no marker have a unit diagonal.
        """
        nn, nq, pairs, cost = self.basis.control_points, self.nq, self.pairs, 0.0
        coordinates, parameters = slice(0, nq), slice(nq, nq + self.np)
        # [node a, d, pair] sum_f B_a(f) B_a+d(f) entry(f)
        blocks = np.zeros((nn, ORDER, len(self._i)))
        node_gradient, mixed = np.zeros((nn, nq)), np.zeros((nn, nq, self.np))
        corner, parameter_gradient = np.zeros((self.np, self.np)), np.zeros(self.np)
        deep, shallow = pairs.deep[pairs.parameters] - nq, pairs.shallow[pairs.parameters] - nq
        for equations, stretch in parts:
            cost += equations.cost
            products = equations.compute_products(coordinates, coordinates)
            entries = np.take(products.reshape(len(products), nq**2), self._place, axis=1)
            blocks[stretch.nodes] += (stretch.products @ entries).reshape(
                -1, ORDER, entries.shape[1]
            )
            stretch.add_gradient(node_gradient, equations.gradient[:nq])
            if self.np:
                # H_kl is J_k . Y_l J_l with l the later of the two in the chain. The masks select
                # which of the two variables that is.
                chosen = equations.compute_products(coordinates, parameters)
                chosen *= self._later
                chosen += (
                    equations.compute_products(parameters, coordinates).transpose(0, 2, 1)
                    * self._earlier
                )
                summed = stretch.weights @ chosen.reshape(len(chosen), nq * self.np)
                mixed[stretch.nodes] += summed.reshape(-1, nq, self.np)
                corner[shallow, deep] += equations.sum_products(parameters)[shallow, deep]
                corner[deep, shallow] = corner[shallow, deep]
                parameter_gradient += equations.gradient[nq:].sum(axis=1)
        # Row (node a, coordinate j), column (node a + d, coordinate i) stands at band[a, j, d nq +
        # i - j]: the distance from the diagonal. A symmetric block of two nodes d > 0 needs its
        # mirror image, on the diagonal (d = 0) not.
        band = np.zeros((nn, nq, ORDER * nq))
        i, j, mirror = self._i, self._j, self._mirror
        for d in range(ORDER):
            band[:, j, d * nq + i - j] = blocks[:, d]
            if d:
                band[:, i[mirror], d * nq + j[mirror] - i[mirror]] = blocks[:, d, mirror]
        # A coordinate that moves no marker would leave a zero on the diagonal. A unit diagonal
        # keeps it at its value.
        band[:, self._idle, 0] = 1.0
        return NormalEquations(
            cost=cost,
            band=band.reshape(nn * nq, ORDER * nq),
            mixed=mixed.reshape(nn * nq, self.np),
            parameters=corner,
            node_gradient=node_gradient,
            parameter_gradient=parameter_gradient,
        )


class BandFactor:
    """Cholesky factor L of H_qq + damping * diagonal.

    A small floor is added where no data determine a coefficient. Many right-hand sides are solved
    in dense blocks of the bandwidth, which couple neighbours only: L = [D; E D; E D; ...]. LAPACK's
    routine solves them one by one, in a multiple of the time.
    """

    def __init__(self, band: Array, damping: float = 0.0, *, overwrite: bool = False) -> None:
        """Factorise a lower band.

        Parameters
        ----------
        band : (n, width) transposed lower band.
        damping : relative to the diagonal.
        overwrite : store the factor in the memory of `band`. A failed factorisation then raises at
            once; otherwise a larger floor is tried first.

        Raises
        ------
        numpy.linalg.LinAlgError
            The matrix is not positive definite.
        """
        copy = band if overwrite else band.copy()
        diagonal = copy[:, 0]
        # Nodes in a gap of the markers have no entries: a floor far below any other entry keeps
        # them where they are.
        floor = 1e-13 * float(diagonal.max())
        diagonal *= 1.0 + damping
        diagonal += floor
        self.factor, info = lapack.dpbtrf(copy.T, lower=1, overwrite_ab=1)
        if info != 0 and not overwrite:
            copy = band.copy()
            copy[:, 0] += 1e-8 * copy[:, 0] + 1e3 * floor
            self.factor, info = lapack.dpbtrf(copy.T, lower=1, overwrite_ab=1)
        if info != 0:
            raise np.linalg.LinAlgError("the normal matrix of the nodes is not positive definite")

    def solve(self, right: Array) -> Array:
        """Solve H_qq x = right.

        Parameters
        ----------
        right
            (n,) or (n, k).

        Returns
        -------
        (n,) or (n, k) array
        """
        if right.ndim == 1:
            return lapack.dpbtrs(self.factor, right, lower=1)[0]
        return self.solve_backward(self.solve_forward(right))

    def solve_forward(self, right: Array, *, overwrite: bool = False) -> Array:
        """Solve L x = right.

        `right`: (n,) or (n, k). `overwrite`: store x in the memory of `right`, (n, k) row by row.
        Returns: x, of the shape of `right`.
        """
        if right.ndim == 1:
            return blas.dtbsv(len(self.factor) - 1, self.factor, right, lower=1, trans=0)
        out = right if overwrite else np.array(right, order="C")
        for rows in self._iterate_blocks():
            if rows.start:
                before = slice(rows.start - len(self.factor), rows.start)
                out[rows] -= self._extract_coupling(before.start) @ out[before]
            out[rows] = self._solve_diagonal_block(rows, out[rows], transposed=1)
        return out

    def solve_backward(self, right: Array) -> Array:
        """Solve L^T x = right.

        `right`: (n,) or (n, k). Returns: x, of the shape of `right`.
        """
        if right.ndim == 1:
            return blas.dtbsv(len(self.factor) - 1, self.factor, right, lower=1, trans=1)
        out, n = np.array(right, order="C"), len(right)
        for rows in reversed(list(self._iterate_blocks())):
            if rows.stop < n:
                out[rows] -= (
                    self._extract_coupling(rows.start).T
                    @ out[rows.stop : rows.stop + len(self.factor)]
                )
            out[rows] = self._solve_diagonal_block(rows, out[rows], transposed=0)
        return out

    @cached_property
    def _above_diagonal(self) -> Array:
        """(width, width) 1 above the diagonal, else 0."""
        return np.tri(len(self.factor), k=-1).T

    def _iterate_blocks(self) -> Iterator[slice]:
        width, n = self.factor.shape
        return (slice(first, min(first + width, n)) for first in range(0, n, width))

    def _solve_diagonal_block(self, block: slice, rows: Array, *, transposed: int) -> Array:
        """Return D^-1 rows (`transposed` = 1) or D^-T rows (0).

        BLAS works on the transpose of the rows, hence the exchanged flag.
        """
        size = block.stop - block.start
        return blas.dtrsm(
            1.0,
            self._extract_dense(block.start, 0, size, size),
            rows.T,
            side=1,
            lower=1,
            trans_a=transposed,
            overwrite_b=1,
        ).T

    def _extract_coupling(self, first: int) -> Array:
        """Return E: rows after the block that begins at `first`, columns of that block."""
        width, n = self.factor.shape
        rows = min(width, n - first - width)
        return self._extract_dense(first, width, rows, width) * self._above_diagonal[:rows]

    def _extract_dense(self, first: int, below: int, rows: int, columns: int) -> Array:
        """View a part of L as a dense matrix.

        It begins at column `first`, `below` rows under the diagonal. Entries outside the band or
        above the diagonal are undefined.
        """
        width = len(self.factor)
        flat, size = self.factor.T.reshape(-1)[first * width + below :], self.factor.itemsize
        return as_strided(flat, (rows, columns), (size, size * (width - 1)), writeable=False)


@dataclass(frozen=True)
class Elimination:
    """One trial after elimination of its coefficients."""

    factor: BandFactor  # of H_t
    halfway: Array  # (nn * nq, np_t) Y
    hessian: Array  # (np_t, np_t) H_pp - C_t^T X_t

    @cached_property
    def sensitivity(self) -> Array:
        """(nn * nq, np_t) X_t."""
        return self.factor.solve_backward(self.halfway)

    def follow(self, change: Array) -> Array:
        """Return (nn * nq,) X_t dp: minus the change of the coefficients after `change` (np_t,)."""
        return self.factor.solve_backward(self.halfway @ change)

    def reduce_gradient(self, node_gradient: Array, parameter_gradient: Array) -> Array:
        """Compute the half gradient by the parameters, with the coefficients at their minimum.

        Parameters
        ----------
        node_gradient
            (nn, nq) half gradient by the coefficients.
        parameter_gradient
            (np_t,) half gradient by the parameters, at the same point.

        Returns
        -------
        (np_t,) array
        """
        return parameter_gradient - self.halfway.T @ self.factor.solve_forward(
            node_gradient.ravel()
        )


def eliminate(
    equations: NormalEquations, damping: float = 0.0, factor: BandFactor | None = None
) -> Elimination:
    """Eliminate the coefficients of one trial.

    Parameters
    ----------
    equations
        Normal equations of the trial.
    damping
        Relative to the diagonals of H_t and H_pp.
    factor
        Of H_t with that damping, if it is known. The equations are then overwritten: Y takes the
        memory of C_t.

    Returns
    -------
    Elimination
        Factor of the band, and the reduced matrix of the parameters.
    """
    halfway, overwrite = equations.mixed, factor is not None
    factor = factor or BandFactor(equations.band, damping)
    if halfway.shape[1]:
        halfway = factor.solve_forward(halfway, overwrite=overwrite)
    hessian = equations.parameters.copy()
    if damping:
        hessian += damping * np.diag(np.diag(equations.parameters))
    if hessian.size:
        # LAPACK sees the transpose: one triangle of it, in half the time of the product
        lower = blas.dsyrk(1.0, halfway.T)
        hessian -= np.triu(lower) + np.triu(lower, 1).T
    return Elimination(factor, halfway, 0.5 * (hessian + hessian.T))


@dataclass(frozen=True)
class SharedPrior:
    """Quadratic prior |L (p - c)|^2 on the shared parameters."""

    cost: float
    gradient: Array  # (np,) half of it, L^T L (p - c)
    matrix: Array  # (np, np) L^T L


class ArrowEquations:
    """Normal equations of several trials at x = (p, coefficients of each trial), for `descend`.

    `columns`: per trial, indices (np_t,) of its parameters among the shared ones.
    """

    spent = False

    def __init__(
        self,
        trials: Sequence[NormalEquations],
        columns: Sequence[IntArray],
        size: int,
        prior: SharedPrior | None = None,
    ) -> None:
        self.trials, self.columns = trials, columns
        self.prior = prior or SharedPrior(0.0, np.zeros(size), np.zeros((size, size)))
        shared = self.prior.gradient.copy()
        for trial, places in zip(trials, columns, strict=True):
            shared[places] += trial.parameter_gradient
        gradient = np.concatenate([shared, *(trial.node_gradient.ravel() for trial in trials)])
        self.evaluation = descent.Evaluation(
            sum(trial.cost for trial in trials) + self.prior.cost, gradient
        )

    def factor(self, damping: float) -> "ArrowFactor":
        """Eliminate the coefficients of every trial."""
        return ArrowFactor(
            [eliminate(trial, damping) for trial in self.trials], self.columns, self.prior.matrix
        )


class ArrowFactor:
    """Solver for parameters and coefficients together."""

    def __init__(
        self, trials: Sequence[Elimination], columns: Sequence[IntArray], prior: Array
    ) -> None:
        self.trials, self.columns = trials, columns
        self.schur = prior.copy()
        for trial, places in zip(trials, columns, strict=True):
            self.schur[np.ix_(places, places)] += trial.hessian
        self.schur += RELATIVE_RIDGE * np.trace(self.schur) * np.eye(len(prior))

    def solve(self, gradient: Array) -> Array:
        """Solve the whole system for parameters and coefficients.

        Parameters
        ----------
        gradient
            (n,) in the order of x.

        Returns
        -------
        (n,) array
            The inverse of the matrix times `gradient`.
        """
        size = len(self.schur)
        ends = size + np.cumsum([0, *(len(trial.halfway) for trial in self.trials)])
        halfway = [
            t.factor.solve_forward(gradient[a:b])
            for t, (a, b) in zip(self.trials, pairwise(ends), strict=True)
        ]
        right = gradient[:size].copy()
        for trial, places, of_trial in zip(self.trials, self.columns, halfway, strict=True):
            right[places] -= trial.halfway.T @ of_trial
        shared = np.linalg.solve(self.schur, right)
        coefficients = [
            trial.factor.solve_backward(of_trial - trial.halfway @ shared[places])
            for trial, places, of_trial in zip(self.trials, self.columns, halfway, strict=True)
        ]
        return np.concatenate([shared, *coefficients])
