"""Each joint alone: what its segments can reach when nothing else holds them and its place suits this one trial.

Three markers make a triangle that skin hardly bends: the rigid floor (`rigid.py`) of such a segment says little of what
a linkage can reach. A joint adds what it asks of two neighbours. For joint j with its proximal segment free in the
laboratory, the angles of every frame by themselves (no splines) and all its joint parameters p_j free,

    C_j = min over p_j, poses, angles of  sum_f sum_m  (w_m / n_m) |r_mf|^2,     m on its two segments,

n_m the number of joints that carry marker m: its weight is shared, so that every marker counts once over all joints.
The whole linkage meets each joint's condition too. With R the least cost of the segments alone and C that of any motion
of the linkage, whatever its joint parameters,

    R  <=  sum_j C_j  <=  C.

The squared distance of a marker is the mean over its joints: its weighted sum of squares is the middle of these. The
markers of a segment in no joint keep their rigid distance. The ankle is its two hinges together, as no marker follows
the talus. Frames are eliminated, S = H_pp - sum_f H_pf H_ff^-1 H_fp, on a descent that begins with the linkage's own
motion and so ends below it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.chain import Chain, chain_of, forward, root_angles, segment_poses
from gaitcal.model.linkage import JOINTS, SEGMENTS, Joint, Source
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.motion.descent import DescentSettings, Evaluation, descend
from gaitcal.motion.marker_residual import (
    FrameEquations,
    MarkerData,
    PlacedMarkers,
    VariablePairs,
    frame_equations,
    marker_positions,
)
from gaitcal.motion.motion import MarkerErrors, rigid_floor
from gaitcal.motion.start import ROOT_COORDINATES
from gaitcal.motion.trial_problem import TrialProblem

MOST_FRAMES = 300
"""Frames looked at, evenly spaced: the floor of a longer trial is that of these."""
SETTINGS = DescentSettings(gain=1e-3, most_steps=30, first_damping=1e-3, lowered_by=2.0)
"""The last step gains less than 1e-3 of the cost, 5e-4 of the RMS. Some damping is kept throughout: no step is then
taken on its promise alone, which leads far along what two markers of a segment do not tell."""
RIDGE = 1e-10
"""Of the largest diagonal entry: holds what no marker tells, like the turn of two markers about their line."""


@dataclass(frozen=True)
class JointFloor:
    """What the joints of a trial can reach, each by itself."""

    errors: MarkerErrors
    """Root mean square over the joints of each marker; NaN also in frames that were not looked at."""
    joints: Mapping[str, float]
    """Joint -> m, RMS distance over the markers of its segments."""
    segments: tuple[str, ...]
    """Those that have markers in one of the joints; the others follow their markers as rigid segments."""

    def rms(self, *segments: str) -> float | None:
        """RMS distance (m) over markers with weight, of some segments or all; None where no joint says anything."""
        told = not segments or any(s in self.segments for s in segments)
        return self.errors.rms(*segments) if told else None


def joint_floor(problem: TrialProblem, parameters: Parameters, q: Array) -> JointFloor | None:
    """Errors when each joint follows the markers of its segments alone; None where no joint has markers on both.

    Parameters
    ----------
    parameters, q : where to start from: a model, and the coordinates (nf, nq) of this trial with it.
    """
    chain, rigid = problem.chain, rigid_floor(problem)
    shown = {chain.segments[s] for s in problem.data.segment[problem.data.weight.any(axis=1)]}
    joints = {name: parts for name, parts in _joints_of(chain).items() if shown.issuperset(_ends(parts))}
    if not joints:
        return None
    frames = _frames(len(q))
    data, start = problem.data.frames(frames), _Start(parameters, chain, q[frames])
    carriers = [segment for parts in joints.values() for segment in _ends(parts)]
    shares = np.array([carriers.count(segment) for segment in rigid.segments], dtype=float)
    squares = np.where(shares[:, None] > 0, 0.0, rigid.distance[frames].T ** 2)
    found = {}
    for name, parts in joints.items():
        markers = np.flatnonzero(np.isin(rigid.segments, _ends(parts)))
        distance = _JointAlone(parts, data, markers, shares, start).distances()
        squares[markers] += distance**2 / shares[markers, None]
        found[name] = float(np.sqrt(np.mean(distance[data.weight[markers] > 0] ** 2)))
    floor = np.full_like(rigid.distance, np.nan)
    floor[frames] = np.where(data.weight > 0, np.sqrt(squares), np.nan).T
    return JointFloor(replace(rigid, distance=floor), found, tuple(s for s in SEGMENTS if s in carriers))


def _joints_of(chain: Chain) -> dict[str, tuple[Joint, ...]]:
    """The joints of a chain by name, each with its parts, proximal first: two for the ankle."""
    out: dict[str, tuple[Joint, ...]] = {}
    for joint in JOINTS:
        if joint.child in chain.segments and joint.child != chain.root:
            name = joint.name.replace("talocrural", "ankle").replace("subtalar", "ankle")
            out[name] = (*out.get(name, ()), joint)
    return out


def _ends(parts: tuple[Joint, ...]) -> tuple[str, str]:
    """The segments of a joint that carry markers."""
    return parts[0].parent, parts[-1].child


def _frames(count: int) -> IntArray:
    """Evenly spaced, at most `MOST_FRAMES`."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, MOST_FRAMES))).astype(np.intp))


