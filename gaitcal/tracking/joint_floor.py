"""Lowest marker distances that each joint alone can reach in one trial.

Three markers form a triangle that soft tissue hardly deforms, so the rigid floor (`rigid.py`) of
their segment is far below what a linkage can reach. A joint adds its condition on two neighbouring
segments. For joint j with its proximal segment free in the laboratory, independent angles in every
frame (no splines) and all its joint parameters p_j free,

    C_j = min over p_j, poses, angles of  sum_f sum_m  (w_m / n_m) |r_mf|^2

with m on its two segments.

n_m is the number of joints that carry marker m: its weight is shared, so that every marker counts
once over all joints. The whole linkage satisfies the condition of every joint. With R the least
cost of the segments alone and C that of any motion of the linkage, whatever its joint parameters,

    R  <=  sum_j C_j  <=  C.

The squared distance of a marker is the mean over its joints, so its weighted sum of squares is the
middle of these. Markers of a segment in no joint keep their rigid distance. The ankle is its two
hinges together, as no marker follows the talus. Frames are eliminated, S = H_pp - sum_f H_pf
H_ff^-1 H_fp. The descent begins with the motion of the linkage and therefore ends below it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, compute_rms
from gaitcal.model.chain import Chain, get_chain
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import JOINTS, SEGMENTS, Joint, Source, list_joint_coordinates
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.rotations import compute_root_angles
from gaitcal.tracking import descent, marker_residual, motion, spline, start, trial_problem

MOST_FRAMES = 300
"""Frames of a trial that are used, evenly spaced."""
SETTINGS = descent.DescentSettings(gain=1e-3, most_steps=30, first_damping=1e-3, lowered_by=2.0)
"""The last step gains less than 1e-3 of the cost, 5e-4 of the RMS. Some damping is kept throughout,
so that no step is taken on its prediction alone: two markers of a segment leave a rotation
undetermined, along which such a step leads far."""
RIDGE = 1e-10
"""Share of the largest diagonal entry that is added, for undetermined directions such as the
rotation of two markers about their line."""


@dataclass(frozen=True)
class JointFloor:
    """Lowest marker distances that the joints of a trial can reach, each by itself."""

    # root mean square over the joints of each marker; NaN also in frames that were not looked at
    errors: motion.MarkerErrors
    joints: Mapping[str, float]  # joint -> m, RMS distance over the markers of its segments
    # that have markers in a joint; the others follow their markers as rigid segments
    segments: tuple[str, ...]

    def rms(self, *segments: str) -> float | None:
        """Compute the RMS distance over markers with weight.

        Parameters
        ----------
        *segments
            Segments to include; all unless given.

        Returns
        -------
        float or None
            m; None where no joint carries markers of these segments.
        """
        return (
            self.errors.rms(*segments)
            if not segments or set(segments) & set(self.segments)
            else None
        )


def compute_joint_floor(
    problem: trial_problem.MotionProblem, parameters: Parameters, q: Array
) -> JointFloor | None:
    """Compute marker distances when each joint follows the markers of its segments alone.

    Parameters
    ----------
    problem
        The trial.
    parameters
        Joint parameters to start from.
    q
        (nf, nq) m, rad: coordinates of the trial with these parameters.

    Returns
    -------
    JointFloor or None
        None where no joint has markers on both of its segments.
    """
    chain, rigid = problem.chain, motion.compute_rigid_floor(problem)
    shown = {chain.segments[s] for s in problem.data.segment[problem.data.weight.any(axis=1)]}
    all_joints = _list_joints(chain)
    joints = {
        name: parts
        for name, parts in all_joints.items()
        if shown.issuperset(_get_end_segments(parts))
    }
    if not joints:
        return None
    frames = spline.select_spaced_frames(len(q), MOST_FRAMES)
    data, placed = (
        problem.data.select_frames(frames),
        Kinematics(chain.body(parameters), q[frames], columns=False),
    )
    axes, origins = placed.axes, placed.origins
    carriers = [segment for parts in joints.values() for segment in _get_end_segments(parts)]
    shares = np.array([carriers.count(segment) for segment in rigid.segments], dtype=float)
    squares = np.where(shares[:, None] > 0, 0.0, rigid.distance[frames].T ** 2)
    found = {}
    for name, parts in joints.items():
        markers = np.flatnonzero(np.isin(rigid.segments, _get_end_segments(parts)))
        # The weight of a marker is shared among the joints that carry it.
        part = marker_residual.MarkerData(
            marker_residual.PlacedMarkers(data.segment[markers], data.local[markers]),
            data.measured[markers],
            data.weight[markers] / shares[markers, None],
            None if data.shift is None else data.shift[markers],
        )
        # The joint starts from the motion of the linkage: pose of its proximal segment, and angles.
        s = chain.segments.index(parts[0].parent)
        root = np.hstack([origins[s].T, compute_root_angles(axes[s].transpose(2, 1, 0))])
        names = list_joint_coordinates([p.child for p in parts])
        columns = [chain.coordinates.index(coordinate) for coordinate in names]
        q_joint = np.hstack([root, q[frames][:, columns]])
        distance = _JointAlone(parts, part, chain, parameters, q_joint).compute_distances()
        squares[markers] += distance**2 / shares[markers, None]
        found[name] = float(compute_rms(distance[data.weight[markers] > 0]))
    floor = np.full_like(rigid.distance, np.nan)
    floor[frames] = np.where(data.weight > 0, np.sqrt(squares), np.nan).T
    return JointFloor(
        replace(rigid, distance=floor), found, tuple(s for s in SEGMENTS if s in carriers)
    )


def _list_joints(chain: Chain) -> dict[str, tuple[Joint, ...]]:
    """List the joints of a chain by name, with their parts, proximal first: two for the ankle."""
    out: dict[str, tuple[Joint, ...]] = {}
    for joint in JOINTS:
        if joint.child in chain.segments and joint.child != chain.root:
            name = joint.name.replace("talocrural", "ankle").replace("subtalar", "ankle")
            out[name] = (*out.get(name, ()), joint)
    return out


def _get_end_segments(parts: tuple[Joint, ...]) -> tuple[str, str]:
    """Get the two segments of a joint that carry markers."""
    return parts[0].parent, parts[-1].child


class _JointAlone:
    """Marker cost of one joint by the coordinates of all frames and its joint parameters."""

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

    def compute_distances(self) -> Array:
        """Compute (markers, nf) m at the minimum."""
        parameters, q = self.split(descent.descend(self, self.first, SETTINGS).x)
        body = self.body.with_free(parameters)
        model = marker_residual.compute_marker_positions(body, self.data.placed, q, self.data.shift)
        return np.linalg.norm(model - self.data.measured, axis=1)

    def split(self, x: Array) -> tuple[Parameters, Array]:
        """Split x into parameters and coordinates (nf, nq)."""
        count = self.shape[0] * self.shape[1]
        return self.parameters.with_joint(self.chain.free, x[count:]), x[:count].reshape(self.shape)

    def assemble_equations(self, x: Array, *, hessian: bool) -> marker_residual.FrameEquations:
        """Assemble the equations of every frame, with or without the matrix."""
        parameters, q = self.split(x)
        body = self.body.with_free(parameters)
        return marker_residual.assemble_frame_equations(
            body, self.pairs, self.data, q, hessian=hessian
        )

    def evaluate(self, x: Array) -> descent.Evaluation:
        return self.sum_gradient(self.assemble_equations(x, hessian=False))

    def sum_gradient(self, equations: marker_residual.FrameEquations) -> descent.Evaluation:
        """Sum cost and half gradient, in the order of x."""
        nq = self.shape[1]
        by_frame, by_parameter = (
            equations.gradient[:nq].T.ravel(),
            equations.gradient[nq:].sum(axis=1),
        )
        return descent.Evaluation(equations.cost, np.append(by_frame, by_parameter))

    def linearise(self, x: Array, *, curved: bool) -> "_JointMatrix":
        return _JointMatrix(self, self.assemble_equations(x, hessian=True))


class _JointMatrix:
    """Gauss-Newton matrix of a joint: a block for each frame, bordered by the joint parameters."""

    spent = False

    def __init__(self, joint: _JointAlone, equations: marker_residual.FrameEquations) -> None:
        self.shape, self.evaluation = joint.shape, joint.sum_gradient(equations)
        # (nf, n, n) right wherever the second variable moves nothing that the first leaves: beside
        # the root all do
        whole = equations.compute_products()
        root, rest = slice(0, start.ROOT_COORDINATES), slice(start.ROOT_COORDINATES, None)
        whole[:, rest, root] = whole[:, root, rest].transpose(0, 2, 1)
        nq = self.shape[1]
        self.frames, self.border = whole[:, :nq, :nq], whole[:, :nq, nq:]
        self.corner = whole[:, nq:, nq:].sum(axis=0)

    def factor(self, damping: float) -> "_JointFactor":
        return _JointFactor(
            _add_damping(self.frames, damping), self.border, _add_damping(self.corner, damping)
        )


def _add_damping(matrix: Array, damping: float) -> Array:
    """Add damping and a small ridge to the diagonals of matrices (..., n, n)."""
    diagonal = np.einsum("...ii->...i", matrix)
    return (
        matrix + np.eye(matrix.shape[-1]) * (damping * diagonal + RIDGE * diagonal.max())[..., None]
    )


class _JointFactor:
    """Factor of the matrix of a joint, after elimination of the frames."""

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
