"""One trial as a least-squares problem in its nodes and the joint parameters: what all solvers work on.

A `MotionProblem` sums, over the frames of a trial, the weighted squares of its marker residuals (`marker_residual.py`),
the penalty that limits its bandwidth (`spline.py`), and what is known of coordinates besides (`coordinate_prior.py`).
`trial_problem` makes one of a recording and a person's model: there a marker becomes a residual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import Recording
from gaitcal.model.chain import Chain, LinkageModel, chain_of
from gaitcal.model.linkage import LUMBAR, ROOT_SUFFIXES, SEGMENTS, coordinates_before, moved_joints
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.subject_model import PointNoise, SubjectModel
from gaitcal.motion import banded, coordinate_prior, marker_residual, rigid, start
from gaitcal.motion.soft_tissue import SecondaryColumns, SoftTissue, tissue_gradient, with_tissue_columns
from gaitcal.motion.spline import NodeRule, Smoothing, SplineBasis, spaced, spline_basis
from gaitcal.runtime import keep_freed_memory


@dataclass(frozen=True, kw_only=True)
class MotionProblem:
    """Markers of one trial, the part of the linkage that carries them, and the spline basis."""

    name: str
    chain: Chain
    basis: SplineBasis
    data: marker_residual.MarkerData
    labels: tuple[str, ...]  # (nm,) in the order of `data`
    tissue: SoftTissue | None = None  # unknown displacements of the markers
    smoothing: Smoothing | None = None  # what limits the bandwidth besides the nodes
    held: tuple[str, ...] = ()
    """Coordinates that stay zero though markers move with them: those between a root that is not seen and the segment
    that carries it."""
    priors: tuple[coordinate_prior.CoordinatePrior, ...] = ()  # what is known of coordinates besides
    posture: Mapping[str, float] = field(default_factory=dict)  # coordinate -> rad of the static posture
    noise: PointNoise | None = None  # of points that are no markers, which no skin moves

    @property
    def guessed(self) -> tuple[str, ...]:
        """Coordinates that the markers do not determine, which have a normal prior."""
        return tuple(name for prior in self.priors if prior.centred for name in prior.names)

    @cached_property
    def pulls(self) -> tuple[coordinate_prior.CoefficientPrior, ...]:
        """`priors` on the coefficients."""
        return tuple(prior.on(self.basis, self.chain.coordinates) for prior in self.priors)

    @cached_property
    def penalty(self) -> Smoothing | None:
        """`smoothing` of the active coordinates."""
        return None if self.smoothing is None else self.smoothing.of_active(self.active)

    @property
    def _penalties(self) -> tuple[Smoothing | coordinate_prior.CoefficientPrior, ...]:
        """All that costs besides markers."""
        return (*filter(None, [self.penalty]), *self.pulls)

    @cached_property
    def _pairs(self) -> marker_residual.VariablePairs:
        with_markers = np.zeros(len(self.chain.segments), dtype=bool)
        with_markers[self.data.segment[np.asarray(self.data.weight.any(axis=1))]] = True
        return marker_residual.VariablePairs(self.chain, with_markers, self.held)

    @cached_property
    def _assembler(self) -> banded.Assembler:
        pulled = np.array([self.chain.coordinates.index(name) for name in self.guessed], dtype=np.intp)
        return banded.Assembler(self._pairs, len(self.chain.coordinates), len(self.chain.free), self.basis, pulled)

    @property
    def active(self) -> BoolArray:
        """(nq,) coordinates that move a marker with weight; the others stay at their start."""
        return self._pairs.active[: len(self.chain.coordinates)]

    @property
    def secondary(self) -> SecondaryColumns | None:
        """What joints do besides moving along their coordinates, if that is unknown."""
        return self.tissue.secondary if self.tissue else None

    @property
    def unknowns(self) -> tuple[str, ...]:
        """(np,) names of what is sought besides the motion: free joint parameters, then soft tissue."""
        keys = dict(zip(self.secondary.names, self.secondary.keys, strict=True)) if self.secondary else {}
        return (*(keys.get(name, name) for name in self.chain.free), *(self.tissue.keys if self.tissue else ()))

    @property
    def joint_parameters(self) -> int:
        """How many of `unknowns` are joint parameters, which come first."""
        return sum(name in JP_INDEX for name in self.chain.free)

    def displaced(self, z: Array) -> MotionProblem:
        """The same trial with its secondary motions and soft tissue at z (nz,): `unknowns` but joint parameters."""
        data, count = self.data, 0
        if self.secondary is not None:
            count = len(self.secondary.names)
            data = replace(data, secondary=self.secondary.at(z[:count]))
        if self.tissue is not None and self.tissue.groups and len(z) > count:
            data = replace(data, shift=self.tissue.shift(z[count:], len(self.labels)))
        return self.with_data(data)

    def shifted(self, shift: Array | None) -> MotionProblem:
        """The same trial with its markers (nm, 3, nf) m from their places; None: in their places."""
        return self.with_data(replace(self.data, shift=shift))

    def with_data(self, data: marker_residual.MarkerData) -> MotionProblem:
        """The same trial with the same markers moved or measured elsewhere."""
        return self._alike(data=data)

    def _alike(self, **changed: Any) -> MotionProblem:
        """The same trial with what changes no pattern of the equations, which is not worked out again."""
        other = replace(self, **changed)
        other.__dict__.update(_pairs=self._pairs, _assembler=self._assembler)
        return other

    def part(self, root: str, segments: tuple[str, ...]) -> MotionProblem:
        """The same trial of some segments alone, `root` free in the laboratory; without soft tissue."""
        chain = chain_of(root, segments)
        names = [self.chain.segments[s] for s in self.data.segment]
        kept = np.array([name in segments for name in names], dtype=bool)
        index = np.array([chain.segments.index(name) for name in names if name in segments], dtype=np.intp)
        order = np.flatnonzero(kept)[np.argsort(index, kind="stable")]
        placed = marker_residual.PlacedMarkers(np.sort(index, kind="stable"), self.data.local[order])
        data = marker_residual.MarkerData(placed, self.data.measured[order], self.data.weight[order])
        return MotionProblem(
            name=self.name,
            chain=chain,
            basis=self.basis,
            data=data,
            labels=tuple(self.labels[k] for k in order),
            priors=tuple(p for p in (prior.of(chain.coordinates) for prior in self.priors) if p.names),
            posture=self.posture,
            noise=self.noise,
        )

    def followed(self, coefficients: Array) -> MotionProblem:
        """The same with a trunk that no marker determines upright over the pelvis of a motion (nn, nq)."""
        if not set(LUMBAR) & set(self.guessed):
            return self
        q, time = self.basis.evaluate(coefficients), self.basis.time
        kept = coordinate_prior.upright_trunk(time, q[:, len(ROOT_SUFFIXES) // 2 : len(ROOT_SUFFIXES)], self.posture)
        priors = []
        for prior in self.priors:
            if prior.centred and set(LUMBAR) & set(prior.names):
                course = np.repeat(prior.low[:1], len(time), axis=0)
                for k, name in enumerate(prior.names):
                    if name in LUMBAR:
                        course[:, k] = kept[:, LUMBAR.index(name)]
                prior = replace(prior, time=time, low=course, high=course)
            priors.append(prior)
        return self._alike(priors=tuple(priors))

    def body(self, parameters: Parameters) -> LinkageModel:
        """Build the linkage of this trial with a set of parameters."""
        chain = self.chain if self.data.secondary is None else self.chain.with_secondary()
        return chain.body(parameters)

    def values(self, parameters: Parameters) -> Array:
        """(np,) values of the free joint parameters, m and rad."""
        return parameters.joint[[JP_INDEX[name] for name in self.chain.free]]

    def with_free(self, free: tuple[str, ...]) -> MotionProblem:
        """The same trial with other joint parameters free, and if there are any, its secondary motions too."""
        data, secondary = self.data, self.secondary
        if free and secondary:
            free = (*(name for name in free if name in JP_INDEX), *secondary.names)
            if data.secondary is None:
                data = replace(data, secondary=secondary.at(np.zeros(len(secondary.names))))
        return replace(self, chain=chain_of(self.chain.root, self.chain.segments, free), data=data)

    def places_in(self, free: Sequence[str]) -> IntArray:
        """(np,) places of this trial's free joint parameters in `free`, the ones that several trials share."""
        return np.array([free.index(name) for name in self.unknowns], dtype=np.intp)

    def with_weight(self, weight: Array) -> MotionProblem:
        """The same trial with other marker weights (nm, nf)."""
        return replace(self, data=replace(self.data, weight=weight))

    def scaled(self, share: float) -> MotionProblem:
        """The same trial with `share` times its cost."""
        smoothing = self.smoothing and self.smoothing.scaled(share)
        priors = tuple(prior.scaled(share) for prior in self.priors)
        data = replace(self.data, weight=share * self.data.weight)
        return replace(self, data=data, smoothing=smoothing, priors=priors)

    def with_measured(self, measured: Array) -> MotionProblem:
        """The same trial with other measured markers (nm, 3, nf), m."""
        return self.with_data(replace(self.data, measured=measured))

    def equations(self, coefficients: Array, body: LinkageModel, *, curved: bool = False) -> banded.NormalEquations:
        """Normal equations at `coefficients` (nn, nq); `curved`: with half the whole Hessian, not Gauss-Newton's."""
        q = self.basis.evaluate(coefficients)
        equations = self._assembler.assembled(
            (self._frame_equations(stretch.frames, body, q, curved=curved), stretch) for stretch in self.basis.stretches
        )
        for penalty in self._penalties:
            penalty.add_to(equations.band, coefficients)
            cost, gradient = penalty.both(coefficients)
            equations = replace(equations, cost=equations.cost + cost, node_gradient=equations.node_gradient + gradient)
        if self.tissue is None or not self.tissue.groups:
            return equations
        return with_tissue_columns(body, self.basis, self.data, self.tissue, equations, coefficients, curved=curved)

    def _frame_equations(
        self, frames: slice, body: LinkageModel, q: Array, *, hessian: bool = True, curved: bool = False
    ) -> marker_residual.FrameEquations:
        data = self.data.frames(frames)
        return marker_residual.frame_equations(body, self._pairs, data, q[frames], hessian=hessian, curved=curved)

    def frame_hessians(self, q: Array, body: LinkageModel) -> Array:
        """(nf, nq, nq) Gauss-Newton matrices of the frames by themselves, at coordinates (nf, nq)."""
        pairs, nq = self._pairs, len(self.chain.coordinates)
        out = np.zeros((len(q), nq, nq))
        first, second = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        shallow, deep = pairs.shallow[pairs.coordinates], pairs.deep[pairs.coordinates]
        for stretch in self.basis.stretches:
            frames = stretch.frames
            entries = self._frame_equations(frames, body, q).products(slice(nq), slice(nq))[:, shallow, deep]
            out[frames, first, second] = out[frames, second, first] = entries
        return out

    def gradient(self, coefficients: Array, body: LinkageModel) -> tuple[float, Array]:
        """Cost (m^2) and half gradient by the coefficients (nn, nq), without the matrix."""
        cost, by_nodes, _ = self.both_gradients(coefficients, body)
        return cost, by_nodes

    def both_gradients(self, coefficients: Array, body: LinkageModel) -> tuple[float, Array, Array]:
        """Cost (m^2) and half gradients by the coefficients (nn, nq) and by `unknowns` (np,)."""
        q = self.basis.evaluate(coefficients)
        nq = len(self.chain.coordinates)
        cost, by_nodes, by_values = 0.0, np.zeros_like(coefficients), np.zeros(len(self.chain.free))
        for stretch in self.basis.stretches:
            part = self._frame_equations(stretch.frames, body, q, hessian=False)
            cost += part.cost
            stretch.add_gradient(by_nodes, part.gradient[:nq])
            by_values += part.gradient[nq:].sum(axis=1)
        for penalty in self._penalties:
            more, gradient = penalty.both(coefficients)
            cost, by_nodes = cost + more, by_nodes + gradient
        if self.tissue is not None and self.tissue.groups:
            by_tissue = tissue_gradient(body, self.data, self.tissue, q)
            by_values = np.concatenate([by_values, by_tissue])
        return cost, by_nodes, by_values

    def cost(self, coefficients: Array, body: LinkageModel) -> float:
        """Sum of w |r|^2, the penalty and what is known of coordinates, m^2."""
        return self.marker_cost(coefficients, body) + sum(penalty.both(coefficients)[0] for penalty in self._penalties)

    def marker_cost(self, coefficients: Array, body: LinkageModel) -> float:
        """Sum of w |r|^2, m^2."""
        r = self.positions(coefficients, body) - self.data.measured
        return float(np.vdot(self.data.weight[:, None] * r, r))

    def positions(self, coefficients: Array, body: LinkageModel) -> Array:
        """(nm, 3, nf) m, model markers."""
        q = self.basis.evaluate(coefficients)
        out = np.empty(self.data.measured.shape)
        for stretch in self.basis.stretches:
            frames, part = stretch.frames, self.data.frames(stretch.frames)
            out[:, :, frames] = marker_residual.marker_positions(
                body, part.placed, q[frames], part.shift, part.secondary
            )
        return out


