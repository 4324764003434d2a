"""Coordinates in time: clamped quintic B-splines on uniform knots, and their smoothing penalty.

    q(t) = sum_a b_a(t) n_a,        six non-zero basis functions at any t,

n_a the control points (spline coefficients), (nn, nq). With nn control points there are nn - 5
spans. Velocities and accelerations are the exact derivatives. Method: Reinbolt et al. 2007 (20
control points for each coordinate); knots after de Boor, clamped and uniform.

The penalty that limits the bandwidth of a motion, whatever the number of its control points,

    tr(N^T R N K),
    R_ab = int b_a''' b_b''' + (2 pi f_0)^4 b_a' b_b' dt,
    K = rate (2 pi f)^-6 W

is added to the marker cost: P-splines with a penalty on derivatives (O'Sullivan 1986; Eilers and
Marx 1996). W (nq, nq) is the information of one frame's markers on the coordinates
(`bandwidth.py`). If every frame had the information W, an oscillation of nu Hz would pass with the
gain 1 / (1 + (nu / f)^6), in every coordinate alike: half of it at f, 71 % (-3 dB) at 0.863 f. The
second term is a weak tension, negligible for movements (5e-7 at 1 Hz for f = 7 Hz). Without it,
coordinates would follow a parabola through long gaps and beyond the last observed frame.

A derivative of a spline is a spline with the coefficients D n. R is therefore a sum of D^T Q D,
with Q the products of B-splines of lower degree. Cost and gradient are computed from D N, as the
large entries of R would cancel in R N.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csc_array, csr_array, diags_array, eye_array

from gaitcal.arrays import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

DEGREE = 5
ORDER = DEGREE + 1
FLOOR, GAP_FLOOR = (1e-12, 1e-9)
"""Part of the largest diagonal entry that is added to all, for control points that no frame
reaches: without and with frames of weight zero.
"""
MINIMUM_NODES = ORDER
FRAMES_AT_ONCE = 256
"""Frames in one block: bounds memory, and keeps the working set in the cache of the processor."""
_LOW, _DISTANCE = np.array(
    [(low, high - low) for low in range(ORDER) for high in range(low, ORDER)]
).T
"""(21,) each: the earlier of two of the six control points at a frame, and the distance to the
later one."""
NODES_PER_SECOND = 20.0
"""Knot spans per second of a trial that no penalty smooths: a quintic spline with spans h passes
frequencies up to about 0.48 / h (see `compute_cutoff`)."""
FRAMES_PER_SPAN = 3.0
"""Frames in a knot span, at least; slow cameras get longer spans."""
PENALISED = 3
"""Order of the penalised derivative: the jerk, which leaves accelerations free at the ends."""
HALF_POWER = float((np.sqrt(2.0) - 1.0) ** (1.0 / (2 * PENALISED)))
"""Frequency of -3 dB, in units of f."""
TENSION_HZ = 0.5
"""Hz, f_0: coordinates come to rest in a gap longer than about a third of a second."""
NODES_AT_ONCE = 256
"""Rows of the band in one block, to bound memory."""
KEPT_BYTES = 16 << 20
"""Bytes of the penalty's matrix up to which it is kept, as it is added many times."""


