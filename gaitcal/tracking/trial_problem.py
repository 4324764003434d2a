"""One trial as a least-squares problem in its spline coefficients and joint parameters.

A `MotionProblem` sums the weighted squares of the marker residuals (`marker_residual.py`), the
smoothing penalty (`spline.py`), and the priors on coordinates (`coordinate_prior.py`).
`build_trial_problem` makes one from a recording and a person's model: there a marker becomes a
residual.
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
from gaitcal.model.chain import Chain, LinkageModel, get_chain
from gaitcal.model.linkage import (
    LUMBAR,
    ROOT_SUFFIXES,
    SEGMENTS,
    list_joint_coordinates,
    list_moved_joints,
)
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.subject_model import PointNoise, SubjectModel
from gaitcal.runtime import keep_freed_memory
from gaitcal.tracking import banded, coordinate_prior, marker_residual, rigid, start
from gaitcal.tracking.soft_tissue import (
    SecondaryColumns,
    SoftTissue,
    add_tissue_columns,
    compute_tissue_gradient,
)
from gaitcal.tracking.spline import (
    ControlPointRule,
    Smoothing,
    SplineBasis,
    build_spline_basis,
    select_spaced_frames,
)


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
    """Coordinates that stay zero though markers move with them: those between a root that is not
    seen and the segment that carries it."""
    # what is known of coordinates besides
    priors: tuple[coordinate_prior.CoordinatePrior, ...] = ()
    # coordinate -> rad of the static posture
    posture: Mapping[str, float] = field(default_factory=dict)
    noise: PointNoise | None = None  # of points that are no markers, which no skin moves

    @property
    def guessed(self) -> tuple[str, ...]:
        """Coordinates that the markers do not determine, and that have a normal prior."""
        return tuple(name for prior in self.priors if prior.centred for name in prior.names)

    @cached_property
    def coefficient_priors(self) -> tuple[coordinate_prior.CoefficientPrior, ...]:
        """`priors`, expressed on the coefficients."""
        return tuple(prior.express_on(self.basis, self.chain.coordinates) for prior in self.priors)

    @cached_property
    def penalty(self) -> Smoothing | None:
        """`smoothing` of the active coordinates."""
        return None if self.smoothing is None else self.smoothing.restrict_to(self.active)

    @property
    def _penalties(self) -> tuple[Smoothing | coordinate_prior.CoefficientPrior, ...]:
        """All costs besides that of the markers."""
        return (*filter(None, [self.penalty]), *self.coefficient_priors)

    @cached_property
    def _pairs(self) -> marker_residual.VariablePairs:
        with_markers = np.zeros(len(self.chain.segments), dtype=bool)
        with_markers[self.data.segment[np.asarray(self.data.weight.any(axis=1))]] = True
        return marker_residual.VariablePairs(self.chain, with_markers, self.held)

    @cached_property
    def _assembler(self) -> banded.Assembler:
        pulled = np.array(
            [self.chain.coordinates.index(name) for name in self.guessed], dtype=np.intp
        )
        return banded.Assembler(
            self._pairs, len(self.chain.coordinates), len(self.chain.free), self.basis, pulled
        )

    @property
    def active(self) -> BoolArray:
        """(nq,) coordinates that move a marker with weight; the others stay at their start."""
        return self._pairs.active[: len(self.chain.coordinates)]

    @property
    def secondary(self) -> SecondaryColumns | None:
        """Secondary motions of the joints, if they are unknowns."""
        return self.tissue.secondary if self.tissue else None

    @property
    def unknowns(self) -> tuple[str, ...]:
        """(np,) names of unknowns besides the motion: free joint parameters, then soft tissue."""
        keys = (
            dict(zip(self.secondary.names, self.secondary.keys, strict=True))
            if self.secondary
            else {}
        )
        return (
            *(keys.get(name, name) for name in self.chain.free),
            *(self.tissue.keys if self.tissue else ()),
        )

    @property
    def joint_parameters(self) -> int:
        """Number of joint parameters among `unknowns`, where they come first."""
        return sum(name in JP_INDEX for name in self.chain.free)

    def displace(self, z: Array) -> MotionProblem:
        """Set secondary motions and soft tissue.

        Parameters
        ----------
        z
            (nz,) m, rad: `unknowns` without the joint parameters.

        Returns
        -------
        MotionProblem
            The same trial with displaced markers.
        """
        data, count = self.data, 0
        if self.secondary is not None:
            count = len(self.secondary.names)
            data = replace(data, secondary=self.secondary.evaluate(z[:count]))
        if self.tissue is not None and self.tissue.groups and len(z) > count:
            data = replace(data, shift=self.tissue.compute_shift(z[count:], len(self.labels)))
        return self.with_data(data)

    def shift_markers(self, shift: Array | None) -> MotionProblem:
        """Set the displacements (nm, 3, nf) m of the markers in their segments; None: none."""
        return self.with_data(replace(self.data, shift=shift))

    def with_data(self, data: marker_residual.MarkerData) -> MotionProblem:
        """Replace positions or measurements of the same markers."""
        return self._replace_data(data=data)

    def _replace_data(self, **changed: Any) -> MotionProblem:
        """Replace fields that leave the sparsity pattern unchanged, which is kept."""
        other = replace(self, **changed)
        other.__dict__.update(_pairs=self._pairs, _assembler=self._assembler)
        return other

    def extract_part(self, root: str, segments: tuple[str, ...]) -> MotionProblem:
        """Extract the problem of some segments alone, without soft tissue.

        Parameters
        ----------
        root
            Base segment of the part, free in the laboratory.
        segments
            Segments of the part.

        Returns
        -------
        MotionProblem
        """
        chain = get_chain(root, segments)
        names = [self.chain.segments[s] for s in self.data.segment]
        kept = np.array([name in segments for name in names], dtype=bool)
        index = np.array(
            [chain.segments.index(name) for name in names if name in segments], dtype=np.intp
        )
        order = np.flatnonzero(kept)[np.argsort(index, kind="stable")]
        placed = marker_residual.PlacedMarkers(
            np.sort(index, kind="stable"), self.data.local[order]
        )
        data = marker_residual.MarkerData(
            placed, self.data.measured[order], self.data.weight[order]
        )
        priors = [prior.select(chain.coordinates) for prior in self.priors]
        return MotionProblem(
            name=self.name,
            chain=chain,
            basis=self.basis,
            data=data,
            labels=tuple(self.labels[k] for k in order),
            priors=tuple(prior for prior in priors if prior.names),
            posture=self.posture,
            noise=self.noise,
        )

    def follow_pelvis(self, coefficients: Array) -> MotionProblem:
        """Centre the prior of an undetermined trunk upright over the pelvis of a motion.

        Parameters
        ----------
        coefficients
            (nn, nq) m, rad, of that motion.

        Returns
        -------
        MotionProblem
            The same object where markers determine the trunk.
        """
        if not set(LUMBAR) & set(self.guessed):
            return self
        q, time = self.basis.evaluate(coefficients), self.basis.time
        kept = coordinate_prior.compute_upright_trunk(
            time, q[:, len(ROOT_SUFFIXES) // 2 : len(ROOT_SUFFIXES)], self.posture
        )
        priors = []
        for prior in self.priors:
            if prior.centred and set(LUMBAR) & set(prior.names):
                course = np.repeat(prior.low[:1], len(time), axis=0)
                for k, name in enumerate(prior.names):
                    if name in LUMBAR:
                        course[:, k] = kept[:, LUMBAR.index(name)]
                prior = replace(prior, time=time, low=course, high=course)
            priors.append(prior)
        return self._replace_data(priors=tuple(priors))

    def build_body(self, parameters: Parameters) -> LinkageModel:
        """Build the linkage of this trial.

        Parameters
        ----------
        parameters
            Joint and inertial parameters.

        Returns
        -------
        LinkageModel
        """
        chain = self.chain if self.data.secondary is None else self.chain.with_secondary()
        return chain.body(parameters)

    def get_values(self, parameters: Parameters) -> Array:
        """Get the values (np,) of the free joint parameters, m and rad."""
        return parameters.joint[[JP_INDEX[name] for name in self.chain.free]]

    def with_free(self, free: tuple[str, ...]) -> MotionProblem:
        """Set the free joint parameters; secondary motions are free if there are any.

        Parameters
        ----------
        free
            Names of joint parameters and of shared unknowns.

        Returns
        -------
        MotionProblem
        """
        data, secondary = self.data, self.secondary
        if free and secondary:
            free = (*(name for name in free if name in JP_INDEX), *secondary.names)
            if data.secondary is None:
                data = replace(data, secondary=secondary.evaluate(np.zeros(len(secondary.names))))
        return replace(self, chain=get_chain(self.chain.root, self.chain.segments, free), data=data)

    def locate_in(self, free: Sequence[str]) -> IntArray:
        """Locate the unknowns of this trial among those that several trials share.

        Parameters
        ----------
        free
            Names of the shared unknowns.

        Returns
        -------
        (np,) array of int
            Indices in `free`.
        """
        return np.array([free.index(name) for name in self.unknowns], dtype=np.intp)

    def with_weight(self, weight: Array) -> MotionProblem:
        """Replace the marker weights (nm, nf)."""
        return replace(self, data=replace(self.data, weight=weight))

    def scale_cost(self, share: float) -> MotionProblem:
        """Multiply the cost by `share`."""
        smoothing = self.smoothing and self.smoothing.scale_cost(share)
        priors = tuple(prior.scale_cost(share) for prior in self.priors)
        data = replace(self.data, weight=share * self.data.weight)
        return replace(self, data=data, smoothing=smoothing, priors=priors)

    def with_measured(self, measured: Array) -> MotionProblem:
        """Replace the measured positions (nm, 3, nf), m."""
        return self.with_data(replace(self.data, measured=measured))

    def assemble_equations(
        self, coefficients: Array, body: LinkageModel, *, curved: bool = False
    ) -> banded.NormalEquations:
        """Assemble the normal equations.

        Parameters
        ----------
        coefficients
            (nn, nq) m, rad.
        body
            Linkage with its joint parameters.
        curved
            Half the full Hessian instead of the Gauss-Newton matrix.

        Returns
        -------
        NormalEquations
        """
        equations = self.assemble_motion_equations(coefficients, body, curved=curved)
        return self.add_tissue(equations, coefficients, body, curved=curved)

    def assemble_motion_equations(
        self, coefficients: Array, body: LinkageModel, *, curved: bool = False
    ) -> banded.NormalEquations:
        """Assemble the normal equations as `assemble_equations`, without columns of soft tissue."""
        q = self.basis.evaluate(coefficients)
        equations = self._assembler.assemble(
            (self._assemble_frames(stretch.frames, body, q, curved=curved), stretch)
            for stretch in self.basis.stretches
        )
        for penalty in self._penalties:
            penalty.add_to(equations.band, coefficients)
            cost, gradient = penalty.evaluate(coefficients)
            equations = replace(
                equations,
                cost=equations.cost + cost,
                node_gradient=equations.node_gradient + gradient,
            )
        return equations

    def add_tissue(
        self,
        equations: banded.NormalEquations,
        coefficients: Array,
        body: LinkageModel,
        *,
        curved: bool = False,
    ) -> banded.NormalEquations:
        """Add the columns of soft tissue to `assemble_motion_equations` at the same point."""
        if self.tissue is None or not self.tissue.groups:
            return equations
        return add_tissue_columns(
            body, self.basis, self.data, self.tissue, equations, coefficients, curved=curved
        )

    def _assemble_frames(
        self,
        frames: slice,
        body: LinkageModel,
        q: Array,
        *,
        hessian: bool = True,
        curved: bool = False,
    ) -> marker_residual.FrameEquations:
        data = self.data.select_frames(frames)
        return marker_residual.assemble_frame_equations(
            body, self._pairs, data, q[frames], hessian=hessian, curved=curved
        )

    def compute_frame_hessians(self, q: Array, body: LinkageModel) -> Array:
        """Compute the Gauss-Newton matrix of each frame by itself.

        Parameters
        ----------
        q
            (nf, nq) coordinates, m and rad.
        body
            Linkage with its joint parameters.

        Returns
        -------
        (nf, nq, nq) array
        """
        pairs, nq = self._pairs, len(self.chain.coordinates)
        out = np.zeros((len(q), nq, nq))
        first, second = pairs.first[pairs.coordinates], pairs.second[pairs.coordinates]
        shallow, deep = pairs.shallow[pairs.coordinates], pairs.deep[pairs.coordinates]
        for stretch in self.basis.stretches:
            frames = stretch.frames
            entries = self._assemble_frames(frames, body, q).compute_products(slice(nq), slice(nq))[
                :, shallow, deep
            ]
            out[frames, first, second] = out[frames, second, first] = entries
        return out

    def compute_gradient(self, coefficients: Array, body: LinkageModel) -> tuple[float, Array]:
        """Compute the cost and half its gradient by the coefficients, without the matrix.

        Parameters
        ----------
        coefficients
            (nn, nq) m, rad.
        body
            Linkage with its joint parameters.

        Returns
        -------
        float
            m^2.
        (nn, nq) array
        """
        cost, by_nodes, _ = self.compute_gradients(coefficients, body)
        return cost, by_nodes

    def compute_gradients(
        self, coefficients: Array, body: LinkageModel
    ) -> tuple[float, Array, Array]:
        """Compute the cost and half its gradients, without the matrix.

        Returns
        -------
        float
            m^2.
        (nn, nq) array
            By the coefficients.
        (np,) array
            By `unknowns`.
        """
        q = self.basis.evaluate(coefficients)
        nq = len(self.chain.coordinates)
        cost, by_nodes, by_values = 0.0, np.zeros_like(coefficients), np.zeros(len(self.chain.free))
        for stretch in self.basis.stretches:
            part = self._assemble_frames(stretch.frames, body, q, hessian=False)
            cost += part.cost
            stretch.add_gradient(by_nodes, part.gradient[:nq])
            by_values += part.gradient[nq:].sum(axis=1)
        for penalty in self._penalties:
            more, gradient = penalty.evaluate(coefficients)
            cost, by_nodes = cost + more, by_nodes + gradient
        if self.tissue is not None and self.tissue.groups:
            by_tissue = compute_tissue_gradient(body, self.data, self.tissue, q)
            by_values = np.concatenate([by_values, by_tissue])
        return cost, by_nodes, by_values

    def compute_cost(self, coefficients: Array, body: LinkageModel) -> float:
        """Compute the sum of w |r|^2, the penalty and the priors, m^2."""
        return self.compute_marker_cost(coefficients, body) + sum(
            penalty.evaluate(coefficients)[0] for penalty in self._penalties
        )

    def compute_marker_cost(self, coefficients: Array, body: LinkageModel) -> float:
        """Compute the sum of w |r|^2.

        Parameters
        ----------
        coefficients
            (nn, nq) m, rad.
        body
            Linkage with its joint parameters.

        Returns
        -------
        float
            m^2.
        """
        r = self.compute_positions(coefficients, body) - self.data.measured
        return float(np.vdot(self.data.weight[:, None] * r, r))

    def compute_positions(self, coefficients: Array, body: LinkageModel) -> Array:
        """Compute the positions of the model markers.

        Parameters
        ----------
        coefficients
            (nn, nq) m, rad.
        body
            Linkage with its joint parameters.

        Returns
        -------
        (nm, 3, nf) array
            m, laboratory axes.
        """
        q = self.basis.evaluate(coefficients)
        out = np.empty(self.data.measured.shape)
        for stretch in self.basis.stretches:
            frames, part = stretch.frames, self.data.select_frames(stretch.frames)
            out[:, :, frames] = marker_residual.compute_marker_positions(
                body, part.placed, q[frames], part.shift, part.secondary
            )
        return out


FEWEST_TRACKED_FRAMES = 12
"""Frames that a trial needs for its splines."""
MIN_ROOT_VISIBLE_SHARE = 0.5
"""Share of frames with three visible markers from which the base segment is tracked by these."""


def build_trial_problem(
    name: str,
    model: SubjectModel,
    recording: Recording,
    rule: ControlPointRule,
    *,
    root: str = "pelvis",
    segments: tuple[str, ...] = SEGMENTS,
    fallback_base_segment: str = "",
    isolated: str | None = None,
) -> MotionProblem:
    """Build the least-squares problem of a recording in the coordinates of some segments.

    Parameters
    ----------
    name
        Name of the trial.
    model
        The person's model.
    recording
        Measured markers. Markers that it lacks are left out; NaN positions have weight zero.
    rule
        Number of control points.
    root
        Base segment, free in the laboratory.
    segments
        Segments of the part.
    fallback_base_segment
        Segment that carries the body where fewer than half of the frames show three markers of
        `root`. The joints between the two are then held at zero, and only markers on or beyond
        `fallback_base_segment` have weight.
    isolated
        Joint of a functional trial, which has no joint limits; None: all joints have them.

    Returns
    -------
    MotionProblem
        Coordinates that the markers do not determine have a normal prior.

    Raises
    ------
    InputError
        The base segment has no three markers and no `fallback_base_segment`, or the recording is
        too short.
    """
    keep_freed_memory()
    if len(recording.time) < FEWEST_TRACKED_FRAMES:
        message = f"found {len(recording.time)} frames; allowed: at least {FEWEST_TRACKED_FRAMES}"
        raise InputError(message, source=recording.source, code=Code.TOO_LITTLE_SEEN)
    # Markers of the model that are recorded, in the order of the segments along the chain.
    at = {label: i for i, label in enumerate(recording.labels)}
    chain = get_chain(root, segments)
    all_labels, segment_of = model.markers.labels, model.markers.segments
    chosen = [i for i, label in enumerate(all_labels) if segment_of[i] in segments and label in at]
    chosen.sort(key=lambda i: chain.segments.index(segment_of[i]))
    index = np.array([chain.segments.index(segment_of[i]) for i in chosen], dtype=np.intp)
    labels = tuple(all_labels[i] for i in chosen)
    # Measured positions (nm, 3, nf); samples in gaps have weight zero.
    measured = recording.markers[:, [at[label] for label in labels]].transpose(1, 2, 0)
    visible = np.asarray(np.isfinite(measured).all(axis=1))
    weight = np.where(visible, model.markers.weight[chosen][:, None], 0.0)
    on_root = (index == 0) & (weight > 0).any(axis=1)
    # A base segment without enough visible markers is replaced by another one.
    base_segment = root
    held: tuple[str, ...] = ()
    if (
        fallback_base_segment
        and fallback_base_segment != root
        and compute_visible_share(weight[index == 0]) < MIN_ROOT_VISIBLE_SHARE
    ):
        base_segment = fallback_base_segment
        s = chain.segments.index(base_segment)
        # moves: (nq, ns) whether a coordinate moves a segment. Joints up to the new one are held.
        moves = chain.support[: len(chain.coordinates)] > 0
        held = tuple(np.array(chain.coordinates)[moves[:, s]].tolist())[len(ROOT_SUFFIXES) :]
        # Segments beyond it: moved by all coordinates that move it.
        beyond = np.asarray((moves >= moves[:, [s]]).all(axis=0))
        weight[~beyond[index]] = 0.0
        on_root = (index == s) & (weight > 0).any(axis=1)
    if on_root.sum() < rigid.FEWEST_MARKERS:
        found = ", ".join(np.array(labels)[on_root]) or "none"
        message = (
            f"found {found} on {base_segment}; allowed: at least 3 markers of {base_segment} that "
            "are visible and have weight"
        )
        raise InputError(
            message, source=recording.source, field="markers", code=Code.TOO_LITTLE_SEEN
        )
    basis = build_spline_basis(recording.time, rule.count_control_points(recording.time))
    placed = marker_residual.PlacedMarkers(index, model.markers.local[chosen])
    data = marker_residual.MarkerData(
        placed, np.ascontiguousarray(np.where(visible[:, None], measured, 0.0)), weight
    )
    # Joint limits, except of the joint of a functional trial.
    moved = (
        list_joint_coordinates(joint.child for joint in list_moved_joints(isolated))
        if isolated
        else ()
    )
    problem = MotionProblem(
        name=name,
        chain=chain,
        basis=basis,
        data=data,
        labels=labels,
        held=held,
        priors=(
            coordinate_prior.build_joint_limits(
                tuple(c for c in chain.coordinates if c not in moved), model.posture
            ),
        ),
        posture=model.posture,
        noise=model.noise,
    )
    return problem if held else _add_posture_priors(problem, model)


def _add_posture_priors(problem: MotionProblem, model: SubjectModel) -> MotionProblem:
    """Add normal priors to the coordinates that the markers do not determine."""
    chain, data = problem.chain, problem.data
    of_marker = [chain.segments[s] for s in data.segment]
    candidates = coordinate_prior.list_prior_candidates(
        chain.segments, of_marker, data.local, data.weight > 0
    )
    if not candidates:
        return problem
    body = problem.build_body(model.nominal)
    frames = select_spaced_frames(len(problem.basis.time), coordinate_prior.POSES)
    q = start.find_start_coordinates(body, data.select_frames(frames))
    visible = data.weight[:, frames] > 0
    on_arms = np.array([s.startswith(("upper_arm", "forearm")) for s in of_marker])

    def find_undetermined(counted: BoolArray) -> tuple[str, ...]:
        # Every marker that counts has the same weight.
        equal_weights = marker_residual.MarkerData(
            data.placed, data.measured[:, :, frames], counted.astype(float)
        )
        some = replace(problem, basis=problem.basis.select_frames(frames), data=equal_weights)
        return coordinate_prior.select_undetermined(
            candidates, chain.coordinates, some.compute_frame_hessians(q, body)
        )

    # Markers of the arms do not count for the lumbar joint.
    undetermined = set(find_undetermined(visible)) - set(LUMBAR)
    if set(LUMBAR) & set(candidates):
        undetermined |= set(find_undetermined(visible & ~on_arms[:, None])) & set(LUMBAR)
    names = tuple(name for name in candidates if name in undetermined)
    if not names:
        return problem
    with_priors = replace(
        problem,
        priors=(*problem.priors, coordinate_prior.build_posture_prior(names, model.posture)),
    )
    return with_priors.follow_pelvis(start.find_start_coefficients(body, data, problem.basis))


def compute_visible_share(weight: Array) -> float:
    """Compute the share of the frames with three visible markers, for weights (nm, nf)."""
    return float(np.mean((weight > 0).sum(axis=0) >= rigid.FEWEST_MARKERS))
