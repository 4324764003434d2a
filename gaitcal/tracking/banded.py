"""Normal equations of whole trials: a block band for the coefficients of each, an arrow for what
trials share.

    [ H_qq  H_qp ] [dN]     [g_q]        H_qq: node-major, half-bandwidth 6 nq - 1 (six splines overlap)
    [ H_pq  H_pp ] [dp] = - [g_p]

H_qq dN = -g_q is solved by LAPACK's banded Cholesky factorisation. Memory is 8 * 6 nq^2 bytes a
node, whatever the number of frames. Several trials t that share parameters p meet in the corner of
an arrow,

    [ H_1           C_1 ] [dN_1]     [g_1]       H_t: band of trial t,       C_t: (nodes of t, parameters)
    [       H_2     C_2 ] [dN_2] = - [g_2]
    [ C_1^T C_2^T   P   ] [dp  ]     [g_p]       P = sum_t H_pp + prior

Elimination of the nodes leaves the Schur complement S = P - sum_t C_t^T H_t^-1 C_t for the
parameters:

    dp = -S^-1 (g_p - sum_t C_t^T H_t^-1 g_t),      dN_t = -H_t^-1 g_t - X_t dp,      X_t = H_t^-1 C_t.

X_t is what the nodes of trial t lose by the parameters: -dN_t/dp. With H_t = L L^T and Y = L^-1 C_t
all of it
comes from half the substitutions: C_t^T H_t^-1 C_t = Y^T Y,  C_t^T H_t^-1 g = Y^T L^-1 g,  X_t dp = L^-T (Y dp).
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

ROUNDING = 1e-14  # part of its trace that is added to S: parameters that no trial sees do not move


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """Half gradient and Gauss-Newton matrix of one trial at given coefficients and joint
    parameters.
    """

    cost: float
    band: Array  # (nn * nq, 6 nq): transposed lower band of H_qq, LAPACK's layout column by column
    mixed: Array  # (nn * nq, np) H_qp
    parameters: Array  # (np, np) H_pp
    node_gradient: Array  # (nn, nq)
    parameter_gradient: Array  # (np,)

    def scaled(self, share: float) -> "NormalEquations":
        """Those of `share` times the cost."""
        return NormalEquations(**{f.name: share * getattr(self, f.name) for f in fields(self)})


class Assembler:
    """Sums frame equations into normal equations; the pattern is worked out once for a chain and a
    basis.
    """

    def __init__(
        self,
        pairs: marker_residual.VariablePairs,
        coordinates: int,
        parameters: int,
        basis: SplineBasis,
        pulled: IntArray | None = None,
    ) -> None:
        """`pulled`: coordinates that something else than markers determines, if they move none."""
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

    def assembled(
        self, parts: Iterable[tuple[marker_residual.FrameEquations, FrameBlock]]
    ) -> NormalEquations:
        """The equations of all stretches as a banded matrix; coordinates that move no marker get a
        unit diagonal.
        """
        nn, nq, pairs, cost = self.basis.nodes, self.nq, self.pairs, 0.0
        coordinates, parameters = slice(0, nq), slice(nq, nq + self.np)
        blocks = np.zeros(
            (nn, ORDER, len(self._i))
        )  # [node a, d, pair] sum_f B_a(f) B_a+d(f) entry(f)
        node_gradient, mixed = np.zeros((nn, nq)), np.zeros((nn, nq, self.np))
        corner, parameter_gradient = np.zeros((self.np, self.np)), np.zeros(self.np)
        deep, shallow = pairs.deep[pairs.parameters] - nq, pairs.shallow[pairs.parameters] - nq
        for equations, stretch in parts:
            cost += equations.cost
            products = equations.products(coordinates, coordinates)
            entries = np.take(products.reshape(len(products), nq**2), self._place, axis=1)
            blocks[stretch.nodes] += (stretch.products @ entries).reshape(
                -1, ORDER, entries.shape[1]
            )
            stretch.add_gradient(node_gradient, equations.gradient[:nq])
            if self.np:
                # H_kl is J_k . Y_l J_l with l the later of the two in the chain: which one that is
                # the masks tell
                chosen = equations.products(coordinates, parameters)
                chosen *= self._later
                chosen += (
                    equations.products(parameters, coordinates).transpose(0, 2, 1) * self._earlier
                )
                summed = stretch.weights @ chosen.reshape(len(chosen), nq * self.np)
                mixed[stretch.nodes] += summed.reshape(-1, nq, self.np)
                corner[shallow, deep] += equations.total(parameters)[shallow, deep]
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
        # A coordinate that moves no marker would leave a zero on the diagonal: with one there it
        # stays where it is.
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
    """Cholesky factor L of H_qq + damping * diagonal (+ a floor where nothing determines a node).

    Many right sides at once are solved in dense blocks of the width of the band, so that only
    neighbours are coupled, L = [D; E D; E D; ...]: LAPACK's own routine takes them one by one, in a
    multiple of the time.
    """

    def __init__(self, band: Array, damping: float = 0.0, *, overwrite: bool = False) -> None:
        """`overwrite`: the factor takes the place of `band`, which saves its size in memory;
        LinAlgError if there is none, where otherwise a larger floor would be tried.
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
        """H_qq^-1 right, for right (n,) or (n, k)."""
        if right.ndim == 1:
            return lapack.dpbtrs(self.factor, right, lower=1)[0]
        return self.backward(self.forward(right))

    def forward(self, right: Array) -> Array:
        """L^-1 right, for right (n,) or (n, k)."""
        if right.ndim == 1:
            return blas.dtbsv(len(self.factor) - 1, self.factor, right, lower=1, trans=0)
        out = np.array(right, order="C")
        for rows in self._blocks():
            if rows.start:
                before = slice(rows.start - len(self.factor), rows.start)
                out[rows] -= self._coupling(before.start) @ out[before]
            out[rows] = self._divided(rows, out[rows], transposed=1)
        return out

    def backward(self, right: Array) -> Array:
        """L^-T right, for right (n,) or (n, k)."""
        if right.ndim == 1:
            return blas.dtbsv(len(self.factor) - 1, self.factor, right, lower=1, trans=1)
        out, n = np.array(right, order="C"), len(right)
        for rows in reversed(list(self._blocks())):
            if rows.stop < n:
                out[rows] -= (
                    self._coupling(rows.start).T @ out[rows.stop : rows.stop + len(self.factor)]
                )
            out[rows] = self._divided(rows, out[rows], transposed=0)
        return out

    def _blocks(self) -> Iterator[slice]:
        width, n = self.factor.shape
        return (slice(first, min(first + width, n)) for first in range(0, n, width))

    def _divided(self, block: slice, rows: Array, *, transposed: int) -> Array:
        """D^-1 rows (`transposed` = 1, as D stands on the right of the rows' transpose) or D^-T
        rows.
        """
        size = block.stop - block.start
        return blas.dtrsm(
            1.0,
            self._dense(block.start, 0, size, size),
            rows.T,
            side=1,
            lower=1,
            trans_a=transposed,
        ).T

    def _coupling(self, first: int) -> Array:
        """E of the rows after a block and the columns of the block that begins at `first`."""
        width, n = self.factor.shape
        return np.triu(self._dense(first, width, min(width, n - first - width), width), 1)

    def _dense(self, first: int, below: int, rows: int, columns: int) -> Array:
        """A part of L as a matrix, from column `first` and so far below the diagonal; what is
        beyond the band or above the diagonal means nothing.
        """
        width = len(self.factor)
        flat, size = self.factor.T.reshape(-1)[first * width + below :], self.factor.itemsize
        return as_strided(flat, (rows, columns), (size, size * (width - 1)), writeable=False)


