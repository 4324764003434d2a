"""The part of the Hessian that Gauss-Newton leaves out: how the markers curve, weighted by the residuals.

With the notation of `motion/marker_residual.py`, r_m already multiplied by its weight, the second derivative of marker
m by variables k before l (k = l too) is  w_k x (v_l + w_l x x_m), so that the half Hessian of the cost gains

    sum_{m after l} r_m . (w_k x (v_l + w_l x x_m))  =  w_k . (v_l x F_l + C_l w_l - tr(C_l) w_l),
    F_l = sum r_m,     C_l = sum x_m r_m^T.

Far from the measured markers this term is large: with joint parameters 10 mm and 10 degrees off, Gauss-Newton alone
converges by a factor of about two a step, with it by factors of hundreds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, ChainConstants
from gaitcal.model.kinematics import forward, jacobian, segment_poses
from gaitcal.motion.banded import Assembler
from gaitcal.motion.marker_residual import MarkerData, VariablePairs, frame_equations
from gaitcal.motion.trial_problem import FRAMES_AT_ONCE, TrialProblem

Array = NDArray[np.float64]


class RefitEquations:
    """Gradient and second-derivative matrix of a trial's cost by its nodes, for any measured markers of that trial."""

    def __init__(self, problem: TrialProblem) -> None:
        seen = np.zeros(len(problem.chain.segments), dtype=bool)
        seen[problem.data.segment[problem.data.weight.any(axis=1)]] = True
        self.chain, self.basis = problem.chain, problem.basis
        self._pairs = VariablePairs(problem.chain, seen)
        self._assembler = Assembler(self._pairs, len(problem.chain.coordinates), 0, problem.basis)

    def gradient(self, data: MarkerData, nodes: Array, constants: ChainConstants) -> tuple[float, Array]:
        """Cost (m^2) and half gradient by the nodes (nn, nq)."""
        q, cost, out = self.basis.evaluate(nodes), 0.0, np.zeros_like(nodes)
        for group in self._assembler.spans(FRAMES_AT_ONCE):
            frames = self._assembler.frames(group)
            part = frame_equations(self.chain, constants, self._pairs, data.frames(frames), q[frames], hessian=False)
            self._assembler.add_gradient(out, part.gradient, group)
            cost += part.cost
        return cost, out

    def band(self, data: MarkerData, nodes: Array, constants: ChainConstants, *, curved: bool) -> Array:
        """(nn * nq, 6 nq) transposed lower band of half the Hessian: Gauss-Newton, or all of it if `curved`."""
        sums, q = self._assembler.empty(), self.basis.evaluate(nodes)
        for group in self._assembler.spans(FRAMES_AT_ONCE):
            frames = self._assembler.frames(group)
            part = data.frames(frames)
            matrices = frame_equations(self.chain, constants, self._pairs, part, q[frames]).products()
            if curved:
                matrices += curvature(self.chain, constants, part, q[frames])
            self._assembler.add_matrices(sums, matrices, group)
        return self._assembler.finish(sums, 0.0).band


def curvature(chain: Chain, constants: ChainConstants, data: MarkerData, q: Array) -> Array:
    """(nf, nk, nk) what the markers' curvature adds to the Gauss-Newton matrices of the frames; valid at (k, l) where
    l comes after k.
    """
    poses = forward(chain, constants, q)
    axes, origins = segment_poses(chain, constants, poses)
    columns = jacobian(chain, constants, poses)
    moments = _residual_moments(data, axes, origins)
    ns, rows, nf = moments.shape
    nk = len(columns)
    composite = (chain.support[:nk] @ moments.reshape(ns, rows * nf)).reshape(nk, rows, nf)
    v, w = columns[:, :3], columns[:, 3:]
    force, first = composite[:, :3], composite[:, 3:].reshape(nk, 3, 3, nf)
    trace = first[:, 0, 0] + first[:, 1, 1] + first[:, 2, 2]
    pull = np.empty_like(w)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        pull[:, i] = v[:, j] * force[:, k] - v[:, k] * force[:, j] - trace * w[:, i]
        pull[:, i] += first[:, i, 0] * w[:, 0] + first[:, i, 1] * w[:, 1] + first[:, i, 2] * w[:, 2]
    out: Array = np.matmul(np.ascontiguousarray(w.transpose(2, 0, 1)), np.ascontiguousarray(pull.transpose(2, 1, 0)))
    return out


def _residual_moments(data: MarkerData, axes: Array, origins: Array) -> Array:
    """(ns, 12, nf) sums over each segment's markers: F, then C row by row."""
    ns, nf = origins.shape[0], origins.shape[-1]
    out = np.zeros((ns, 12, nf))
    edges = np.flatnonzero(np.diff(data.segment)) + 1
    for markers in np.split(np.arange(len(data.segment)), edges):
        s, of = int(data.segment[markers[0]]), slice(int(markers[0]), int(markers[-1]) + 1)
        x = (data.local[of] @ axes[s].reshape(3, 3 * nf)).reshape(-1, 3, nf) + origins[s]
        r = (x - data.measured[of]) * data.weight[of, None, :]
        out[s, :3] = r.sum(axis=0)
        for i in range(3):
            for j in range(3):
                out[s, 3 + 3 * i + j] = (x[:, i] * r[:, j]).sum(axis=0)
    return out