@dataclass(frozen=True, kw_only=True)
class SplineBasis:
    """B-spline basis at the frames of one trial."""

    time: Array  # (nf,) s
    knots: Array  # (nn + 6,) s
    first: IntArray  # (nf,) index of the first of the six control points that matter at a frame
    value: Array  # (nf, 6) their weights
    rate: Array  # (nf, 6) 1/s, weights for the first derivative
    acceleration: Array  # (nf, 6) 1/s^2, weights for the second derivative

    @property
    def control_points(self) -> int:
        """Number of control points of a coordinate."""
        return len(self.knots) - ORDER

    @cached_property
    def spans(self) -> list[tuple[int, slice]]:
        """(first control point, consecutive frames) of each knot span that holds frames."""
        edges = np.flatnonzero(np.diff(self.first)) + 1
        bounds = [0, *edges.tolist(), len(self.first)]
        return [(int(self.first[a]), slice(a, b)) for a, b in pairwise(bounds)]

    def select_frames(self, frames: IntArray) -> "SplineBasis":
        """Return the same splines at some of the frames (increasing indices)."""
        return replace(
            self,
            time=self.time[frames],
            first=self.first[frames],
            value=self.value[frames],
            rate=self.rate[frames],
            acceleration=self.acceleration[frames],
        )

    @cached_property
    def stretches(self) -> "tuple[FrameBlock, ...]":
        """All frames, in blocks."""
        frames = len(self.time)
        starts = range(0, frames, FRAMES_AT_ONCE)
        return tuple(
            FrameBlock(self, slice(start, min(start + FRAMES_AT_ONCE, frames))) for start in starts
        )

    def evaluate(self, coefficients: Array, derivative: int = 0) -> Array:
        """Evaluate the splines or a time derivative.

        Parameters
        ----------
        coefficients
            (nn, nq).
        derivative
            0, 1 or 2.

        Returns
        -------
        (nf, nq) array
        """
        return self.matrices[derivative] @ coefficients

    @cached_property
    def matrices(self) -> tuple[csr_array, ...]:
        """(nf, nn) each: values, first and second derivatives from control points."""
        nf = len(self.time)
        columns = (self.first[:, None] + np.arange(ORDER)).ravel()
        ends = np.arange(0, ORDER * nf + 1, ORDER)
        parts = (self.value, self.rate, self.acceleration)
        return tuple(
            csr_array((weights.ravel(), columns, ends), shape=(nf, self.control_points))
            for weights in parts
        )

    def fit(self, samples: Array, weight: Array | None = None) -> Array:
        """Fit coefficients to samples by least squares.

        Parameters
        ----------
        samples
            (nf, nq), finite.
        weight
            (nf,) of the frames; one unless given.

        Returns
        -------
        (nn, nq) array
            Zero for control points that no weighted frame reaches.
        """
        nn, value = self.control_points, self.value
        weighted = value if weight is None else weight[:, None] * value
        band, right = np.zeros((ORDER, nn)), np.zeros((nn, samples.shape[1]))
        grams = np.add.reduceat(
            value[:, :, None] * weighted[:, None, :],
            [frames.start for _, frames in self.spans],
            axis=0,
        )
        firsts = np.array([first for first, _ in self.spans])
        for d in range(ORDER):
            np.add.at(
                band[d],
                firsts[:, None] + np.arange(ORDER - d),
                np.diagonal(grams, -d, axis1=1, axis2=2),
            )
        for first, frames in self.spans:
            right[first : first + ORDER] += weighted[frames].T @ samples[frames]
        band[0] += (FLOOR if weight is None else GAP_FLOOR) * band[0].max()
        return cho_solve_banded((cholesky_banded(band, lower=True), True), right)


class FrameBlock:
    """Consecutive frames, and sparse matrices that sum over them for each control point."""

    def __init__(self, basis: SplineBasis, frames: slice) -> None:
        self.frames = frames
        first, value = basis.first[frames], basis.value[frames]
        # those that matter at its frames
        self.nodes = slice(int(first[0]), int(first[-1]) + ORDER)
        count, nf = self.nodes.stop - self.nodes.start, len(first)
        local = (first - self.nodes.start)[:, None]
        self.weights = _build_frame_matrix(value, local + np.arange(ORDER), count, nf)
        """(nodes, frames) B_a(f)."""
        both = value[:, _LOW] * value[:, _LOW + _DISTANCE]
        self.products = _build_frame_matrix(
            both, (local + _LOW) * ORDER + _DISTANCE, count * ORDER, nf
        )
        """(6 nodes, frames) B_a(f) B_a+d(f), row 6 a + d."""

    def add_gradient(self, out: Array, gradient: Array) -> None:
        """Add the gradient (nq, frames) of coordinates to that of coefficients (nn, nq)."""
        out[self.nodes] += self.weights @ gradient.T


