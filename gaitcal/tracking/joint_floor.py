"""Each joint alone: what its segments can reach when nothing else holds them and its place suits
this one trial.

Three markers make a triangle that skin hardly bends: the rigid floor (`rigid.py`) of such a segment
says little of what a linkage can reach. A joint adds what it asks of two neighbours. For joint j
with its proximal segment free in the laboratory, the angles of every frame by themselves (no
splines) and all its joint parameters p_j free,

    C_j = min over p_j, poses, angles of  sum_f sum_m  (w_m / n_m) |r_mf|^2,     m on its two segments,

n_m the number of joints that carry marker m: its weight is shared, so that every marker counts once
over all joints. The whole linkage meets each joint's condition too. With R the least cost of the
segments alone and C that of any motion of the linkage, whatever its joint parameters,

    R  <=  sum_j C_j  <=  C.

The squared distance of a marker is the mean over its joints: its weighted sum of squares is the
middle of these. The markers of a segment in no joint keep their rigid distance. The ankle is its
two hinges together, as no marker follows the talus. Frames are eliminated, S = H_pp - sum_f H_pf
H_ff^-1 H_fp, on a descent that begins with the linkage's own motion and so ends below it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import Chain, get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import JOINTS, SEGMENTS, Joint, Source, list_joint_coordinates
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.rotations import compute_root_angles
from gaitcal.tracking import descent, marker_residual, motion, spline, start, trial_problem

MOST_FRAMES = 300  # looked at, evenly spaced: the floor of a longer trial is that of these
SETTINGS = descent.DescentSettings(gain=1e-3, most_steps=30, first_damping=1e-3, lowered_by=2.0)
"""The last step gains less than 1e-3 of the cost, 5e-4 of the RMS. Some damping is kept throughout:
no step is then taken on its prediction alone, which leads far along what two markers of a segment
do not tell."""
# of the largest diagonal entry: holds what no marker tells, like the turn of two about their line
RIDGE = 1e-10


@dataclass(frozen=True)
class JointFloor:
    """What the joints of a trial can reach, each by itself."""

    errors: (
        motion.MarkerErrors
    )  # root mean square over the joints of each marker; NaN also in frames that were not looked at
    joints: Mapping[str, float]  # joint -> m, RMS distance over the markers of its segments
    segments: tuple[
        str, ...
    ]  # that have markers in a joint; the others follow their markers as rigid segments

    def rms(self, *segments: str) -> float | None:
        """RMS distance (m) over markers with weight, of some segments or all; None where no joint
        says anything.
        """
        return (
            self.errors.rms(*segments)
            if not segments or set(segments) & set(self.segments)
            else None
        )


def joint_floor(
    problem: trial_problem.MotionProblem, parameters: Parameters, q: Array
) -> JointFloor | None:
    """Errors when each joint follows the markers of its segments alone; None where no joint has
    markers on both.

    `parameters`, `q`: where to start from: a model, and the coordinates (nf, nq) of this trial with
    it.
    """
    chain, rigid = problem.chain, motion.rigid_floor(problem)
    shown = {chain.segments[s] for s in problem.data.segment[problem.data.weight.any(axis=1)]}
    joints = {
        name: parts for name, parts in _joints_of(chain).items() if shown.issuperset(_ends(parts))
    }
    if not joints:
        return None
    frames = spline.spaced(len(q), MOST_FRAMES)
    data, placed = (
        problem.data.frames(frames),
        Kinematics(chain.body(parameters), q[frames], columns=False),
    )
    axes, origins = placed.axes, placed.origins
    carriers = [segment for parts in joints.values() for segment in _ends(parts)]
    shares = np.array([carriers.count(segment) for segment in rigid.segments], dtype=float)
    squares = np.where(shares[:, None] > 0, 0.0, rigid.distance[frames].T ** 2)
    found = {}
    for name, parts in joints.items():
        markers, s = (
            np.flatnonzero(np.isin(rigid.segments, _ends(parts))),
            chain.segments.index(parts[0].parent),
        )
        part = marker_residual.MarkerData(
            marker_residual.PlacedMarkers(data.segment[markers], data.local[markers]),
            data.measured[markers],
            data.weight[markers] / shares[markers, None],
            None if data.shift is None else data.shift[markers],
        )
        root = np.hstack([origins[s].T, compute_root_angles(axes[s].transpose(2, 1, 0))])
        turns = [
            chain.coordinates.index(name) for name in list_joint_coordinates(p.child for p in parts)
        ]
        distance = _JointAlone(
            parts, part, chain, parameters, np.hstack([root, q[frames][:, turns]])
        ).distances()
        squares[markers] += distance**2 / shares[markers, None]
        found[name] = float(np.sqrt(np.mean(distance[data.weight[markers] > 0] ** 2)))
    floor = np.full_like(rigid.distance, np.nan)
    floor[frames] = np.where(data.weight > 0, np.sqrt(squares), np.nan).T
    return JointFloor(
        replace(rigid, distance=floor), found, tuple(s for s in SEGMENTS if s in carriers)
    )


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


class _JointAlone:
    """The marker cost of one joint by the coordinates of all frames, followed by its joint
    parameters.
    """

    nothing_left = 0.0
    has_curvature = False

    def __init__(
        self,
        parts: tuple[Joint, ...],
        data: marker_residual.MarkerData,
        whole: Chain,
        parameters: Parameters,
        q: Array,
    ) -> None:
        """`data`: its markers in the segments of the `whole` chain; `q` (nf, nq): where its
        coordinates start.
        """
        names = tuple(
            e.name for p in parts for e in p.elements if e.source is Source.JOINT_PARAMETER
        )
        self.chain = chain = get_chain(
            parts[0].parent, (parts[0].parent, *(p.child for p in parts)), names
        )
        self.parameters, self.shape, self.body = parameters, q.shape, chain.body(parameters)
        segment = np.array([chain.segments.index(whole.segments[s]) for s in data.segment], np.intp)
        self.data = replace(data, placed=marker_residual.PlacedMarkers(segment, data.local))
        self.pairs = marker_residual.VariablePairs(
            chain, np.isin(np.arange(len(chain.segments)), segment)
        )
        self.first = np.append(q.ravel(), parameters.joint[[JP_INDEX[name] for name in chain.free]])

    def distances(self) -> Array:
        """(markers, nf) m, at the minimum."""
        parameters, q = self.split(descent.descend(self, self.first, SETTINGS).x)
        body = self.body.with_free(parameters)
        model = marker_residual.marker_positions(body, self.data.placed, q, self.data.shift)
        return np.linalg.norm(model - self.data.measured, axis=1)

    def split(self, x: Array) -> tuple[Parameters, Array]:
        """Parameters and coordinates (nf, nq)."""
        count = self.shape[0] * self.shape[1]
        return self.parameters.with_joint(self.chain.free, x[count:]), x[:count].reshape(self.shape)

    def equations(self, x: Array, *, hessian: bool) -> marker_residual.FrameEquations:
        """Of every frame, without the matrix or with it."""
        parameters, q = self.split(x)
        body = self.body.with_free(parameters)
        return marker_residual.frame_equations(body, self.pairs, self.data, q, hessian=hessian)

    def evaluate(self, x: Array) -> descent.Evaluation:
        return self.gradient(self.equations(x, hessian=False))

    def gradient(self, equations: marker_residual.FrameEquations) -> descent.Evaluation:
        """Cost and half gradient in the order of x."""
        nq = self.shape[1]
        by_frame, by_parameter = (
            equations.gradient[:nq].T.ravel(),
            equations.gradient[nq:].sum(axis=1),
        )
        return descent.Evaluation(equations.cost, np.append(by_frame, by_parameter))

    def linearise(self, x: Array, *, curved: bool) -> "_JointMatrix":
        return _JointMatrix(self, self.equations(x, hessian=True))


class _JointMatrix:
    """Its Gauss-Newton matrix: a block for each frame, bordered by the joint parameters."""

    spent = False

    def __init__(self, joint: _JointAlone, equations: marker_residual.FrameEquations) -> None:
        self.shape, self.evaluation = joint.shape, joint.gradient(equations)
        # (nf, n, n) right wherever the second variable moves nothing that the first leaves: beside
        # the root all do
        whole = equations.products()
        root, rest = slice(0, start.ROOT_COORDINATES), slice(start.ROOT_COORDINATES, None)
        whole[:, rest, root] = whole[:, root, rest].transpose(0, 2, 1)
        nq = self.shape[1]
        self.frames, self.border = whole[:, :nq, :nq], whole[:, :nq, nq:]
        self.corner = whole[:, nq:, nq:].sum(axis=0)

    def factor(self, damping: float) -> "_JointFactor":
        return _JointFactor(
            _damped(self.frames, damping), self.border, _damped(self.corner, damping)
        )


def _damped(matrix: Array, damping: float) -> Array:
    """The matrices (..., n, n) with a heavier diagonal."""
    diagonal = np.einsum("...ii->...i", matrix)
    return (
        matrix + np.eye(matrix.shape[-1]) * (damping * diagonal + RIDGE * diagonal.max())[..., None]
    )


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
        step = np.linalg.solve(
            self.reduced, by_parameter - by_frame @ self.sensitivity.reshape(-1, count)
        )
        return np.append(alone.ravel() - self.sensitivity.reshape(-1, count) @ step, step)
