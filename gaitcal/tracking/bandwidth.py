"""Bandwidth of a trial, chosen from its markers.

A motion is smoothed by the penalty of `spline.py`; one cut-off f serves all its coordinates. With
H_t = J^T W J of frame t, every marker with its mean weight over the trial,

    W = (mean_t (H_t + MIN_INFORMATION_SHARE mean H)^-1)^-1

weights the coordinates against each other. The trial is tracked once with dense control points and
the highest cut-off that these do not limit: coordinates q (nf, nq), residuals r (nf, 3 nm), each
times the root of its weight. Smoothing by A(f) loses

    lost(f) = tr (q - A q)^T (q - A q) W        of the motion, and leaves
    noise(f) = nq / (n - nq) tr r^T A r

of the noise. n is the number of observed marker coordinates in a frame. Each of the nq directions
of the coordinates is taken to hold as much noise, at every frequency, as each of the n - nq
directions of the residuals. f minimises the expected error, lost + 2 noise less a constant (Mallows
1973, for noise of any colour).

Soft tissue artefacts are slow and carry no information on the noise at 10 Hz. Generalised
cross-validation assumes white noise and would smooth the impact of a foot away.

For one coordinate with samples y (nf,) of weight 1, the penalty makes

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
from gaitcal.tracking.start import find_start_coefficients, find_start_coordinates
from gaitcal.tracking.trial_problem import MotionProblem

SPANS_PER_CUTOFF = 4.0
"""Knot spans a second in units of f. The control points pass 1.9 f, so that the penalty is what
limits the motion."""
FEWEST_SPANS, DENSE_SPANS, MOST_SPANS = 20.0, 50.0, 100.0
"""1/s, knot spans: at least, for any f; at least and at most while f is chosen."""
FRAMES_PER_DENSE_SPAN = 2.0
"""Frames for each span between 50 and 100 spans a second. Slower cameras get a span for each frame.
"""
LOWEST_HZ = 2.0
"""Hz, least cut-off that is tried: no movement is slower."""
CANDIDATES = 25
"""Cut-offs that are compared, 10 to 12 % apart; a parabola finds the minimum between them."""
FALLBACK_HZ = 10.0
"""Hz, cut-off of 20 knot spans a second, used where the markers are not redundant."""
MIN_REDUNDANCY = 1.0
"""Marker coordinates in a frame beyond those that the motion can follow."""
MAX_SEARCH_S = 20.0
"""s, longest stretch of a trial in which the cut-off is chosen: the busiest one."""
POSES = 50
"""Frames from which W is computed."""
MIN_INFORMATION_SHARE = 0.01
"""Share of the mean H that is added to every frame: a pose that hardly shows a coordinate (a
straight elbow) does not determine its weight."""
UNOBSERVED_RIDGE = 1e-6
"""Share of the diagonal of the mean H that is added for directions that no pose shows."""
GRAM_FLOOR = 1e-14
"""Share of the largest diagonal entry of G, for control points without frames."""
TINY = 1e-300
"""Smallest positive figure, against division by zero and log(0)."""
LOOSE_SETTINGS = descent.DescentSettings(gain=1e-4)
"""Tolerance while f is chosen: the remaining gain is far below the difference between cut-offs."""


def apply_bandwidth(
    problem: MotionProblem, parameters: Parameters, cutoff_hz: float
) -> MotionProblem:
    """Give a trial the control points and the penalty of a cut-off.

    Parameters
    ----------
    problem
        The trial.
    parameters
        Joint parameters with which the information of a frame is computed.
    cutoff_hz
        Hz, f: half of an oscillation at it passes.

    Returns
    -------
    MotionProblem
        The trial with another basis and penalty.
    """
    basis = problem.basis
    spans = min(
        max(SPANS_PER_CUTOFF * cutoff_hz, FEWEST_SPANS),
        max(compute_dense_spans(basis), FEWEST_SPANS),
    )
    basis = _build_basis(basis, min(spans, spline.compute_frame_rate(basis)))
    information = compute_frame_information(problem, problem.build_body(parameters))
    return replace(
        problem, basis=basis, smoothing=spline.build_smoothing(basis, information, cutoff_hz)
    )


def compute_dense_spans(basis: spline.SplineBasis) -> float:
    """Compute the number of knot spans a second that is used while f is chosen."""
    rate = spline.compute_frame_rate(basis)
    return min(rate, max(DENSE_SPANS, min(rate / FRAMES_PER_DENSE_SPAN, MOST_SPANS)))


def compute_highest_cutoff(basis: spline.SplineBasis) -> float:
    """Compute the highest f (Hz) that dense control points do not limit."""
    return compute_dense_spans(basis) / SPANS_PER_CUTOFF


def _build_basis(basis: spline.SplineBasis, spans_per_second: float) -> spline.SplineBasis:
    spans = max(round(spans_per_second * float(basis.time[-1] - basis.time[0])), 1)
    return spline.build_spline_basis(basis.time, spans + spline.MINIMUM_NODES - 1)


def compute_frame_information(problem: MotionProblem, body: LinkageModel) -> Array:
    """Compute the information W of a frame in the poses of the rigid fits.

    Returns: (nq, nq) W; zero for coordinates that move no marker.
    """
    data, frames = problem.data, spline.select_spaced_frames(len(problem.basis.time), POSES)
    some = data.select_frames(frames)
    q = find_start_coordinates(body, some)
    mean = np.repeat(data.weight.mean(axis=1)[:, None], len(frames), axis=1)
    data = marker_residual.MarkerData(data.placed, some.measured, mean)
    weighed = replace(problem, basis=problem.basis.select_frames(frames), data=data, smoothing=None)
    on = np.flatnonzero(weighed.active)
    hessians = weighed.compute_frame_hessians(q, body)[:, on[:, None], on]
    average = hessians.mean(axis=0)
    hessians += MIN_INFORMATION_SHARE * average + UNOBSERVED_RIDGE * np.diag(np.diag(average))
    information = np.linalg.inv(np.linalg.inv(hessians).mean(axis=0))
    out = np.zeros((q.shape[1], q.shape[1]))
    out[np.ix_(on, on)] = 0.5 * (information + information.T)
    return out


class Smoother:
    """Smoothing A of one basis.

    Splines are given by control points, data series y (nf, k) by B^T y.
    """

    def __init__(self, basis: spline.SplineBasis) -> None:
        self.basis, self.rough = basis, spline.build_roughness(basis.knots)
        gram = (basis.matrices[0].T @ basis.matrices[0]).tocsr()
        # lower band of G
        self.gram = np.zeros((spline.ORDER, basis.control_points))
        for d in range(min(spline.ORDER, basis.control_points)):
            self.gram[d, : basis.control_points - d] = gram.diagonal(-d)

    def smooth(self, right: Array, cutoff_hz: float) -> Array:
        """Return (nn, k) coefficients of A y, from B^T y (nn, k)."""
        band = self.gram + spline.compute_stiffness(self.basis, cutoff_hz) * self.rough.band.T
        band[0] += GRAM_FLOOR * band[0].max()
        return cho_solve_banded((cholesky_banded(band, lower=True), True), right)

    def compute_loss(self, coefficients: Array, cutoff_hz: float) -> Array:
        """Return (nn, k) coefficients of y - A y, for splines y with coefficients (nn, k)."""
        _, rough = self.rough.evaluate(coefficients, np.eye(coefficients.shape[1]))
        return self.smooth(spline.compute_stiffness(self.basis, cutoff_hz) * rough, cutoff_hz)


class DenseMotion:
    """One trial tracked with the highest cut-off. Lower cut-offs follow without tracking."""

    def __init__(
        self, problem: MotionProblem, parameters: Parameters, activity: Array | None = None
    ) -> None:
        """`activity`: (nf,) selects the busiest stretch; squared marker speed unless given."""
        problem = replace(problem, smoothing=None)
        frames = find_busiest_frames(problem, activity)
        body = problem.build_body(parameters)
        self.highest = compute_highest_cutoff(problem.basis)
        """Hz."""
        self.information = compute_frame_information(problem, body)
        cut = replace(
            problem,
            basis=problem.basis.select_frames(frames),
            data=problem.data.select_frames(frames),
        )
        basis = _build_basis(cut.basis, compute_dense_spans(problem.basis))
        rough = spline.build_smoothing(basis, self.information, self.highest)
        self.problem = replace(cut, basis=basis, smoothing=rough)
        start = find_start_coefficients(body, cut.data, basis)
        self.coefficients = motion.track_coefficients(self.problem, body, start, LOOSE_SETTINGS).x
        """(nn, nq) m, rad."""
        residual = self.problem.compute_positions(self.coefficients, body) - cut.data.measured
        self.residual = (np.sqrt(cut.data.weight)[:, None] * residual).reshape(-1, len(frames)).T
        """(nf, 3 nm) m."""
        # (nn, 3 nm) B^T r
        self._right = basis.matrices[0].T @ self.residual
        self._smoother = Smoother(basis)
        self._moving = float(self.problem.active.sum())
        self.spare = 3.0 * float((cut.data.weight > 0).mean(axis=1).sum()) - self._moving
        """n - nq."""

    def smooth_at(self, cutoff_hz: float) -> "SmoothedMotion":
        """Smooth the motion with a cut-off, and compute the loss of fit.

        Parameters
        ----------
        cutoff_hz
            Hz, f.

        Returns
        -------
        SmoothedMotion
        """
        basis, smoother = self.problem.basis, self._smoother
        change = smoother.compute_loss(self.coefficients, cutoff_hz)
        taken = basis.evaluate(change)
        lost = float(np.vdot(taken @ self.information, taken))
        share = self._moving / max(self.spare, MIN_REDUNDANCY)
        noise = share * float(np.vdot(self._right, smoother.smooth(self._right, cutoff_hz)))
        cost = float((self.residual**2).sum()) + lost
        rms = np.sqrt(cost / max(float(self.problem.data.weight.sum()), TINY))
        return SmoothedMotion(
            cutoff_hz=cutoff_hz,
            coefficients=self.coefficients - change,
            lost=lost,
            noise=noise,
            rms=float(rms),
        )

    def choose_cutoff(self) -> float:
        """Choose the cut-off of least expected error.

        Returns
        -------
        float
            Hz; `FALLBACK_HZ` where the markers are not redundant enough to estimate their noise.
        """
        lowest = min(LOWEST_HZ, self.highest)
        if self.spare < MIN_REDUNDANCY:
            return min(FALLBACK_HZ, self.highest)
        return self.minimise_criterion(
            lambda smoothed: smoothed.lost + 2.0 * smoothed.noise, lowest, self.highest
        )

    def minimise_criterion(
        self, criterion: "Callable[[SmoothedMotion], float]", lowest: float, highest: float
    ) -> float:
        """Find the cut-off with the least value of a criterion.

        Parameters
        ----------
        criterion
            Positive function of the smoothed motion.
        lowest, highest
            Hz, range of the cut-off.

        Returns
        -------
        float
            Hz.
        """
        cutoffs = np.geomspace(lowest, highest, CANDIDATES)
        values = np.log([max(criterion(self.smooth_at(float(f))), TINY) for f in cutoffs])
        return min(max(_find_minimum(np.log(cutoffs), values), lowest), highest)


@dataclass(frozen=True, kw_only=True)
class SmoothedMotion:
    """A dense motion smoothed with a cut-off, its coordinates taken as uncoupled."""

    cutoff_hz: float
    coefficients: Array  # (nn, nq) m, rad, of the dense basis
    lost: float  # m^2
    noise: float  # m^2
    rms: float  # m, of the markers' distances, weighted


def find_busiest_frames(problem: MotionProblem, activity: Array | None = None) -> IntArray:
    """Find the stretch of at most `MAX_SEARCH_S` with the largest sum of `activity`.

    `activity`: (nf,) any measure; the squared speed of the markers unless given. Returns: (n,)
    indices of the frames.
    """
    nf = len(problem.basis.time)
    length = min(nf, round(MAX_SEARCH_S * spline.compute_frame_rate(problem.basis)) + 1)
    if length == nf:
        return np.arange(nf)
    if activity is None:
        moved = np.diff(problem.data.measured, axis=2)
        both = (problem.data.weight[:, 1:] > 0) & (problem.data.weight[:, :-1] > 0)
        activity = np.append(np.where(both, (moved**2).sum(axis=1), 0.0).sum(axis=0), 0.0)
    total = np.concatenate([[0.0], np.cumsum(activity)])
    first = int(np.argmax(total[length:] - total[:-length]))
    return np.arange(first, first + length)


def _find_minimum(x: Array, y: Array) -> float:
    """Find the minimum of y over x = log f (Hz) by a parabola through the least value.

    At an end of the range, that end is returned.
    """
    k = int(np.argmin(y))
    if k in (0, len(y) - 1):
        return float(np.exp(x[k]))
    before, after = x[k - 1] - x[k], x[k + 1] - x[k]
    left, right = (y[k - 1] - y[k]) * after, (y[k + 1] - y[k]) * before
    vertex = 0.5 * (left * after - right * before) / (left - right) if left != right else 0.0
    return float(np.exp(x[k] + vertex))
