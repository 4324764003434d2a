"""Normal equations of a whole trial: a block band for the nodes, an arrow for the joint parameters.

    [ H_qq  H_qp ] [dN]     [g_q]        H_qq: node-major, half-bandwidth 6 nq - 1 (six splines overlap)
    [ H_pq  H_pp ] [dp] = - [g_p]

H_qq dN = -g_q is solved by LAPACK's banded Cholesky factorisation; the joint parameters by the Schur complement
S = H_pp - H_pq H_qq^-1 H_qp. Memory is 8 * 6 nq^2 bytes a node, whatever the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from gaitcal.motion.marker_residual import FrameEquations, VariablePairs
from gaitcal.motion.spline import ORDER, SplineBasis

Array = NDArray[np.float64]

_NODE_PAIRS = [(a, b) for a in range(ORDER) for b in range(a + 1)]
_HIGH = np.array([a for a, _ in _NODE_PAIRS])
_LOW = np.array([b for _, b in _NODE_PAIRS])


@dataclass(frozen=True)
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


class Assembler:
    """Sums frame equations into normal equations; the pattern is worked out once for a chain and a basis."""

    def __init__(self, pairs: VariablePairs, coordinates: int, parameters: int, basis: SplineBasis) -> None:
        self.nq, self.np, self.basis, self.pairs = coordinates, parameters, basis, pairs
        i, j = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        self._i, self._j = i, j
        off = i != j
        self._mirror = np.flatnonzero(off)
        self._weights = [
            (first, frames, _node_products(basis.value[frames]), np.ascontiguousarray(basis.value[frames].T))
            for first, frames in basis.spans
        ]
        self._idle = np.flatnonzero(~pairs.active[:coordinates])

    def empty(self) -> _Sums:
        """Zero sums to add frames to."""
        nn = self.basis.nodes
        return _Sums(
            np.zeros((nn, ORDER, len(self._i))),
            np.zeros((nn, self.nq, self.np)),
            np.zeros((self.np, self.np)),
            np.zeros((nn, self.nq)),
            np.zeros(self.np),
        )

    def spans(self, most_frames: int) -> list[list[int]]:
        """Spans in groups of at most about `most_frames` frames, to bound memory."""
        groups: list[list[int]] = [[]]
        count = 0
        for k, (_, frames, _, _) in enumerate(self._weights):
            size = frames.stop - frames.start
            if groups[-1] and count + size > most_frames:
                groups.append([])
                count = 0
            groups[-1].append(k)
            count += size
        return groups

    def frames(self, group: list[int]) -> slice:
        """Frames of a group of spans."""
        return slice(self._weights[group[0]][1].start, self._weights[group[-1]][1].stop)

    def add(self, sums: _Sums, equations: FrameEquations, group: list[int]) -> None:
        """Add the frames of a group of spans."""
        start = self._weights[group[0]][1].start
        coordinates = np.ascontiguousarray(equations.hessian[:, self.pairs.coordinates])
        self.add_gradient(sums.node_gradient, equations.gradient[: self.nq], group)
        mixed = self._mixed(equations) if self.np else None
        for k in group:
            first, frames, products, weights = self._weights[k]
            local = slice(frames.start - start, frames.stop - start)
            blocks = products @ coordinates[local]
            sums.blocks[first + _LOW, _HIGH - _LOW] += blocks
            if mixed is not None:
                sums.mixed[first : first + ORDER] += (weights @ mixed[local]).reshape(ORDER, self.nq, self.np)
        if self.np:
            i, j = self.pairs.first[self.pairs.parameters] - self.nq, self.pairs.second[self.pairs.parameters] - self.nq
            totals = equations.hessian[:, self.pairs.parameters].sum(axis=0)
            sums.parameters[i, j] += totals
            sums.parameters[j[i != j], i[i != j]] += totals[i != j]
            sums.parameter_gradient[:] += equations.gradient[self.nq :].sum(axis=1)

    def add_gradient(self, out: Array, gradient: Array, group: list[int]) -> None:
        """Add the half gradient (nq, frames of the group) of the coordinates to that of the nodes (nn, nq)."""
        start = self._weights[group[0]][1].start
        by_frame = np.ascontiguousarray(gradient.T)
        for k in group:
            first, frames, _, weights = self._weights[k]
            out[first : first + ORDER] += weights @ by_frame[frames.start - start : frames.stop - start]

    def _mixed(self, equations: FrameEquations) -> Array:
        nf = len(equations.hessian)
        out = np.zeros((nf, self.nq * self.np))
        which = self.pairs.mixed
        place = self.pairs.second[which] * self.np + self.pairs.first[which] - self.nq
        out[:, place] = equations.hessian[:, which]
        return out

    def finish(self, sums: _Sums, cost: float) -> NormalEquations:
        """The sums as a banded matrix; coordinates that move no marker get a unit diagonal."""
        nn, nq = self.basis.nodes, self.nq
        band = np.zeros((nn, nq, ORDER * nq))
        i, j, mirror = self._i, self._j, self._mirror
        for d in range(ORDER):
            band[:, j, d * nq + i - j] = sums.blocks[:, d]
            if d:
                band[:, i[mirror], d * nq + j[mirror] - i[mirror]] = sums.blocks[:, d, mirror]
        band[:, self._idle, 0] = 1.0
        return NormalEquations(
            cost,
            band.reshape(nn * nq, ORDER * nq),
            sums.mixed.reshape(nn * nq, self.np),
            sums.parameters,
            sums.node_gradient,
            sums.parameter_gradient,
        )


@dataclass(frozen=True)
class _Sums:
    blocks: Array
    mixed: Array
    parameters: Array
    node_gradient: Array
    parameter_gradient: Array


def _node_products(weights: Array) -> Array:
    """(21, nf) products of the weights of two nodes."""
    return np.ascontiguousarray((weights[:, _HIGH] * weights[:, _LOW]).T)


class BandFactor:
    """Cholesky factor of H_qq + damping * diagonal (+ a floor where nothing determines a node)."""

    def __init__(self, band: Array, damping: float = 0.0, *, overwrite: bool = False) -> None:
        """`overwrite`: the factor takes the place of `band`, which saves its size in memory; LinAlgError if there is
        none, where otherwise a larger floor would be tried.
        """
        copy = band if overwrite else band.copy()
        diagonal = copy[:, 0]
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
        solution, _ = lapack.dpbtrs(self.factor, right, lower=1)
        out: Array = solution
        return out