class _Start:
    """The linkage's own motion, from which each joint's is read."""

    def __init__(self, parameters: Parameters, chain: Chain, q: Array) -> None:
        self.parameters, self.chain, self.q = parameters, chain, q
        constants = chain.constants(parameters.joint, parameters.zero_angles)
        self._axes, self._origins = segment_poses(chain, constants, forward(chain, constants, q))

    def coordinates(self, part: Chain) -> Array:
        """(nf, nq) of a part of the chain."""
        s = self.chain.segments.index(part.root)
        rotation, origin = self._axes[s].transpose(2, 1, 0), self._origins[s].T
        angles = [self.chain.coordinates.index(name) for name in part.coordinates[ROOT_COORDINATES:]]
        return np.hstack([origin, root_angles(rotation), self.q[:, angles]])


class _JointAlone:
    """The marker cost of one joint by the coordinates of all frames, followed by its joint parameters."""

    nothing_left = 0.0
    has_curvature = False

    def __init__(
        self, parts: tuple[Joint, ...], data: MarkerData, markers: IntArray, shares: Array, start: _Start
    ) -> None:
        """`markers`: the places of its markers in `data`; `shares`: (nm,) joints that each marker of `data` is in."""
        names = tuple(e.name for p in parts for e in p.elements if e.source is Source.JOINT_PARAMETER)
        self.chain = chain = chain_of(parts[0].parent, (parts[0].parent, *(p.child for p in parts)), names)
        self.parameters = start.parameters
        segment = np.array([chain.segments.index(start.chain.segments[s]) for s in data.segment[markers]], np.intp)
        self.data = MarkerData(
            PlacedMarkers(segment, data.local[markers]),
            data.measured[markers],
            data.weight[markers] / shares[markers, None],
        )
        self.pairs = VariablePairs(chain, np.isin(np.arange(len(chain.segments)), segment))
        q = start.coordinates(chain)
        self.shape = q.shape
        self.first = np.append(q.ravel(), self.parameters.joint[[JP_INDEX[name] for name in chain.free]])

    def distances(self) -> Array:
        """(markers, nf) m, at the minimum."""
        parameters, q = self.split(descend(self, self.first, SETTINGS).x)
        constants = self.chain.constants(parameters.joint, parameters.zero_angles)
        model = marker_positions(self.chain, constants, self.data.placed, q)
        out: Array = np.linalg.norm(model - self.data.measured, axis=1)
        return out

    def split(self, x: Array) -> tuple[Parameters, Array]:
        """Parameters and coordinates (nf, nq)."""
        count = self.shape[0] * self.shape[1]
        return self.parameters.with_joint(self.chain.free, x[count:]), x[:count].reshape(self.shape)

    def equations(self, x: Array, *, hessian: bool) -> FrameEquations:
        """Of every frame, without the matrix or with it."""
        parameters, q = self.split(x)
        constants = self.chain.constants(parameters.joint, parameters.zero_angles)
        return frame_equations(self.chain, constants, self.pairs, self.data, q, hessian=hessian)

    def evaluate(self, x: Array) -> Evaluation:
        return self.gradient(self.equations(x, hessian=False))

    def gradient(self, equations: FrameEquations) -> Evaluation:
        """Cost and half gradient in the order of x."""
        nq = self.shape[1]
        by_frame, by_parameter = equations.gradient[:nq].T.ravel(), equations.gradient[nq:].sum(axis=1)
        return Evaluation(equations.cost, np.append(by_frame, by_parameter))

    def linearise(self, x: Array, *, curved: bool) -> _JointMatrix:
        return _JointMatrix(self, self.equations(x, hessian=True))


class _JointMatrix:
    """Its Gauss-Newton matrix: a block for each frame, bordered by the joint parameters."""

    spent = False

    def __init__(self, joint: _JointAlone, equations: FrameEquations) -> None:
        self.shape, self.evaluation = joint.shape, joint.gradient(equations)
        whole = equations.products()
        """(nf, n, n) right wherever the second variable moves nothing that the first leaves: beside the root all do."""
        root, rest = slice(0, ROOT_COORDINATES), slice(ROOT_COORDINATES, None)
        whole[:, rest, root] = whole[:, root, rest].transpose(0, 2, 1)
        nq = self.shape[1]
        self.frames, self.border = whole[:, :nq, :nq], whole[:, :nq, nq:]
        self.corner = whole[:, nq:, nq:].sum(axis=0)

    def factor(self, damping: float) -> _JointFactor:
        return _JointFactor(_damped(self.frames, damping), self.border, _damped(self.corner, damping))


def _damped(matrix: Array, damping: float) -> Array:
    """The matrices (..., n, n) with a heavier diagonal."""
    diagonal = np.einsum("...ii->...i", matrix)
    out: Array = matrix + np.eye(matrix.shape[-1]) * (damping * diagonal + RIDGE * diagonal.max())[..., None]
    return out


class _JointFactor:
    """The frames eliminated."""

    def __init__(self, frames: Array, border: Array, corner: Array) -> None:
        self.inverse = np.linalg.inv(frames)
        self.sensitivity = self.inverse @ border
        count = border.shape[-1]
        self.reduced = corner - border.reshape(-1, count).T @ self.sensitivity.reshape(-1, count)

    def solve(self, gradient: Array) -> Array:
        nf, nq, count = self.sensitivity.shape
        by_frame, by_parameter = np.split(gradient, [nf * nq])
        alone = self.inverse @ by_frame.reshape(nf, nq, 1)
        step = np.linalg.solve(self.reduced, by_parameter - by_frame @ self.sensitivity.reshape(-1, count))
        return np.append(alone.ravel() - self.sensitivity.reshape(-1, count) @ step, step)
