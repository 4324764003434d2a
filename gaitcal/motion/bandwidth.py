"""The bandwidth of a trial, chosen by its markers.

A trial's motion is smoothed by the penalty of `roughness.py`; one cut-off f serves all its coordinates. With
H_t = J^T W J of frame t, every marker with its mean weight over the trial,

    W = (mean_t (H_t + LEAST mean H)^-1)^-1

weighs them against each other. The markers ask for the f that predicts markers left out best, by generalised
cross-validation (Craven and Wahba 1979): the least of

    GCV(f) = n C(f) / (n - tr A(f))^2,       tr A(f) = nq tr (G + rate (2 pi f)^-6 R)^-1 G,

C the marker cost without the penalty, n the number of marker coordinates measured; tr A is that of uncoupled
coordinates (`nodes_kept`). f is sought from above, a track a step, each from the motion of the one before, until the
criterion rises; a parabola through the three lowest points gives the minimum. While it is sought the nodes are dense;
then a node every 0.25 / f suffices, as the penalty and not the nodes limits the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.chain import ChainConstants
from gaitcal.model.parameters import Parameters
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.marker_residual import MarkerData
from gaitcal.motion.roughness import frame_rate, nodes_kept, smoothing
from gaitcal.motion.spline import MINIMUM_NODES, SplineBasis, spline_basis
from gaitcal.motion.start import starting_coordinates, starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem

SPANS_TIMES_CUTOFF = 4.0
"""Knot spans a second in units of f: the nodes pass 1.9 f."""
FEWEST_SPANS, DENSE_SPANS, MOST_SPANS = 20.0, 50.0, 100.0
"""Knot spans a second: at least, whatever f; while f is sought, at least and at most."""
FRAMES_PER_DENSE_SPAN = 2.0
"""Between 50 and 100 spans a second, one for so many frames; a slow camera gets one for each."""
LOWEST_HZ = 2.0
"""f is not sought below: whatever moves, moves as fast."""
STEPS_APART = 1.4
"""Ratio of neighbouring cut-offs."""
RISEN = 1.25
"""The search ends where the criterion is so much above its least."""
LONGEST_S = 20.0
"""f is sought in a stretch of so much of a trial: the one in which most happens."""
POSES = 50
"""Frames that W is taken from."""
LEAST = 0.01
"""Of mean H: a pose in which a coordinate is hardly seen (an elbow stretched) does not set its weight for all."""
NEVER_SEEN = 1e-6
"""Of the diagonal: for directions that no pose shows."""
TINY = 1e-300
LOOSE = DescentSettings(gain=1e-4)
"""While f is sought: what is left to gain is far below what the criterion tells apart."""


def with_bandwidth(problem: TrialProblem, parameters: Parameters, cutoff_hz: float) -> TrialProblem:
    """The trial with nodes and penalty for a cut-off."""
    basis = problem.basis
    spans = max(SPANS_TIMES_CUTOFF * cutoff_hz, FEWEST_SPANS)
    basis = _basis(basis, min(spans, max(dense_spans(basis), FEWEST_SPANS), frame_rate(basis)))
    information = frame_information(problem, problem.constants(parameters))
    return replace(problem, basis=basis, smoothing=smoothing(basis, information, cutoff_hz))


def dense_spans(basis: SplineBasis) -> float:
    """Knot spans a second while f is sought."""
    rate = frame_rate(basis)
    return min(rate, max(DENSE_SPANS, min(rate / FRAMES_PER_DENSE_SPAN, MOST_SPANS)))


def highest_cutoff(basis: SplineBasis) -> float:
    """Hz: the largest f that dense nodes do not limit."""
    return dense_spans(basis) / SPANS_TIMES_CUTOFF


def _basis(basis: SplineBasis, spans_per_second: float) -> SplineBasis:
    spans = max(round(spans_per_second * float(basis.time[-1] - basis.time[0])), 1)
    return spline_basis(basis.time, spans + MINIMUM_NODES - 1)


def frame_information(problem: TrialProblem, constants: ChainConstants) -> Array:
    """(nq, nq) W, in the poses that the segments' rigid fits give; zero for coordinates that move no marker."""
    data, nf = problem.data, len(problem.basis.time)
    frames = np.unique(np.round(np.linspace(0, nf - 1, POSES)).astype(np.intp))
    some = data.frames(frames)
    q = starting_coordinates(problem.chain, constants, some)
    mean = np.repeat(data.weight.mean(axis=1)[:, None], len(frames), axis=1)
    weighed = replace(
        problem, basis=problem.basis.at(frames), data=MarkerData(data.placed, some.measured, mean), smoothing=None
    )
    on = np.flatnonzero(weighed.active)
    hessians = weighed.frame_hessians(q, constants)[:, on[:, None], on]
    average = hessians.mean(axis=0)
    hessians += LEAST * average + NEVER_SEEN * np.diag(np.diag(average))
    out = np.zeros((q.shape[1], q.shape[1]))
    information = np.linalg.inv(np.linalg.inv(hessians).mean(axis=0))
    out[np.ix_(on, on)] = 0.5 * (information + information.T)
    return out


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """A trial tracked with one cut-off."""

    cutoff_hz: float
    problem: TrialProblem
    nodes: Array
    """(nn, nq) m, rad."""
    gcv: float
    """m^2."""
    noise: float
    """m, standard deviation of a marker coordinate: the residual's, for the degrees of freedom that are left."""
    rms: float
    """m, of the markers' distances, weighted."""


