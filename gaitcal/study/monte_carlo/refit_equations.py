"""What a re-fit evaluates: the equations of one trial, for any measured markers of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import ChainConstants
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
            part = frame_equations(self.chain, constants, self._pairs, data.frames(frames), q[frames], curved=curved)
            self._assembler.add_matrices(sums, part.products(), group)
        return self._assembler.finish(sums, 0.0).band