def _build_frame_matrix(values: Array, rows: IntArray, count: int, frames: int) -> csr_array:
    """Build (count, frames) from `values` (frames, k) at `rows` (frames, k)."""
    columns = np.arange(0, rows.size + 1, rows.shape[1])
    return csc_array((values.ravel(), rows.ravel(), columns), shape=(count, frames)).tocsr()


def build_spline_basis(time: Array, control_points: int) -> SplineBasis:
    """Build the basis over the frames of a trial.

    Parameters
    ----------
    time
        (nf,) s, increasing.
    control_points
        Number of control points, at least `MINIMUM_NODES`.

    Returns
    -------
    SplineBasis

    Raises
    ------
    ValueError
        There are fewer control points than one span needs.
    """
    if control_points < MINIMUM_NODES:
        raise ValueError(
            f"a quintic spline needs at least {MINIMUM_NODES} nodes, not {control_points}"
        )
    start, end = float(time[0]), float(time[-1])
    inner = np.linspace(start, end, control_points - DEGREE + 1)
    knots = np.concatenate([np.full(DEGREE, start), inner, np.full(DEGREE, end)])
    first = (
        np.clip(np.searchsorted(knots, time, side="right") - 1, DEGREE, control_points - 1) - DEGREE
    )
    value, rate, acceleration = (
        _compute_local_weights(knots, time, first + DEGREE, k) for k in range(3)
    )
    return SplineBasis(
        time=time,
        knots=knots,
        first=first.astype(np.intp),
        value=value,
        rate=rate,
        acceleration=acceleration,
    )


def _compute_local_weights(knots: Array, time: Array, span: IntArray, derivative: int) -> Array:
    """Compute (nf, 6) weights of the six control points for the k-th derivative.

    Notes
    ----- u_r = N_r / (t_{i+r+1} - t_{i-d+r+1}), with N_r the functions of degree d - 1 that are not
    zero in span i. The functions of degree d are  (t - t_{i-d+j}) u_{j-1} + (t_{i+j+1} - t) u_j ,
    their derivatives  d (u_{j-1} - u_j)  (de Boor). The second rule raises the last `derivative` of
    the five degrees.
    """
    # (nf, 10) knots t_{i-4} ... t_{i+5}
    around = knots[span[:, None] + np.arange(-DEGREE + 1, DEGREE + 1)]
    now, middle = time[:, None], DEGREE - 1
    functions = np.ones((len(time), 1))
    for d in range(1, ORDER):
        right, left = around[:, middle + 1 : middle + d + 1], around[:, middle - d + 1 : middle + 1]
        u = functions / (right - left)
        raising, falling = (now - left, right - now) if d <= DEGREE - derivative else (d, -d)
        functions = np.zeros((len(time), d + 1))
        functions[:, 1:] = raising * u
        functions[:, :-1] += falling * u
    return functions


def convert_to_bspline(basis: SplineBasis, coefficients: Array) -> "BSpline":
    """Convert a spline to a SciPy object, for evaluation at any time of the trial."""
    # loads a tenth of a second of other modules
    from scipy.interpolate import BSpline

    return BSpline(basis.knots, coefficients, DEGREE)


@dataclass(frozen=True)
class ControlPointRule:
    """Rule for the number of control points of a trial."""

    per_second: float = NODES_PER_SECOND
    # A fixed number of control points a coordinate (20 in the published protocol)
    fixed: int | None = None

    def count_control_points(self, time: Array) -> int:
        """Count the control points of a trial.

        Parameters
        ----------
        time
            (nf,) s.

        Returns
        -------
        int
        """
        if self.fixed is not None:
            return self.fixed
        spans = min(float(time[-1] - time[0]) * self.per_second, len(time) / FRAMES_PER_SPAN)
        return max(round(spans), 1) + MINIMUM_NODES - 1


