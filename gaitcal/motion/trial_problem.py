"""One trial as a least-squares problem in its nodes and the joint parameters: what all solvers work on.

From a recording and a person's model to a least-squares problem: here a marker becomes a residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.model.chain import Chain, ChainConstants, chain_of
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.linkage import ROOT_SUFFIXES, SEGMENTS
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.banded import Assembler, NormalEquations
from gaitcal.motion.marker_residual import MarkerData, VariablePairs, frame_equations, marker_cost, marker_positions
from gaitcal.motion.node_rule import NodeRule
from gaitcal.motion.placed_markers import PlacedMarkers
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.motion.roughness import Smoothing
from gaitcal.motion.soft_tissue import SoftTissue, tissue_gradient, with_tissue_columns
from gaitcal.motion.spline import SplineBasis, spline_basis
from gaitcal.motion.trunk_support import telling
from gaitcal.recording.recording import Recording, seen_mask
from gaitcal.records import dataclass
from gaitcal.runtime import keep_freed_memory


@dataclass(frozen=True, kw_only=True)
class TrialProblem:
    """Markers of one trial, the part of the linkage that carries them, and the spline basis."""

    name: str
    chain: Chain
    basis: SplineBasis
    data: MarkerData
    labels: tuple[str, ...]
    """(nm,) in the order of `data`."""
    tissue: SoftTissue | None = None
    """Unknown displacements of the markers; None: none."""
    smoothing: Smoothing | None = None
    """What limits the bandwidth besides the nodes; its cost is part of the trial's."""
    held: tuple[str, ...] = ()
    """Coordinates that stay zero though markers move with them: those between a root that is not seen and the segment
    that carries it."""

    @cached_property
    def penalty(self) -> Smoothing | None:
        """`smoothing` of the active coordinates."""
        return None if self.smoothing is None else self.smoothing.of_active(self.active)

    @cached_property
    def _pairs(self) -> VariablePairs:
        seen = np.zeros(len(self.chain.segments), dtype=bool)
        seen[self.data.segment[np.asarray(self.data.weight.any(axis=1))]] = True
        return VariablePairs(self.chain, seen, self.held)

    @cached_property
    def _assembler(self) -> Assembler:
        return Assembler(self._pairs, len(self.chain.coordinates), len(self.chain.free), self.basis)

    @property
    def active(self) -> BoolArray:
        """(nq,) coordinates that move a marker with weight; the others stay at their start."""
        return self._pairs.active[: len(self.chain.coordinates)]

    @property
    def unknowns(self) -> tuple[str, ...]:
        """(np,) names of what is sought besides the motion: free joint parameters, then soft tissue."""
        return (*self.chain.free, *(self.tissue.keys if self.tissue else ()))

    def displaced(self, z: Array) -> TrialProblem:
        """The same trial with its soft tissue at z (nz,), m or m/rad."""
        if self.tissue is None or not len(z):
            return self
        return self.shifted(self.tissue.shift(z, len(self.labels)))

    def shifted(self, shift: Array) -> TrialProblem:
        """The same trial with its markers (nm, 3, nf) m from their places."""
        other = replace(self, data=replace(self.data, shift=shift))
        other.__dict__.update(_pairs=self._pairs, _assembler=self._assembler)
        return other

    def part(self, root: str, segments: tuple[str, ...]) -> TrialProblem:
        """The same trial of some segments alone, `root` free in the laboratory; without soft tissue."""
        chain = chain_of(root, segments)
        names = [self.chain.segments[s] for s in self.data.segment]
        kept = np.array([name in segments for name in names], dtype=bool)
        index = np.array([chain.segments.index(name) for name in names if name in segments], dtype=np.intp)
        order = np.flatnonzero(kept)[np.argsort(index, kind="stable")]
        placed = PlacedMarkers(np.sort(index, kind="stable"), self.data.local[order])
        data = MarkerData(placed, self.data.measured[order], self.data.weight[order])
        labels = tuple(self.labels[k] for k in order)
        return TrialProblem(name=self.name, chain=chain, basis=self.basis, data=data, labels=labels)

    def constants(self, parameters: Parameters) -> ChainConstants:
        """Chain constants for a set of parameters."""
        return self.chain.constants(parameters.joint, parameters.zero_angles)

    def values(self, parameters: Parameters) -> Array:
        """(np,) values of the free joint parameters, m and rad."""
        return parameters.joint[[JP_INDEX[name] for name in self.chain.free]]

    def with_free(self, free: tuple[str, ...]) -> TrialProblem:
        """The same trial with other joint parameters free."""
        return replace(self, chain=chain_of(self.chain.root, self.chain.segments, free))

    def places_in(self, free: Sequence[str]) -> IntArray:
        """(np,) places of this trial's free joint parameters in `free`, the ones that several trials share."""
        return np.array([free.index(name) for name in self.unknowns], dtype=np.intp)

    def with_weight(self, weight: Array) -> TrialProblem:
        """The same trial with other marker weights (nm, nf)."""
        return replace(self, data=replace(self.data, weight=weight))

    def scaled(self, share: float) -> TrialProblem:
        """The same trial with `share` times its cost."""
        smoothing = self.smoothing and self.smoothing.scaled(share)
        return replace(self, data=replace(self.data, weight=share * self.data.weight), smoothing=smoothing)

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
        for stretch in self.basis.stretches:
            frames = stretch.frames
            part = frame_equations(
                self.chain, constants, self._pairs, self.data.frames(frames), q[frames], curved=curved
            )
            assembler.add(sums, part, stretch)
            cost += part.cost
        equations = assembler.finish(sums, cost)
        if self.penalty is not None:
            self.penalty.add_to(equations.band)
            more, gradient = self.penalty.both(nodes)
            gradient += equations.node_gradient
            equations = replace(equations, cost=cost + more, node_gradient=gradient)
        if self.tissue is None:
            return equations
        return with_tissue_columns(self.chain, self.basis, self.data, self.tissue, equations, nodes, constants)

    def frame_hessians(self, q: Array, constants: ChainConstants) -> Array:
        """(nf, nq, nq) Gauss-Newton matrices of the frames by themselves, at coordinates (nf, nq)."""
        pairs, nq = self._pairs, len(self.chain.coordinates)
        out = np.zeros((len(q), nq, nq))
        first, second = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        shallow, deep = pairs.shallow[pairs.coordinates], pairs.deep[pairs.coordinates]
        for stretch in self.basis.stretches:
            frames = stretch.frames
            part = frame_equations(self.chain, constants, pairs, self.data.frames(frames), q[frames])
            entries = part.products(slice(nq), slice(nq))[:, shallow, deep]
            out[frames, first, second] = out[frames, second, first] = entries
        return out

    def gradient(self, nodes: Array, constants: ChainConstants) -> tuple[float, Array]:
        """Cost (m^2) and half gradient by the nodes (nn, nq), without the matrix."""
        cost, by_nodes, _ = self.both_gradients(nodes, constants)
        return cost, by_nodes

    def both_gradients(self, nodes: Array, constants: ChainConstants) -> tuple[float, Array, Array]:
        """Cost (m^2) and half gradients by the nodes (nn, nq) and by `unknowns` (np,)."""
        q = self.basis.evaluate(nodes)
        nq = len(self.chain.coordinates)
        cost, by_nodes, by_values = 0.0, np.zeros_like(nodes), np.zeros(len(self.chain.free))
        for stretch in self.basis.stretches:
            frames = stretch.frames
            part = frame_equations(
                self.chain, constants, self._pairs, self.data.frames(frames), q[frames], hessian=False
            )
            cost += part.cost
            stretch.add_gradient(by_nodes, part.gradient[:nq])
            by_values += part.gradient[nq:].sum(axis=1)
        if self.penalty is not None:
            more, gradient = self.penalty.both(nodes)
            cost, by_nodes = cost + more, by_nodes + gradient
        if self.tissue is not None:
            by_tissue = tissue_gradient(self.chain, self.data, self.tissue, q, constants)
            by_values = np.concatenate([by_values, by_tissue])
        return cost, by_nodes, by_values

    def cost(self, nodes: Array, constants: ChainConstants) -> float:
        """Sum of w |r|^2 and the penalty, m^2."""
        return self.marker_cost(nodes, constants) + (0.0 if self.penalty is None else self.penalty.cost(nodes))

    def marker_cost(self, nodes: Array, constants: ChainConstants) -> float:
        """Sum of w |r|^2, m^2."""
        q, total = self.basis.evaluate(nodes), 0.0
        for stretch in self.basis.stretches:
            frames = stretch.frames
            total += marker_cost(self.chain, constants, self.data.frames(frames), q[frames])
        return total

    def positions(self, nodes: Array, constants: ChainConstants) -> Array:
        """(nm, 3, nf) m, model markers."""
        q = self.basis.evaluate(nodes)
        out = np.empty(self.data.measured.shape)
        for stretch in self.basis.stretches:
            frames = stretch.frames
            part = self.data.frames(frames)
            out[:, :, frames] = marker_positions(self.chain, constants, part.placed, q[frames], part.shift)
        return out


