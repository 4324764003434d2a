"""Normal equations of a whole trial: a block band for the nodes, an arrow for the joint parameters.

    [ H_qq  H_qp ] [dN]     [g_q]        H_qq: node-major, half-bandwidth 6 nq - 1 (six splines overlap)
    [ H_pq  H_pp ] [dp] = - [g_p]

H_qq dN = -g_q is solved by LAPACK's banded Cholesky factorisation; the joint parameters by the Schur complement
S = H_pp - H_pq H_qq^-1 H_qp. Memory is 8 * 6 nq^2 bytes a node, whatever the number of frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import blas, lapack

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.motion.marker_residual import FrameEquations, VariablePairs
from gaitcal.motion.spline import ORDER, SplineBasis, Stretch


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """Half gradient and Gauss-Newton matrix of one trial at given nodes and joint parameters."""

    cost: float
    band: Array
    """(nn * nq, 6 nq): transposed lower band of H_qq, LAPACK's layout column by column."""
    mixed: Array
    """(nn * nq, np) H_qp."""
    parameters: Array
    """(np, np) H_pp."""
    node_gradient: Array
    """(nn, nq)."""
    parameter_gradient: Array
    """(np,)."""

    def scaled(self, share: float) -> NormalEquations:
        """Those of `share` times the cost."""
        return NormalEquations(
            cost=share * self.cost,
            band=share * self.band,
            mixed=share * self.mixed,
            parameters=share * self.parameters,
            node_gradient=share * self.node_gradient,
            parameter_gradient=share * self.parameter_gradient,
        )


class Assembler:
    """Sums frame equations into normal equations; the pattern is worked out once for a chain and a basis."""

    def __init__(
        self,
        pairs: VariablePairs,
        coordinates: int,
        parameters: int,
        basis: SplineBasis,
        pulled: IntArray | None = None,
    ) -> None:
        """`pulled`: coordinates that something else than markers determines, if they move none."""
        self.nq, self.np, self.basis, self.pairs = coordinates, parameters, basis, pairs
        # Only pairs (i >= j) of coordinates that move a common marker have entries: about a third of nq (nq + 1) / 2.
        i, j = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        self._i, self._j = i, j
        self._place = pairs.shallow[pairs.coordinates] * coordinates + pairs.deep[pairs.coordinates]
        self._later, self._earlier = _mixed_masks(pairs, coordinates, parameters)
        off = i != j
        self._mirror = np.flatnonzero(off)
        idle = np.flatnonzero(~pairs.active[:coordinates])
        self._idle = idle if pulled is None else np.setdiff1d(idle, pulled)

    def empty(self) -> _Sums:
        """Zero sums to add frames to."""
        nn = self.basis.nodes
        return _Sums(
            blocks=np.zeros((nn, ORDER, len(self._i))),
            mixed=np.zeros((nn, self.nq, self.np)),
            parameters=np.zeros((self.np, self.np)),
            node_gradient=np.zeros((nn, self.nq)),
            parameter_gradient=np.zeros(self.np),
        )

    def add(self, sums: _Sums, equations: FrameEquations, stretch: Stretch) -> None:
        """Add the frames of a stretch."""
        nq = self.nq
        coordinates, parameters = slice(0, nq), slice(nq, nq + self.np)
        self.add_matrices(sums, equations.products(coordinates, coordinates), stretch)
        stretch.add_gradient(sums.node_gradient, equations.gradient[:nq])
        if self.np:
            self._add_mixed(sums.mixed, equations, stretch)
            totals, pairs = equations.total(parameters), self.pairs
            deep, shallow = pairs.deep[pairs.parameters] - nq, pairs.shallow[pairs.parameters] - nq
            sums.parameters[shallow, deep] += totals[shallow, deep]
            sums.parameters[deep, shallow] = sums.parameters[shallow, deep]
            sums.parameter_gradient[:] += equations.gradient[nq:].sum(axis=1)

    def add_matrices(self, sums: _Sums, matrices: Array, stretch: Stretch) -> None:
        """Add matrices (frames of the stretch, nq, nq) of the coordinates, entry (k, l) valid where l comes after k."""
        # entries (frames, pairs);  blocks[node a, d, pairs] = sum_f B_a(f) B_a+d(f) entries(f)
        entries = np.take(matrices.reshape(len(matrices), self.nq**2), self._place, axis=1)
        sums.blocks[stretch.nodes] += (stretch.products @ entries).reshape(-1, ORDER, entries.shape[1])

    def _add_mixed(self, out: Array, equations: FrameEquations, stretch: Stretch) -> None:
        """Add H_qp; for each pair the one of the two products whose second variable comes after its first."""
        nq = self.nq
        coordinates, parameters = slice(0, nq), slice(nq, nq + self.np)
        # H_kl is J_k . Y_l J_l with l the later of the two in the chain: which one that is the masks tell
        chosen = equations.products(coordinates, parameters)
        chosen *= self._later
        chosen += equations.products(parameters, coordinates).transpose(0, 2, 1) * self._earlier
        summed = stretch.weights @ chosen.reshape(len(chosen), nq * self.np)
        out[stretch.nodes] += summed.reshape(-1, nq, self.np)

    def finish(self, sums: _Sums, cost: float) -> NormalEquations:
        """The sums as a banded matrix; coordinates that move no marker get a unit diagonal."""
        nn, nq = self.basis.nodes, self.nq
        # Row (node a, coordinate j), column (node a + d, coordinate i) stands at band[a, j, d nq + i - j]: the distance
        # from the diagonal. A symmetric block of two nodes d > 0 needs its mirror image, on the diagonal (d = 0) not.
        band = np.zeros((nn, nq, ORDER * nq))
        i, j, mirror = self._i, self._j, self._mirror
        for d in range(ORDER):
            band[:, j, d * nq + i - j] = sums.blocks[:, d]
            if d:
                band[:, i[mirror], d * nq + j[mirror] - i[mirror]] = sums.blocks[:, d, mirror]
        # A coordinate that moves no marker would leave a zero on the diagonal: with one there it stays where it is.
        band[:, self._idle, 0] = 1.0
        return NormalEquations(
            cost=cost,
            band=band.reshape(nn * nq, ORDER * nq),
            mixed=sums.mixed.reshape(nn * nq, self.np),
            parameters=sums.parameters,
            node_gradient=sums.node_gradient,
            parameter_gradient=sums.parameter_gradient,
        )