def compute_cutoff(time: Array, nodes: int) -> float:
    """Compute the frequency (Hz) at which a least-squares quintic spline passes 71 % (-3 dB).

    Notes
    ----- For spans h the amplitude kept at frequency f is 1 / (1 + sum_k (f h / (f h + k))^12), k =
    -1, 1, -2, ... (Unser, Aldroubi and Eden 1993): 0.4816 / h.
    """
    return 0.4816 * (nodes - MINIMUM_NODES + 1) / float(time[-1] - time[0])


def compute_frame_rate(basis: SplineBasis) -> float:
    """Compute the mean frame rate (Hz) of a trial."""
    return (len(basis.time) - 1) / float(basis.time[-1] - basis.time[0])


def select_spaced_frames(count: int, most: int) -> IntArray:
    """Select at most `most` of `count` frames, evenly spaced."""
    return np.unique(np.round(np.linspace(0, count - 1, most)).astype(np.intp))


@dataclass(frozen=True)
class Roughness:
    """Matrix R on some knots, as a sum of D^T Q D."""

    terms: tuple[tuple[csr_array, csr_array, csr_array], ...]
    """D^T (nn, nn - k), Q (nn - k, nn - k) and D, k being the derivative."""

    @cached_property
    def matrix(self) -> csr_array:
        """(nn, nn) R."""
        return csr_array(sum(by_node.T @ products @ by_node for _, products, by_node in self.terms))

    @cached_property
    def band(self) -> Array:
        """(nn, 6) R[a, a + d]."""
        out = np.zeros((self.matrix.shape[0], ORDER))
        for d in range(ORDER):
            diagonal = self.matrix.diagonal(d)
            out[: len(diagonal), d] = diagonal
        return out

    def evaluate(self, coefficients: Array, coupling: Array) -> tuple[float, Array]:
        """Compute tr(N^T R N K) and R N K.

        Parameters
        ----------
        coefficients
            (nn, k) N.
        coupling
            (k, k) K.

        Returns
        -------
        float
        (nn, k) array
        """
        cost, out = 0.0, np.zeros_like(coefficients)
        for back, products, by_node in self.terms:
            values = by_node @ coefficients
            pull = products @ values @ coupling
            cost += float(np.vdot(values, pull))
            out += back @ pull
        return cost, out


@lru_cache(maxsize=16)
def _build_roughness(stored: bytes) -> Roughness:
    """Build R once for all trials with the same knots."""
    knots = np.frombuffer(stored)
    terms = []
    for order, factor in (
        (PENALISED, 1.0),
        (1, float(2 * np.pi * TENSION_HZ) ** (2 * PENALISED - 2)),
    ):
        by_node = build_derivative_matrix(knots, order)
        terms.append(
            (by_node.T.tocsr(), csr_array(factor * build_product_matrix(knots, order)), by_node)
        )
    return Roughness(tuple(terms))


def build_roughness(knots: Array) -> Roughness:
    """Build R of quintic splines on `knots` (nn + 6,) s."""
    return _build_roughness(knots.tobytes())


def build_derivative_matrix(knots: Array, order: int) -> csr_array:
    """Build (nn - k, nn) D: coefficients of the k-th derivative, by differences (de Boor)."""
    out = eye_array(len(knots) - ORDER, format="csr")
    for k in range(order):
        degree, inner = DEGREE - k, knots[k : len(knots) - k]
        count = out.shape[0] - 1
        scale = degree / (inner[1 + degree : 1 + degree + count] - inner[1 : 1 + count])
        out = diags_array(scale) @ (out[1:] - out[:-1])
    return csr_array(out)