FEWEST_FRAMES = 12
CARRIES_ITSELF = 0.5
"""Share of the frames from which a root is tracked by its own markers."""


def trial_problem(
    name: str,
    model: SubjectModel,
    recording: Recording,
    rule: NodeRule,
    *,
    root: str = "pelvis",
    segments: tuple[str, ...] = SEGMENTS,
    carrier: str = "",
) -> TrialProblem:
    """The markers of `segments` in a recording as a least-squares problem in the coordinates of that part.

    Markers that the recording lacks are left out, and those of trunk and arms where too few show the trunk
    (`trunk_support.py`); NaN positions get weight zero in their frames. Where the root shows three markers in less than
    half of the frames and a `carrier` is named, that segment carries the body: the joints between the two are held at
    zero, and only markers on the carrier and beyond it pull. Raises `InputError` where the root has no three markers
    and nothing carries it, or the recording is too short for a spline.
    """
    keep_freed_memory()
    if len(recording.time) < FEWEST_FRAMES:
        message = f"found {len(recording.time)} frames; allowed: at least {FEWEST_FRAMES}"
        raise InputError(message, source=recording.source, code=Code.TOO_LITTLE_SEEN)
    at = {label: i for i, label in enumerate(recording.labels)}
    chosen = [
        i
        for i, (label, segment) in enumerate(zip(model.markers.labels, model.markers.segments, strict=True))
        if segment in segments and label in at
    ]
    chain = chain_of(root, segments)
    pulls = seen_mask(recording.markers)[:, [at[model.markers.labels[i]] for i in chosen]].T
    pulls &= (model.markers.weight[chosen] > 0)[:, None]
    shown = telling(
        chain.segments, tuple(model.markers.segments[i] for i in chosen), model.markers.local[chosen], pulls
    )
    chosen = [i for i, kept in zip(chosen, shown, strict=True) if kept]
    index = np.array([chain.segments.index(model.markers.segments[i]) for i in chosen], dtype=np.intp)
    order = np.argsort(index, kind="stable")
    chosen = [chosen[k] for k in order]
    labels = tuple(model.markers.labels[i] for i in chosen)
    measured = recording.markers[:, [at[label] for label in labels]].transpose(1, 2, 0)
    seen = np.asarray(np.isfinite(measured).all(axis=1))
    weight = np.where(seen, model.markers.weight[chosen][:, None], 0.0)
    on_root = (index[order] == 0) & (weight > 0).any(axis=1)
    held: tuple[str, ...] = ()
    if carrier and carrier != root and shown_share(weight[index[order] == 0]) < CARRIES_ITSELF:
        root, held = carrier, _between(chain, carrier)
        weight[~_moved_with(chain, carrier)[index[order]]] = 0.0
        on_root = (index[order] == chain.segments.index(carrier)) & (weight > 0).any(axis=1)
    if on_root.sum() < FEWEST_MARKERS:
        found = ", ".join(np.array(labels)[on_root]) or "none"
        message = f"found {found} on {root}; allowed: at least 3 markers of {root} that are seen and have weight"
        raise InputError(message, source=recording.source, field="markers", code=Code.TOO_LITTLE_SEEN)
    basis = spline_basis(recording.time, rule.nodes(recording.time))
    placed = PlacedMarkers(index[order], model.markers.local[chosen])
    data = MarkerData(placed, np.ascontiguousarray(np.where(seen[:, None], measured, 0.0)), weight)
    return TrialProblem(name=name, chain=chain, basis=basis, data=data, labels=labels, held=held)


def shown_share(weight: Array) -> float:
    """Share of the frames in which three of a segment's markers, weights (nm, nf), are seen and pull."""
    return float(np.mean((weight > 0).sum(axis=0) >= FEWEST_MARKERS))


def _between(chain: Chain, segment: str) -> tuple[str, ...]:
    """Coordinates of the joints between the root and a segment."""
    moving = chain.support[: len(chain.coordinates), chain.segments.index(segment)] > 0
    return tuple(name for name, moves in zip(chain.coordinates, moving, strict=True) if moves)[len(ROOT_SUFFIXES) :]


def _moved_with(chain: Chain, segment: str) -> BoolArray:
    """(ns,) a segment and those beyond it, seen from the root: what moves all that moves the segment moves."""
    support = chain.support[: len(chain.coordinates)] > 0
    own = support[:, [chain.segments.index(segment)]]
    return np.asarray((support >= own).all(axis=0))