@dataclass(frozen=True)
class Elimination:
    """One trial, its coefficients eliminated."""

    factor: BandFactor  # of H_t
    halfway: Array  # (nn * nq, np_t) Y
    hessian: Array  # (np_t, np_t) H_pp - C_t^T X_t

    @cached_property
    def sensitivity(self) -> Array:
        """(nn * nq, np_t) X_t."""
        return self.factor.backward(self.halfway)

    def follow(self, change: Array) -> Array:
        """(nn * nq,) X_t dp."""
        return self.factor.backward(self.halfway @ change)

    def reduced(self, node_gradient: Array, parameter_gradient: Array) -> Array:
        """(np_t,) half gradient by the parameters, nodes following; from half gradients at one
        point.
        """
        return parameter_gradient - self.halfway.T @ self.factor.forward(node_gradient.ravel())


def eliminate(equations: NormalEquations, damping: float = 0.0) -> Elimination:
    """Eliminate the coefficients of one trial; `damping` is relative to the diagonals of H_t and
    H_pp.
    """
    factor = BandFactor(equations.band, damping)
    halfway = factor.forward(equations.mixed) if equations.mixed.shape[1] else equations.mixed
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
    """What is known of the shared parameters besides the trials: |L (p - c)|^2."""

    cost: float
    gradient: Array  # (np,) half of it, L^T L (p - c)
    matrix: Array  # (np, np) L^T L


class ArrowEquations:
    """Equations of several trials at x = (p, coefficients of each trial), as `descend` asks for
    them.

    `columns`: per trial, places (np_t,) of its own parameters among the shared ones.
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
        """With the nodes of every trial eliminated."""
        return ArrowFactor(
            [eliminate(trial, damping) for trial in self.trials], self.columns, self.prior.matrix
        )


class ArrowFactor:
    """Solves for parameters and nodes together."""

    def __init__(
        self, trials: Sequence[Elimination], columns: Sequence[IntArray], prior: Array
    ) -> None:
        self.trials, self.columns = trials, columns
        self.schur = prior.copy()
        for trial, places in zip(trials, columns, strict=True):
            self.schur[np.ix_(places, places)] += trial.hessian
        self.schur += ROUNDING * np.trace(self.schur) * np.eye(len(prior))

    def solve(self, gradient: Array) -> Array:
        """The whole matrix' inverse times `gradient`, both in the order of x."""
        size = len(self.schur)
        ends = size + np.cumsum([0, *(len(trial.halfway) for trial in self.trials)])
        halfway = [
            t.factor.forward(gradient[a:b])
            for t, (a, b) in zip(self.trials, pairwise(ends), strict=True)
        ]
        right = gradient[:size].copy()
        for trial, places, of_trial in zip(self.trials, self.columns, halfway, strict=True):
            right[places] -= trial.halfway.T @ of_trial
        shared = np.linalg.solve(self.schur, right)
        coefficients = [
            trial.factor.backward(of_trial - trial.halfway @ shared[places])
            for trial, places, of_trial in zip(self.trials, self.columns, halfway, strict=True)
        ]
        return np.concatenate([shared, *coefficients])