def build_product_matrix(knots: Array, order: int) -> csr_array:
    """Build (nn - k, nn - k) Q of the k-th derivative, exact by Gauss points in every span."""
    # only fits ask for it
    from scipy.interpolate import BSpline

    degree, inner = DEGREE - order, knots[order : len(knots) - order]
    edges = inner[degree : len(inner) - degree]
    x, w = np.polynomial.legendre.leggauss(degree + 1)
    half = 0.5 * np.diff(edges)
    points = (edges[:-1, None] + half[:, None] * (1.0 + x)).ravel()
    values = BSpline.design_matrix(points, inner, degree)
    return csr_array(values.T @ diags_array((half[:, None] * w).ravel()) @ values)


def compute_stiffness(basis: SplineBasis, cutoff_hz: float) -> float:
    """Compute rate (2 pi f)^-6, in s^5."""
    omega = 2 * np.pi * cutoff_hz
    return compute_frame_rate(basis) / omega ** (2 * PENALISED)


@dataclass(frozen=True, kw_only=True)
class Smoothing:
    """Smoothing penalty of one trial, m^2."""

    roughness: Roughness  # of its knots, 1/s^5
    coupling: Array  # (nq, nq) K
    cutoff_hz: float  # f: half of an oscillation at it passes

    def restrict_to(self, active: BoolArray) -> "Smoothing":
        """Return the penalty without the coordinates that are not `active` (nq,).

        Those keep their values, as nothing else moves them.
        """
        if active.all():
            # with all that is worked out already
            return self
        return replace(self, coupling=np.where(active[:, None] & active, self.coupling, 0.0))

    def scale_cost(self, share: float) -> "Smoothing":
        """Multiply the penalty by `share`."""
        return replace(self, coupling=share * self.coupling)

    def evaluate(self, coefficients: Array) -> tuple[float, Array]:
        """Compute the cost (m^2) and (nn, nq) half its gradient, at coefficients (nn, nq)."""
        return self.roughness.evaluate(coefficients, self.coupling)

    def add_to(self, band: Array, coefficients: Array) -> None:
        """Add half the Hessian, the same at all coefficients, to a band in place.

        Parameters
        ----------
        band
            (nn * nq, 6 nq) as in `NormalEquations`.
        coefficients
            Not used, as the penalty is quadratic; `CoefficientPrior.add_to` needs them.
        """
        if band.nbytes <= KEPT_BYTES:
            band += self._whole
        else:
            self._add_blocks(band)

    @cached_property
    def _whole(self) -> Array:
        """(nn * nq, 6 nq) half the Hessian."""
        nq = len(self.coupling)
        out = np.zeros((len(self.roughness.band) * nq, ORDER * nq))
        self._add_blocks(out)
        return out

    def _add_blocks(self, band: Array) -> None:
        nq, rough = len(self.coupling), self.roughness.band
        blocks = band.reshape(-1, nq, ORDER * nq)
        j, i = np.indices((nq, nq))
        # Of node blocks a, a + d the entry (coordinate j, coordinate i) stands at column d nq + i -
        # j of row j.
        for d in range(ORDER):
            low = d * nq - (nq - 1) if d else 0
            pattern = np.zeros((nq, (d + 1) * nq - low))
            kept = (i >= j) if d == 0 else np.full(i.shape, True)
            pattern[j[kept], (d * nq + i - j - low)[kept]] = self.coupling[j[kept], i[kept]]
            for start in range(0, len(blocks), NODES_AT_ONCE):
                part = slice(start, start + NODES_AT_ONCE)
                blocks[part, :, low : low + pattern.shape[1]] += (
                    rough[part, d, None, None] * pattern
                )


def build_smoothing(basis: SplineBasis, information: Array, cutoff_hz: float) -> Smoothing:
    """Build the penalty that passes half of an oscillation at a cut-off.

    Parameters
    ----------
    basis
        Splines of the trial.
    information
        (nq, nq) W.
    cutoff_hz
        Hz, f.

    Returns
    -------
    Smoothing
    """
    coupling = compute_stiffness(basis, cutoff_hz) * information
    return Smoothing(roughness=build_roughness(basis.knots), coupling=coupling, cutoff_hz=cutoff_hz)