FEWEST_FRAMES = 12
CARRIES_ITSELF = 0.5  # share of the frames from which a root is tracked by its own markers


def trial_problem(
    name: str,
    model: SubjectModel,
    recording: Recording,
    rule: NodeRule,
    *,
    root: str = "pelvis",
    segments: tuple[str, ...] = SEGMENTS,
    carrier: str = "",
    isolated: str | None = None,
) -> MotionProblem:
    """The markers of `segments` in a recording as a least-squares problem in the coordinates of that part.

    Markers that the recording lacks are left out; NaN positions get weight zero in their frames. Joints do not turn
    further than they can, but for the `isolated` one, which a trial moves as far as it goes; coordinates that the
    markers do not determine have a normal prior.
    Where the root shows three markers in less than half of the frames and a `carrier` is named, that segment carries
    the body: the joints between the two are held at zero, and only markers on the carrier and beyond it pull. Raises
    `InputError` where the root has no three markers and nothing carries it, or the recording is too short for a spline.
    """
    keep_freed_memory()
    if len(recording.time) < FEWEST_FRAMES:
        message = f"found {len(recording.time)} frames; allowed: at least {FEWEST_FRAMES}"
        raise InputError(message, source=recording.source, code=Code.TOO_LITTLE_SEEN)
    at = {label: i for i, label in enumerate(recording.labels)}
    chain = chain_of(root, segments)
    all_labels, segment_of = model.markers.labels, model.markers.segments
    chosen = [i for i, label in enumerate(all_labels) if segment_of[i] in segments and label in at]
    chosen.sort(key=lambda i: chain.segments.index(segment_of[i]))
    index = np.array([chain.segments.index(segment_of[i]) for i in chosen], dtype=np.intp)
    labels = tuple(all_labels[i] for i in chosen)
    measured = recording.markers[:, [at[label] for label in labels]].transpose(1, 2, 0)
    visible = np.asarray(np.isfinite(measured).all(axis=1))
    weight = np.where(visible, model.markers.weight[chosen][:, None], 0.0)
    on_root = (index == 0) & (weight > 0).any(axis=1)
    held: tuple[str, ...] = ()
    if carrier and carrier != root and shown_share(weight[index == 0]) < CARRIES_ITSELF:
        root, s = carrier, chain.segments.index(carrier)
        moves = chain.support[: len(chain.coordinates)] > 0  # (nq, ns)
        held = tuple(np.array(chain.coordinates)[moves[:, s]].tolist())[len(ROOT_SUFFIXES) :]
        # what moves all that moves the carrier lies beyond it, seen from the root
        beyond = np.asarray((moves >= moves[:, [s]]).all(axis=0))
        weight[~beyond[index]] = 0.0
        on_root = (index == s) & (weight > 0).any(axis=1)
    if on_root.sum() < rigid.FEWEST_MARKERS:
        found = ", ".join(np.array(labels)[on_root]) or "none"
        message = f"found {found} on {root}; allowed: at least 3 markers of {root} that are seen and have weight"
        raise InputError(message, source=recording.source, field="markers", code=Code.TOO_LITTLE_SEEN)
    basis = spline_basis(recording.time, rule.nodes(recording.time))
    placed = marker_residual.PlacedMarkers(index, model.markers.local[chosen])
    data = marker_residual.MarkerData(placed, np.ascontiguousarray(np.where(visible[:, None], measured, 0.0)), weight)
    moved = coordinates_before(joint.child for joint in moved_joints(isolated)) if isolated else ()
    problem = MotionProblem(
        name=name,
        chain=chain,
        basis=basis,
        data=data,
        labels=labels,
        held=held,
        priors=(coordinate_prior.walls(tuple(c for c in chain.coordinates if c not in moved), model.posture),),
        posture=model.posture,
        noise=model.noise,
    )
    return problem if held else _with_posture(problem, model)