class CutoffScan:
    """One trial tracked with falling cut-offs, each when it is asked for."""

    def __init__(self, problem: TrialProblem, parameters: Parameters, activity: Array | None = None) -> None:
        """`activity` (nf,): what tells where most happens; the markers' speed unless given."""
        problem = replace(problem, smoothing=None)
        self.frames = busiest(problem, activity)
        cut = replace(problem, basis=problem.basis.at(self.frames), data=problem.data.frames(self.frames))
        dense = _basis(cut.basis, dense_spans(problem.basis))
        self.problem = replace(cut, basis=dense)
        self.constants = problem.constants(parameters)
        self.information = frame_information(problem, self.constants)
        top = highest_cutoff(problem.basis)
        count = max(int(np.ceil(np.log(top / LOWEST_HZ) / np.log(STEPS_APART))), 1) + 1
        self.cutoffs = np.geomspace(top, min(LOWEST_HZ, top), count)
        """(n,) Hz, falling."""
        self.tracked: list[Smoothed] = []

    def at(self, k: int) -> Smoothed:
        """The trial with the k-th cut-off."""
        while len(self.tracked) <= k:
            before = self.tracked[-1] if self.tracked else None
            self.tracked.append(self.smoothed(float(self.cutoffs[len(self.tracked)]), before))
        return self.tracked[k]

    def least(self, criterion: Callable[[Smoothed], float]) -> float:
        """Hz: where a criterion is least, sought from above."""
        values: list[float] = []
        for k in range(len(self.cutoffs)):
            values.append(max(criterion(self.at(k)), TINY))
            if values[-1] > RISEN * min(values):
                break
        return _lowest(np.log(self.cutoffs[: len(values)]), np.log(values))

    def by_markers(self) -> float:
        """Hz: the cut-off that the markers ask for."""
        return self.least(lambda smoothed: smoothed.gcv)

    def smoothed(self, cutoff_hz: float, near: Smoothed | None = None) -> Smoothed:
        """The trial tracked with one cut-off, from a motion that is near or from rigid fits."""
        basis = _basis(self.problem.basis, max(SPANS_TIMES_CUTOFF * cutoff_hz, FEWEST_SPANS))
        problem = replace(self.problem, basis=basis, smoothing=smoothing(basis, self.information, cutoff_hz))
        return self._tracked(problem, cutoff_hz, nodes_kept(basis, cutoff_hz), near)

    def with_nodes(self, spans_per_second: float, cutoff_hz: float) -> Smoothed:
        """The trial tracked without a penalty, its nodes alone passing `cutoff_hz`."""
        basis = _basis(self.problem.basis, spans_per_second)
        return self._tracked(replace(self.problem, basis=basis), cutoff_hz, float(basis.nodes), None)

    def _tracked(self, problem: TrialProblem, cutoff_hz: float, kept: float, near: Smoothed | None) -> Smoothed:
        basis = problem.basis
        if near is None:
            start = starting_nodes(problem.chain, self.constants, problem.data, basis)
        else:
            start = basis.fit(near.problem.basis.evaluate(near.nodes))
        nodes = track_nodes(problem, self.constants, start, LOOSE).nodes
        cost = problem.marker_cost(nodes, self.constants)
        count = 3.0 * float((problem.data.weight > 0).sum())
        left = count - float(problem.active.sum()) * kept
        return Smoothed(
            cutoff_hz=cutoff_hz,
            problem=problem,
            nodes=nodes,
            gcv=count * cost / left**2 if left > 0 else np.inf,
            noise=float(np.sqrt(cost / left)) if left > 0 else np.inf,
            rms=float(np.sqrt(cost / max(float(problem.data.weight.sum()), TINY))),
        )


def busiest(problem: TrialProblem, activity: Array | None = None) -> IntArray:
    """Frames of the stretch of at most `LONGEST_S` in which the sum of `activity` (nf,) is largest."""
    time = problem.basis.time
    nf = len(time)
    length = min(nf, round(LONGEST_S * frame_rate(problem.basis)) + 1)
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
    """Hz: the vertex of the parabola through the least y and its neighbours, over x = log f; at an end, that end."""
    k = int(np.argmin(y))
    if k in (0, len(y) - 1):
        return float(np.exp(x[k]))
    before, after = x[k - 1] - x[k], x[k + 1] - x[k]
    left, right = (y[k - 1] - y[k]) * after, (y[k + 1] - y[k]) * before
    vertex = 0.5 * (left * after - right * before) / (left - right) if left != right else 0.0
    return float(np.exp(x[k] + vertex))
