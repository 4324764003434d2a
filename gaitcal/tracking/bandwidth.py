"""The bandwidth of a trial, chosen by its markers.

A trial's motion is smoothed by the penalty of `spline.py`; one cut-off f serves all its
coordinates. With H_t = J^T W J of frame t, every marker with its mean weight over the trial,

    W = (mean_t (H_t + LEAST mean H)^-1)^-1

weighs the coordinates against each other. The trial is tracked once with dense nodes and the
highest cut-off that they do not limit: coordinates q (nf, nq), residuals r (nf, 3 nm), each times
the root of its weight. Smoothing by A(f) loses

    lost(f) = tr (q - A q)^T (q - A q) W    of the motion, and leaves    noise(f) = nq / (n - nq) tr r^T A r

of the noise, n the marker coordinates seen in a frame: each of the nq directions that the
coordinates can follow holds as much noise, at every frequency, as each of the n - nq directions
that only the residuals hold. f is where the error to be expected, lost + 2 noise less a constant,
is least (Mallows 1973, for noise of any colour).

Skin movement is slow and says nothing of the noise at 10 Hz: generalised cross-validation, which
takes noise for white, smooths a foot's impact away where markers carry 4 mm of it.

Of one coordinate alone, whose samples y (nf,) all weigh 1, the penalty makes

    y -> A y = B (G + rho R)^-1 B^T y,       G = B^T B,       rho = rate (2 pi f)^-6.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gaitcal.arrays import Array, IntArray
from gaitcal.model.chain import LinkageModel
from gaitcal.model.parameters import Parameters
from gaitcal.tracking import descent, marker_residual, motion, spline
from gaitcal.tracking.start import starting_coordinates, starting_nodes
from gaitcal.tracking.trial_problem import MotionProblem

# knot spans a second in units of f: nodes pass 1.9 f, so that the penalty limits the motion
SPANS_TIMES_CUTOFF = 4.0
FEWEST_SPANS, DENSE_SPANS, MOST_SPANS = 20.0, 50.0, 100.0
"""Knot spans a second: at least, whatever f; while f is sought, at least and at most."""
FRAMES_PER_DENSE_SPAN = 2.0
"""Between 50 and 100 spans a second, one for so many frames; a slow camera gets one for each."""
LOWEST_HZ = 2.0  # f is not sought below: whatever moves, moves as fast
CANDIDATES = (
    25  # cut-offs that are compared, 10 to 12 % apart; a parabola finds the minimum between them
)
# where markers have nothing to spare that could tell noise: what 20 knot spans a second pass
UNTOLD_HZ = 10.0
LEAST_SPARE = 1.0  # marker coordinates a frame beyond those that the motion can follow
LONGEST_S = 20.0  # f is sought in a stretch of so much of a trial: the one in which most happens
POSES = 50  # frames that W is taken from
# of mean H: a pose that hardly shows a coordinate (an elbow stretched) does not set its weight for
# all
LEAST = 0.01
NEVER_SEEN = 1e-6  # of the diagonal: for directions that no pose shows
GRAM_FLOOR = 1e-14  # of the largest diagonal entry of G: two nodes between the same frames
TINY = 1e-300
LOOSE = descent.DescentSettings(
    gain=1e-4
)  # while f is sought: what is left to gain is far below what tells one f from another


def with_bandwidth(
    problem: MotionProblem, parameters: Parameters, cutoff_hz: float
) -> MotionProblem:
    """The trial with nodes and penalty for a cut-off."""
    basis = problem.basis
    spans = min(
        max(SPANS_TIMES_CUTOFF * cutoff_hz, FEWEST_SPANS), max(dense_spans(basis), FEWEST_SPANS)
    )
    basis = _basis(basis, min(spans, spline.frame_rate(basis)))
    information = frame_information(problem, problem.body(parameters))
    return replace(problem, basis=basis, smoothing=spline.smoothing(basis, information, cutoff_hz))


def dense_spans(basis: spline.SplineBasis) -> float:
    """Knot spans a second while f is sought."""
    rate = spline.frame_rate(basis)
    return min(rate, max(DENSE_SPANS, min(rate / FRAMES_PER_DENSE_SPAN, MOST_SPANS)))


def highest_cutoff(basis: spline.SplineBasis) -> float:
    """Hz: the largest f that dense nodes do not limit."""
    return dense_spans(basis) / SPANS_TIMES_CUTOFF


def _basis(basis: spline.SplineBasis, spans_per_second: float) -> spline.SplineBasis:
    spans = max(round(spans_per_second * float(basis.time[-1] - basis.time[0])), 1)
    return spline.spline_basis(basis.time, spans + spline.MINIMUM_NODES - 1)


def frame_information(problem: MotionProblem, body: LinkageModel) -> Array:
    """(nq, nq) W, in the poses that the segments' rigid fits give; zero for coordinates that move
    no marker.
    """
    data, frames = problem.data, spline.spaced(len(problem.basis.time), POSES)
    some = data.frames(frames)
    q = starting_coordinates(body, some)
    mean = np.repeat(data.weight.mean(axis=1)[:, None], len(frames), axis=1)
    data = marker_residual.MarkerData(data.placed, some.measured, mean)
    weighed = replace(problem, basis=problem.basis.at(frames), data=data, smoothing=None)
    on = np.flatnonzero(weighed.active)
    hessians = weighed.frame_hessians(q, body)[:, on[:, None], on]
    average = hessians.mean(axis=0)
    hessians += LEAST * average + NEVER_SEEN * np.diag(np.diag(average))
    information = np.linalg.inv(np.linalg.inv(hessians).mean(axis=0))
    out = np.zeros((q.shape[1], q.shape[1]))
    out[np.ix_(on, on)] = 0.5 * (information + information.T)
    return out


class Smoother:
    """A of one basis. Splines are told by their nodes, series y (nf, k) by B^T y."""

    def __init__(self, basis: spline.SplineBasis) -> None:
        self.basis, self.rough = basis, spline.roughness(basis.knots)
        gram = (basis.matrices[0].T @ basis.matrices[0]).tocsr()
        self.gram = np.zeros((spline.ORDER, basis.nodes))  # lower band of G
        for d in range(min(spline.ORDER, basis.nodes)):
            self.gram[d, : basis.nodes - d] = gram.diagonal(-d)

    def coefficients(self, right: Array, cutoff_hz: float) -> Array:
        """(nn, k) coefficients of A y, from B^T y (nn, k)."""
        band = self.gram + spline.stiffness(self.basis, cutoff_hz) * self.rough.band.T
        band[0] += GRAM_FLOOR * band[0].max()
        return cho_solve_banded((cholesky_banded(band, lower=True), True), right)

    def lost(self, coefficients: Array, cutoff_hz: float) -> Array:
        """(nn, k) coefficients of y - A y, for splines y with nodes (nn, k)."""
        _, rough = self.rough.both(coefficients, np.eye(coefficients.shape[1]))
        return self.coefficients(spline.stiffness(self.basis, cutoff_hz) * rough, cutoff_hz)


class DenseMotion:
    """One trial tracked with the highest cut-off; what lower ones would make of it follows without
    tracking.
    """

    def __init__(
        self, problem: MotionProblem, parameters: Parameters, activity: Array | None = None
    ) -> None:
        """`activity` (nf,): what tells where most happens; the markers' speed unless given."""
        problem = replace(problem, smoothing=None)
        frames = busiest(problem, activity)
        body = problem.body(parameters)
        self.highest = highest_cutoff(problem.basis)
        """Hz."""
        self.information = frame_information(problem, body)
        cut = replace(problem, basis=problem.basis.at(frames), data=problem.data.frames(frames))
        basis = _basis(cut.basis, dense_spans(problem.basis))
        rough = spline.smoothing(basis, self.information, self.highest)
        self.problem = replace(cut, basis=basis, smoothing=rough)
        start = starting_nodes(body, cut.data, basis)
        self.coefficients = motion.track_nodes(self.problem, body, start, LOOSE).x
        """(nn, nq) m, rad."""
        residual = self.problem.positions(self.coefficients, body) - cut.data.measured
        self.residual = (np.sqrt(cut.data.weight)[:, None] * residual).reshape(-1, len(frames)).T
        """(nf, 3 nm) m."""
        self._right = basis.matrices[0].T @ self.residual  # (nn, 3 nm) B^T r
        self._smoother = Smoother(basis)
        self._moving = float(self.problem.active.sum())
        self.spare = 3.0 * float((cut.data.weight > 0).mean(axis=1).sum()) - self._moving
        """n - nq."""

    def at(self, cutoff_hz: float) -> "Smoothed":
        """What a cut-off makes of the motion."""
        basis, smoother = self.problem.basis, self._smoother
        change = smoother.lost(self.coefficients, cutoff_hz)
        taken = basis.evaluate(change)
        lost = float(np.vdot(taken @ self.information, taken))
        share = self._moving / max(self.spare, LEAST_SPARE)
        noise = share * float(np.vdot(self._right, smoother.coefficients(self._right, cutoff_hz)))
        cost = float((self.residual**2).sum()) + lost
        rms = np.sqrt(cost / max(float(self.problem.data.weight.sum()), TINY))
        return Smoothed(
            cutoff_hz=cutoff_hz,
            coefficients=self.coefficients - change,
            lost=lost,
            noise=noise,
            rms=float(rms),
        )

    def by_markers(self) -> float:
        """Hz: the cut-off that the markers ask for."""
        lowest = min(LOWEST_HZ, self.highest)
        if self.spare < LEAST_SPARE:
            return min(UNTOLD_HZ, self.highest)
        return self.least(
            lambda smoothed: smoothed.lost + 2.0 * smoothed.noise, lowest, self.highest
        )

    def least(
        self, criterion: "Callable[[Smoothed], float]", lowest: float, highest: float
    ) -> float:
        """Hz between two cut-offs: where a criterion is least."""
        cutoffs = np.geomspace(lowest, highest, CANDIDATES)
        values = np.log([max(criterion(self.at(float(f))), TINY) for f in cutoffs])
        return min(max(_lowest(np.log(cutoffs), values), lowest), highest)


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """A dense motion smoothed with some cut-off, the coordinates taken to be uncoupled."""

    cutoff_hz: float
    coefficients: Array  # (nn, nq) m, rad, of the dense basis
    lost: float  # m^2
    noise: float  # m^2
    rms: float  # m, of the markers' distances, weighted


