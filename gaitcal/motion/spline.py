"""Coordinates in time: clamped quintic B-splines on uniform knots.

    q(t) = sum_a b_a(t) n_a,        six non-zero basis functions at any t,

n_a the nodes (control values), (nn, nq). With nn nodes there are nn - 5 spans. Velocities and accelerations are the
exact derivatives. Method: Reinbolt et al. 2007 (20 nodes a coordinate); knots after de Boor, clamped and uniform.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csc_array, csr_array

from gaitcal.arrays import Array, IntArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

DEGREE = 5
ORDER = DEGREE + 1
MINIMUM_NODES = ORDER
FRAMES_AT_ONCE = 256
"""Frames worked on together: bounds memory, and keeps the working set in the processor's cache."""
_LOW, _APART = np.array([(low, high - low) for low in range(ORDER) for high in range(low, ORDER)]).T
"""(21,) each: the earlier of two of the six nodes at a frame, and how far the other comes after it."""


@dataclass(frozen=True, kw_only=True)
class SplineBasis:
    """The basis at the frames of one trial."""

    time: Array
    """(nf,) s."""
    knots: Array
    """(nn + 6,) s."""
    first: IntArray
    """(nf,) index of the first of the six nodes that matter at a frame."""
    value: Array
    """(nf, 6) their weights."""
    rate: Array
    """(nf, 6) 1/s, weights for the first derivative."""
    acceleration: Array
    """(nf, 6) 1/s^2, weights for the second derivative."""

    @property
    def nodes(self) -> int:
        """Number of nodes a coordinate."""
        return len(self.knots) - ORDER

    @cached_property
    def spans(self) -> list[tuple[int, slice]]:
        """(first node, frames) of each knot span that holds frames; frames of a span are consecutive."""
        edges = np.flatnonzero(np.diff(self.first)) + 1
        bounds = [0, *edges.tolist(), len(self.first)]
        return [(int(self.first[a]), slice(a, b)) for a, b in pairwise(bounds)]

    def at(self, frames: IntArray) -> SplineBasis:
        """The same splines at some of the frames (increasing)."""
        return SplineBasis(
            time=self.time[frames],
            knots=self.knots,
            first=self.first[frames],
            value=self.value[frames],
            rate=self.rate[frames],
            acceleration=self.acceleration[frames],
        )

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """All frames, in stretches to work on one after the other."""
        frames = len(self.time)
        starts = range(0, frames, FRAMES_AT_ONCE)
        return tuple(Stretch(self, slice(start, min(start + FRAMES_AT_ONCE, frames))) for start in starts)

    def evaluate(self, nodes: Array, derivative: int = 0) -> Array:
        """(nf, nq) coordinates, or their first or second time derivative, for nodes (nn, nq)."""
        out: Array = self.matrices[derivative] @ nodes
        return out

    @cached_property
    def matrices(self) -> tuple[csr_array, csr_array, csr_array]:
        """(nf, nn) each: values, first and second derivatives from nodes."""
        nf = len(self.time)
        columns = (self.first[:, None] + np.arange(ORDER)).ravel()
        ends = np.arange(0, ORDER * nf + 1, ORDER)
        values, rates, accelerations = (
            csr_array((weights.ravel(), columns, ends), shape=(nf, self.nodes))
            for weights in (self.value, self.rate, self.acceleration)
        )
        return values, rates, accelerations

    def fit(self, samples: Array) -> Array:
        """(nn, nq) nodes that fit samples (nf, nq) in the least-squares sense. Samples must be finite."""
        nn = self.nodes
        band, right = np.zeros((ORDER, nn)), np.zeros((nn, samples.shape[1]))
        spans = self.spans
        edges = [frames.start for _, frames in spans]
        grams = np.add.reduceat(self.value[:, :, None] * self.value[:, None, :], edges, axis=0)
        firsts = np.array([first for first, _ in spans])
        for d in range(ORDER):
            np.add.at(band[d], firsts[:, None] + np.arange(ORDER - d), np.diagonal(grams, -d, axis1=1, axis2=2))
        for first, frames in spans:
            right[first : first + ORDER] += self.value[frames].T @ samples[frames]
        band[0] += 1e-12 * band[0].max()
        solution: Array = cho_solve_banded((cholesky_banded(band, lower=True), True), right)
        return solution