@dataclass(frozen=True, kw_only=True)
class _Sums:
    blocks: Array
    mixed: Array
    parameters: Array
    node_gradient: Array
    parameter_gradient: Array


def _mixed_masks(pairs: VariablePairs, nq: int, parameters: int) -> tuple[Array, Array]:
    """(nq, np) 1 where the parameter comes after the coordinate, and 1 where it comes before it."""
    later, earlier = np.zeros((nq, parameters)), np.zeros((nq, parameters))
    deep, shallow = pairs.deep[pairs.mixed], pairs.shallow[pairs.mixed]
    after = deep >= nq
    later[shallow[after], deep[after] - nq] = 1.0
    earlier[deep[~after], shallow[~after] - nq] = 1.0
    return later, earlier


@lru_cache(maxsize=64)
def _above(size: int) -> BoolArray:
    """(size, size) above the diagonal."""
    return np.triu(np.ones((size, size), dtype=bool), 1)


class BandFactor:
    """Cholesky factor L of H_qq + damping * diagonal (+ a floor where nothing determines a node).

    Many right sides at once are solved in dense blocks of the width of the band: LAPACK's own routine takes them one by
    one, in a multiple of the time.
    """

    def __init__(self, band: Array, damping: float = 0.0, *, overwrite: bool = False) -> None:
        """`overwrite`: the factor takes the place of `band`, which saves its size in memory; LinAlgError if there is
        none, where otherwise a larger floor would be tried.
        """
        copy = band if overwrite else band.copy()
        diagonal = copy[:, 0]
        # Nodes in a gap of the markers have no entries: a floor far below any other entry keeps them where they are.
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
            solution, _ = lapack.dpbtrs(self.factor, right, lower=1)
            out: Array = solution
            return out
        return self.backward(self.forward(right))

    def forward(self, right: Array) -> Array:
        """L^-1 right, for right (n,) or (n, k)."""
        if right.ndim == 1:
            return self._one(right, transposed=0)
        out = np.array(right, order="C")
        for first, own in self._blocks():
            if first:
                before = slice(first - len(self.factor), first)
                out[own] -= self._coupling(before.start) @ out[before]
            out[own] = self._divided(own, out[own], transposed=1)
        return out

    def backward(self, right: Array) -> Array:
        """L^-T right, for right (n,) or (n, k)."""
        if right.ndim == 1:
            return self._one(right, transposed=1)
        out, n = np.array(right, order="C"), len(right)
        for first, own in reversed(list(self._blocks())):
            if own.stop < n:
                after = slice(own.stop, min(own.stop + len(self.factor), n))
                out[own] -= self._coupling(first).T @ out[after]
            out[own] = self._divided(own, out[own], transposed=0)
        return out

    def _one(self, right: Array, *, transposed: int) -> Array:
        out: Array = blas.dtbsv(len(self.factor) - 1, self.factor, right, lower=1, trans=transposed)
        return out

    def _blocks(self) -> Iterator[tuple[int, slice]]:
        """Rows in blocks of the width of the band, so that only neighbours are coupled: L = [D; E D; E D; ...]."""
        width, n = self.factor.shape
        return ((first, slice(first, min(first + width, n))) for first in range(0, n, width))

    def _divided(self, own: slice, rows: Array, *, transposed: int) -> Array:
        """D^-1 rows (`transposed` = 1, as D stands on the right of the rows' transpose) or D^-T rows."""
        block = self._dense(own.start, 0, own.stop - own.start, own.stop - own.start)
        out: Array = blas.dtrsm(1.0, block, rows.T, side=1, lower=1, trans_a=transposed).T
        return out

    def _coupling(self, first: int) -> Array:
        """E of the rows after a block and the columns of the block that begins at `first`."""
        width, n = self.factor.shape
        part = self._dense(first, width, min(width, n - first - width), width)
        return np.where(_above(width)[: len(part)], part, 0.0)

    def _dense(self, first: int, below: int, rows: int, columns: int) -> Array:
        """A part of L as a matrix, from column `first` and so far below the diagonal; what is beyond the band or above
        the diagonal means nothing.
        """
        width = len(self.factor)
        flat, size = self.factor.T.reshape(-1)[first * width + below :], self.factor.itemsize
        return as_strided(flat, (rows, columns), (size, size * (width - 1)), writeable=False)
