"""How much of what a trial says of its joints is noise: the part of the markers' errors that a joint can see.

A segment's markers follow the segment (its rigid fit) up to their deformation; the linkage follows the rigid fits up to
what its joints forbid. Joint parameters act on the second part alone. With d the difference between the markers of the
rigid fits and those of the linkage, smoothed by the trial's splines, c = 6 (segments) - (coordinates) the directions
that the joints forbid, and nf frames,

    nu^2 = tau / (c nf) * sum |d|^2 * n / (n - p),      tau = 1 + 2 sum_k rho_k,      n = c nf / tau,

rho_k the autocorrelation of d (summed until it first falls below 0.05; Bartlett 1946), n the independent samples and p
the joint parameters that these have to serve. A cost divided by nu^2 counts every frame as if it were independent: slow
noise in a short trial weighs little. White noise of variance s^2 gives nu = s; clusters that move as a whole against
their bones give more than their deformation tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.parameters import Parameters
from gaitcal.motion.rigid import FEWEST_MARKERS, rigid_fit
from gaitcal.motion.spline import SplineBasis, frame_rate
from gaitcal.motion.trial_problem import MotionProblem

UNCORRELATED = 0.05
"""Autocorrelation below which the sum ends."""
LONGEST_LAG = 1.0 / 3.0
"""Of the trial: beyond, too few pairs of frames are left."""
LEAST_SAMPLES = 0.3
"""Part of the independent samples that is left at least, however many parameters they serve."""
LEAST_ERROR, MEMORY_S = 5e-5, 0.25
"""m, s: cameras err by at least this much, over at least this time."""


@dataclass(frozen=True)
class ForbiddenNoise:
    """The noise of one trial in the directions that its joints forbid."""

    variance: float
    """m^2, tau times the mean square of d per direction and frame."""
    samples: float
    """n, independent ones."""


def frames_per_sample(errors: Array, seen: BoolArray | None = None) -> float:
    """Tau of errors (nf, k): frames for one that is independent, all columns taken together; pairs of `seen` frames."""
    nf = len(errors)
    known = np.ones(nf) if seen is None else seen.astype(np.float64)
    spectrum = np.abs(np.fft.rfft(errors * known[:, None], 2 * nf, axis=0)) ** 2
    power = np.fft.irfft(spectrum.sum(axis=1))[:nf]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(known, 2 * nf)) ** 2)[:nf]
    if power[0] <= 0.0:
        return 1.0
    lags = np.arange(1, max(int(nf * LONGEST_LAG), 2))
    rho = power[lags] / power[0] * pairs[0] / np.maximum(pairs[lags], 1.0)
    small = np.flatnonzero(rho < UNCORRELATED)
    return 1.0 + 2.0 * float(rho[: small[0] if len(small) else None].sum())


def least_noise(basis: SplineBasis) -> float:
    """m, nu below which nothing is believed: that of the cameras, at the frames of a trial."""
    return LEAST_ERROR * float(np.sqrt(max(MEMORY_S * frame_rate(basis), 1.0)))


def forbidden_noise(problem: MotionProblem, parameters: Parameters, nodes: Array) -> ForbiddenNoise:
    """The noise at a motion, nodes (nn, nq).

    Segments of fewer than three markers have no rigid fit, and leave their joints out. Where no joint is left, d is
    what the linkage leaves of the markers themselves, in c = 3 (markers) - (coordinates) directions.
    """
    chain, count = problem.chain, len(problem.chain.coordinates)
    gap, segments, seen = _rigid_gap(problem, parameters, nodes)
    carried = chain.support[:count][problem.active][:, segments].any(axis=1)
    directions = 6 * len(segments) - int(carried.sum())
    if directions < 1:
        data = problem.data
        gap = problem.positions(nodes, problem.constants(parameters)) - data.measured
        gap *= np.sqrt(data.weight)[:, None]
        pulling = (data.weight > 0).sum(axis=0)
        seen = pulling > pulling.max(initial=0) // 2
        directions = max(3 * int(np.median(pulling[seen])) - int(problem.active.sum()), 1)
    nf = max(int(seen.sum()), 1)
    flat = gap.reshape(-1, len(seen)).T
    smooth = problem.basis.evaluate(problem.basis.fit(flat)) * seen[:, None]
    tau = frames_per_sample(smooth, seen)
    return ForbiddenNoise(tau * float((smooth**2).sum()) / (directions * nf), directions * nf / tau)


def _rigid_gap(problem: MotionProblem, parameters: Parameters, nodes: Array) -> tuple[Array, list[int], BoolArray]:
    """(nm, 3, nf) m, weighted, from the linkage to the rigid fits; the segments that have one; and the frames (nf,) in
    which all of them do.
    """
    data = problem.data
    gap, segments = np.zeros_like(data.measured), list[int]()
    seen = np.ones(data.weight.shape[1], dtype=bool)
    model = problem.positions(nodes, problem.constants(parameters))
    for segment, markers in data.placed.groups:
        weight = data.weight[markers]
        if ((weight > 0).any(axis=1)).sum() < FEWEST_MARKERS:
            continue
        fit = rigid_fit(data.local[markers], data.measured[markers], weight)
        followed = np.einsum("fij,mj->mif", fit.rotation, data.local[markers]) + fit.origin.T
        gap[markers] = np.sqrt(weight)[:, None] * (followed - model[markers]) * fit.determined
        segments.append(segment)
        seen &= fit.determined
    return gap, segments, seen


def trial_noises(seen: Sequence[ForbiddenNoise], least: Sequence[float], served: float) -> list[float]:
    """m, nu of every trial of a fit in which `served` parameters were found from the samples of all of them."""
    samples = sum(trial.samples for trial in seen)
    spent = samples / max(samples - served - 2.0, LEAST_SAMPLES * samples)
    return [max(float(np.sqrt(spent * s.variance)), floor) for s, floor in zip(seen, least, strict=True)]