def _with_posture(problem: MotionProblem, model: SubjectModel) -> MotionProblem:
    """A trial with what is known of coordinates that its markers do not determine."""
    chain, data = problem.chain, problem.data
    of_marker = [chain.segments[s] for s in data.segment]
    asked = coordinate_prior.coordinates_asked(chain.segments, of_marker, data.local, data.weight > 0)
    if not asked:
        return problem
    body = problem.body(model.nominal)
    frames = spaced(len(problem.basis.time), coordinate_prior.POSES)
    q = start.starting_coordinates(body, data.frames(frames))
    pulling = data.weight[:, frames] > 0
    on_arms = np.array([s.startswith(("upper_arm", "forearm")) for s in of_marker])

    def left_open(counted: BoolArray) -> tuple[str, ...]:
        alike = marker_residual.MarkerData(data.placed, data.measured[:, :, frames], counted.astype(float))
        some = replace(problem, basis=problem.basis.at(frames), data=alike)
        return coordinate_prior.undetermined(asked, chain.coordinates, some.frame_hessians(q, body))

    open_now = set(left_open(pulling)) - set(LUMBAR)
    if set(LUMBAR) & set(asked):
        open_now |= set(left_open(pulling & ~on_arms[:, None])) & set(LUMBAR)
    names = tuple(name for name in asked if name in open_now)
    if not names:
        return problem
    known = replace(problem, priors=(*problem.priors, coordinate_prior.about_posture(names, model.posture)))
    return known.followed(start.starting_nodes(body, data, problem.basis))


def shown_share(weight: Array) -> float:
    """Share of the frames in which three of a segment's markers, weights (nm, nf), are seen and pull."""
    return float(np.mean((weight > 0).sum(axis=0) >= rigid.FEWEST_MARKERS))