class Stretch:
    """Frames in a row, and the sums over them that give the nodes what is theirs, as sparse matrices."""

    def __init__(self, basis: SplineBasis, frames: slice) -> None:
        self.frames = frames
        first, value = basis.first[frames], basis.value[frames]
        self.nodes = slice(int(first[0]), int(first[-1]) + ORDER)
        """Those that matter at its frames."""
        count, nf = self.nodes.stop - self.nodes.start, len(first)
        local = (first - self.nodes.start)[:, None]
        self.weights = _by_row(value, local + np.arange(ORDER), count, nf)
        """(nodes, frames) B_a(f)."""
        both = value[:, _LOW] * value[:, _LOW + _APART]
        self.products = _by_row(both, (local + _LOW) * ORDER + _APART, count * ORDER, nf)
        """(6 nodes, frames) B_a(f) B_a+d(f), row 6 a + d."""

    def add_gradient(self, out: Array, gradient: Array) -> None:
        """Add the half gradient (nq, frames) of the coordinates to that of the nodes (nn, nq)."""
        out[self.nodes] += self.weights @ gradient.T


def _by_row(values: Array, rows: IntArray, count: int, frames: int) -> csr_array:
    """(count, frames) of `values` (frames, k) that stand in `rows` (frames, k), each in the column of its frame."""
    columns = np.arange(0, rows.size + 1, rows.shape[1])
    by_column = csc_array((values.ravel(), rows.ravel(), columns), shape=(count, frames))
    return by_column.tocsr()


def spline_basis(time: Array, nodes: int) -> SplineBasis:
    """The basis for `nodes` nodes over the frames at `time` (s, increasing)."""
    if nodes < MINIMUM_NODES:
        raise ValueError(f"a quintic spline needs at least {MINIMUM_NODES} nodes, not {nodes}")
    start, end = float(time[0]), float(time[-1])
    inner = np.linspace(start, end, nodes - DEGREE + 1)
    knots = np.concatenate([np.full(DEGREE, start), inner, np.full(DEGREE, end)])
    first = np.clip(np.searchsorted(knots, time, side="right") - 1, DEGREE, nodes - 1) - DEGREE
    value, rate, acceleration = (_local_weights(knots, time, first + DEGREE, k) for k in range(3))
    return SplineBasis(
        time=time, knots=knots, first=first.astype(np.intp), value=value, rate=rate, acceleration=acceleration
    )


def _local_weights(knots: Array, time: Array, span: IntArray, derivative: int) -> Array:
    """(nf, 6) weights of the six nodes for the k-th derivative.

    With u_r = N_r / (t_{i+r+1} - t_{i-d+r+1}), N_r the functions of degree d - 1 that matter in span i, those of degree
    d are  (t - t_{i-d+j}) u_{j-1} + (t_{i+j+1} - t) u_j  and their derivatives  d (u_{j-1} - u_j)  (de Boor); the last
    `derivative` of the five degrees are raised by the second rule.
    """
    around = knots[span[:, None] + np.arange(-DEGREE + 1, DEGREE + 1)]
    """(nf, 10) knots t_{i-4} ... t_{i+5}."""
    now, middle = time[:, None], DEGREE - 1
    functions = np.ones((len(time), 1))
    for d in range(1, ORDER):
        right, left = around[:, middle + 1 : middle + d + 1], around[:, middle - d + 1 : middle + 1]
        u = functions / (right - left)
        functions = np.zeros((len(time), d + 1))
        if d <= DEGREE - derivative:
            functions[:, 1:] = (now - left) * u
            functions[:, :-1] += (right - now) * u
        else:
            functions[:, 1:] = d * u
            functions[:, :-1] -= d * u
    return functions


def basis_matrix(basis: SplineBasis, derivative: int = 0) -> csr_array:
    """(nf, nn) the basis, or a derivative of it, as a sparse matrix."""
    return basis.matrices[derivative]


def to_bspline(basis: SplineBasis, nodes: Array) -> BSpline:
    """The same spline as a SciPy object, for evaluation anywhere in the trial."""
    from scipy.interpolate import BSpline  # loads a tenth of a second of other modules

    return BSpline(basis.knots, nodes, DEGREE)
