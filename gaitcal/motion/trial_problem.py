"""One trial as a least-squares problem in its nodes and the joint parameters: what all solvers work on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import Chain, ChainConstants, chain_of
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import Assembler, NormalEquations
from gaitcal.motion.marker_residual import MarkerData, VariablePairs, frame_equations, marker_cost, marker_positions
from gaitcal.motion.spline import SplineBasis

Array = NDArray[np.float64]

FRAMES_AT_ONCE = 512
"""Frames worked on together: bounds memory, and keeps the working set in the processor's cache."""


@dataclass(frozen=True)
class TrialProblem:
    """Markers of one trial, the part of the linkage that carries them, and the spline basis."""

    name: str
    chain: Chain
    basis: SplineBasis
    data: MarkerData
    labels: tuple[str, ...]
    """(nm,) in the order of `data`."""

    @cached_property
    def _pairs(self) -> VariablePairs:
        seen = np.zeros(len(self.chain.segments), dtype=bool)
        seen[self.data.segment[np.asarray(self.data.weight.any(axis=1))]] = True
        return VariablePairs(self.chain, seen)

    @cached_property
    def _assembler(self) -> Assembler:
        return Assembler(self._pairs, len(self.chain.coordinates), len(self.chain.free), self.basis)

    @property
    def active(self) -> NDArray[np.bool_]:
        """(nq,) coordinates that move a marker with weight; the others stay at their start."""
        return self._pairs.active[: len(self.chain.coordinates)]

    def constants(self, parameters: Parameters) -> ChainConstants:
        """Chain constants for a set of parameters."""
        return self.chain.constants(parameters.joint, parameters.zero_angles)

    def values(self, parameters: Parameters) -> Array:
        """(np,) values of the free joint parameters, m and rad."""
        return parameters.joint[[JP_INDEX[name] for name in self.chain.free]]

    def with_free(self, free: tuple[str, ...]) -> TrialProblem:
        """The same trial with other joint parameters free."""
        return replace(self, chain=chain_of(self.chain.root, self.chain.segments, free))

    def with_weight(self, weight: Array) -> TrialProblem:
        """The same trial with other marker weights (nm, nf)."""
        return replace(self, data=replace(self.data, weight=weight))

    def with_measured(self, measured: Array) -> TrialProblem:
        """The same trial with other measured markers (nm, 3, nf), m; what does not depend on them is not worked out
        again.
        """
        other = replace(self, data=replace(self.data, measured=measured))
        other.__dict__.update(_pairs=self._pairs, _assembler=self._assembler)
        return other

    def equations(self, nodes: Array, constants: ChainConstants, *, curved: bool = False) -> NormalEquations:
        """Normal equations at `nodes` (nn, nq); if `curved`, with half the whole Hessian instead of Gauss-Newton's.

        ValueError if `curved` and a joint parameter is free: curvature asks which of two variables comes first, and
        parameters are not kept in that order.
        """
        if curved and self.chain.free:
            raise ValueError("curvature is for the coordinates alone: no joint parameter may be free")
        assembler, cost = self._assembler, 0.0
        sums = assembler.empty()
        q = self.basis.evaluate(nodes)
        for group in assembler.spans(FRAMES_AT_ONCE):
            frames = assembler.frames(group)
            part = frame_equations(
                self.chain, constants, self._pairs, self.data.frames(frames), q[frames], curved=curved
            )
            assembler.add(sums, part, group)
            cost += part.cost
        return assembler.finish(sums, cost)

    def frame_hessians(self, q: Array, constants: ChainConstants) -> Array:
        """(nf, nq, nq) Gauss-Newton matrices of the frames by themselves, at coordinates (nf, nq)."""
        pairs, nq = self._pairs, len(self.chain.coordinates)
        out = np.zeros((len(q), nq, nq))
        first, second = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        for group in self._assembler.spans(FRAMES_AT_ONCE):
            frames = self._assembler.frames(group)
            part = frame_equations(self.chain, constants, pairs, self.data.frames(frames), q[frames])
            entries = part.hessian[:, pairs.coordinates]
            out[frames, first, second] = out[frames, second, first] = entries
        return out

    def gradient(self, nodes: Array, constants: ChainConstants) -> tuple[float, Array]:
        """Cost (m^2) and half gradient by the nodes (nn, nq), without the matrix."""
        cost, by_nodes, _ = self.both_gradients(nodes, constants)
        return cost, by_nodes

    def both_gradients(self, nodes: Array, constants: ChainConstants) -> tuple[float, Array, Array]:
        """Cost (m^2) and half gradients by the nodes (nn, nq) and the free joint parameters (np,)."""
        q = self.basis.evaluate(nodes)
        nq = len(self.chain.coordinates)
        cost, by_nodes, by_values = 0.0, np.zeros_like(nodes), np.zeros(len(self.chain.free))
        for group in self._assembler.spans(FRAMES_AT_ONCE):
            frames = self._assembler.frames(group)
            part = frame_equations(
                self.chain, constants, self._pairs, self.data.frames(frames), q[frames], hessian=False
            )
            cost += part.cost
            self._assembler.add_gradient(by_nodes, part.gradient[:nq], group)
            by_values += part.gradient[nq:].sum(axis=1)
        return cost, by_nodes, by_values

    def cost(self, nodes: Array, constants: ChainConstants) -> float:
        """Sum of w |r|^2, m^2."""
        q, total = self.basis.evaluate(nodes), 0.0
        for group in self._assembler.spans(FRAMES_AT_ONCE):
            frames = self._assembler.frames(group)
            total += marker_cost(self.chain, constants, self.data.frames(frames), q[frames])
        return total

    def positions(self, nodes: Array, constants: ChainConstants) -> Array:
        """(nm, 3, nf) m, model markers."""
        q = self.basis.evaluate(nodes)
        out = np.empty(self.data.measured.shape)
        for group in self._assembler.spans(FRAMES_AT_ONCE):
            frames = self._assembler.frames(group)
            out[:, :, frames] = marker_positions(self.chain, constants, self.data.frames(frames), q[frames])
        return out