def busiest(problem: MotionProblem, activity: Array | None = None) -> IntArray:
    """Frames of the stretch of at most `LONGEST_S` in which the sum of `activity` (nf,) is largest."""
    nf = len(problem.basis.time)
    length = min(nf, round(LONGEST_S * spline.frame_rate(problem.basis)) + 1)
    if length == nf:
        return np.arange(nf)
    if activity is None:
        moved = np.diff(problem.data.measured, axis=2)
        both = (problem.data.weight[:, 1:] > 0) & (problem.data.weight[:, :-1] > 0)
        activity = np.append(np.where(both, (moved**2).sum(axis=1), 0.0).sum(axis=0), 0.0)
    total = np.concatenate([[0.0], np.cumsum(activity)])
    first = int(np.argmax(total[length:] - total[:-length]))
    return np.arange(first, first + length)


def _lowest(x: Array, y: Array) -> float:
    """Hz: the vertex of the parabola through the least y and its neighbours, over x = log f; at an
    end, that end.
    """
    k = int(np.argmin(y))
    if k in (0, len(y) - 1):
        return float(np.exp(x[k]))
    before, after = x[k - 1] - x[k], x[k + 1] - x[k]
    left, right = (y[k - 1] - y[k]) * after, (y[k + 1] - y[k]) * before
    vertex = 0.5 * (left * after - right * before) / (left - right) if left != right else 0.0
    return float(np.exp(x[k] + vertex))
