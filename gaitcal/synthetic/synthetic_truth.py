"""True values of a synthetic subject, in the segment frames of its static trial.

A calibration gives parameters in segment frames that follow from the landmarks of the static trial.
The true axes are lines and points of the segments; expressed in these frames, they are what a
calibration without error finds. The signed angles of A = Rx(front) Ry(trans) follow from the z axis
of A, those of B = Ry(trans) Rz(sag) from the x axis of B. A hinge is given at the point of its axis
with lateral position zero in the proximal segment, a talocrural axis at its common perpendicular
with the subtalar axis.

Joint angles are between the same frames. At every frame the coordinates q' of the linkage in these
frames are those with which its segments have the true poses at q:

    X_s(q) F_s = X'_s(q'),    F_s the pose of the static frame in the true frame of segment s.

Gauss-Newton steps over the corners of each segment solve it up to rounding. Ankle angles are
counted from the static posture (`model/ankle_zero.py`): dorsiflexion as in its landmarks, no
inversion. Forces are those of the same bodies, including the products of inertia about axes that
are not principal; bodies of a calibration have none, which is part of its error. Velocities and
accelerations are those of a quintic spline through q' at `SAMPLES_PER_FRAME` times as many
instants.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.io.recording import Recording
from gaitcal.model import landmarks, trunk
from gaitcal.model import parameters as params
from gaitcal.model.ankle_zero import AnkleZero, measure_standing_ankles
from gaitcal.model.chain import get_chain
from gaitcal.model.kinematics import Kinematics, compute_body_poses, compute_coordinate_axes
from gaitcal.model.linkage import (
    COORDINATE_INDEX,
    JOINTS,
    MARKED_SEGMENTS,
    SIDES,
    ZERO_ANGLES,
    Source,
)
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.segment_frames import Frame, HipCentre, LowerBody, measure_lower_body
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.declared_truth import (
    MOMENTS_SUFFIX,
    MOTION_SUFFIX,
    format_landmarks,
    format_moments,
    format_motion,
)
from gaitcal.study.study_file import TruthTable
from gaitcal.synthetic.synthetic_motion import (
    TrueMotion,
    compute_synthetic_markers,
    make_standing_pose,
)
from gaitcal.tracking.spline import convert_to_bspline


@dataclass(frozen=True)
class StaticFrames:
    """A linkage in the segment frames of the static trial, and these frames."""

    parameters: params.Parameters
    """In these frames; zero angles unchanged."""
    posture: landmarks.StaticPosture
    legs: LowerBody
    frames: Mapping[str, Frame]
    """Segment, without talus -> its frame in the laboratory in the static posture."""


def compute_static_frames(
    model: SubjectModel, hip_centre: HipCentre = HipCentre.BELL
) -> StaticFrames:
    """Express a linkage in the segment frames that a calibration makes from quiet standing.

    `model`: subject with static markers. `hip_centre`: regression of hip centres, at which the
    thigh frames begin.
    """
    true, pose = model.parameters, make_standing_pose(model.parameters)
    markers = compute_synthetic_markers(true, model.markers, pose[None])
    still = Recording(
        source="static", time=np.zeros(1), labels=model.markers.labels, markers=markers
    )
    marker_set = load_marker_set("published")
    posture = landmarks.measure_static_posture(still, marker_set, slice(0, 1))
    legs = measure_lower_body(posture, model.subject.height, hip_centre)
    frames = legs.frames | trunk.measure_upper_body(posture, marker_set, legs, model.subject).frames
    inertial = convert_inertial_parameters(
        true.inertial, compute_segment_frames(true, pose), frames
    )
    in_frames = params.Parameters(
        convert_joint_parameters(true, pose, frames), inertial, true.zero_angles
    )
    return StaticFrames(in_frames, posture, legs, frames)


def compute_segment_frames(parameters: params.Parameters, q: Array) -> dict[str, Frame]:
    """Compute the pose of every segment frame of a linkage.

    `q`: (nq,) coordinates, m and rad. Returns: segment -> its frame in the laboratory.
    """
    axes, origins = compute_body_poses(parameters, q[None])
    return {name: Frame(axes[name][..., 0].T, origins[name][..., 0]) for name in axes}


def convert_joint_parameters(
    parameters: params.Parameters, q: Array, frames: dict[str, Frame]
) -> Array:
    """Convert joint parameters to other segment frames.

    `parameters`: of the linkage in its frames. `q`: (nq,) pose, m and rad. `frames`: segment,
    without talus -> its other frame in the laboratory in the same pose. Returns: (np,).
    """
    lines = _compute_joint_lines(parameters, q)
    points: dict[str, Array] = {}
    z_axes: dict[str, Array] = {}
    x_axes: dict[str, Array] = {}
    by_name: dict[str, float] = {}
    for joint in JOINTS:
        rotations = [e for e in joint.elements if e.source is Source.COORDINATE]
        # Segment -> prefix of the names of its parameters
        prefixes = {
            p.segment: p.name.rpartition(".")[0]
            for p in params.JOINT_PARAMETERS
            if p.joint == joint.name
        }
        axis, point = lines[rotations[0].name]
        if len(rotations) == 3:
            # A ball joint: the point in which its axes meet
            points |= dict.fromkeys(prefixes.values(), point)
        elif len(rotations) == 1 and rotations[0].axis == 2 and len(prefixes) == 2:
            # A hinge; the knee flexes about -z
            axis, frame = rotations[0].sign * axis, frames[next(iter(prefixes))]
            lateral = frame.rotation[:, 2]
            point = point - axis * ((point - frame.origin) @ lateral) / (axis @ lateral)
            points |= dict.fromkeys(prefixes.values(), point)
            z_axes |= dict.fromkeys(prefixes.values(), axis)
    for side in SIDES:
        mirrored = 1.0 if side == "r" else -1.0
        z, point_of_z = lines[f"ankle_angle_{side}"]
        x, point_of_x = (
            mirrored * lines[f"subtalar_angle_{side}"][0],
            lines[f"subtalar_angle_{side}"][1],
        )
        talus_origin, foot_point = compute_common_perpendicular(z, point_of_z, x, point_of_x)
        up = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
        by_name[f"subtalar_{side}.talus.trans"] = float(-np.arcsin(np.clip(z @ x, -1, 1)))
        by_name[f"subtalar_{side}.talus.sup"] = float((foot_point - talus_origin) @ up)
        points |= {f"talocrural_{side}.shank": talus_origin, f"subtalar_{side}.foot": foot_point}
        arm, shoulder = lines[f"arm_flex_{side}"]
        points |= dict.fromkeys((f"shoulder_{side}.trunk", f"shoulder_{side}.upperarm"), shoulder)
        z_axes |= {f"talocrural_{side}.shank": z, f"shoulder_{side}.trunk": arm}
        x_axes |= {
            f"subtalar_{side}.foot": x,
            f"shoulder_{side}.upperarm": mirrored * lines[f"arm_add_{side}"][0],
        }
    out = np.full(len(params.JP_INDEX), np.nan)
    for k, parameter in enumerate(params.JOINT_PARAMETERS):
        prefix, _, direction = parameter.name.rpartition(".")
        if parameter.name in by_name:
            out[k] = by_name[parameter.name]
            continue
        frame = frames[parameter.segment]
        if parameter.kind is params.ParameterKind.POSITION:
            index = ("ant", "sup", "lat").index(direction)
            out[k] = frame.local(points[prefix])[index]
        elif prefix in z_axes:
            d = frame.rotation.T @ z_axes[prefix]
            tilt = np.arctan2(-d[1], d[2]), np.arcsin(np.clip(d[0], -1, 1))
            out[k] = tilt[0] if direction == "front" else tilt[1]
        else:
            d = frame.rotation.T @ x_axes[prefix]
            tilt = np.arctan2(-d[2], d[0]), np.arcsin(np.clip(d[1], -1, 1))
            out[k] = tilt[0] if direction == "trans" else tilt[1]
    return out


def convert_inertial_parameters(
    inertial: Array, true: dict[str, Frame], frames: dict[str, Frame]
) -> Array:
    """Convert inertial parameters to other segment frames.

    `inertial`: (ni,) in the true frames, SI units. `true`, `frames`: segment -> its true and its
    other frame in the laboratory, in the same pose. Returns: (ni,) in the other frames, SI units;
    moments of inertia about the other axes, without products.
    """
    out = params.view_as_table(inertial).copy()
    for row, segment in zip(out, params.MASSIVE_SEGMENTS, strict=True):
        rotation_between = frames[segment].rotation.T @ true[segment].rotation
        row[1:4] = frames[segment].local(true[segment].point(row[1:4]))
        row[4:7] = np.diag(rotation_between @ np.diag(row[4:7]) @ rotation_between.T)
    return out.ravel()


def _compute_joint_lines(parameters: params.Parameters, q: Array) -> dict[str, tuple[Array, Array]]:
    """Compute coordinate -> direction and point of its rotation axis in the laboratory."""
    chain = get_chain()
    axes, points = compute_coordinate_axes(chain.body(parameters), q[None])
    rotations = [
        e.name for joint in JOINTS for e in joint.elements if e.source is Source.COORDINATE
    ]
    at = {name: chain.coordinates.index(name) for name in rotations}
    return {name: (axes[0, k], points[0, k]) for name, k in at.items()}


def compute_common_perpendicular(
    a: Array, point_of_a: Array, b: Array, point_of_b: Array
) -> tuple[Array, Array]:
    """Compute the nearest points of two lines.

    `a`, `point_of_a`, `b`, `point_of_b`: (3,) direction and a point of each line. Returns: nearest
    point on each line.
    """
    between = point_of_b - point_of_a
    s, t = np.linalg.solve(np.array([[a @ a, -a @ b], [a @ b, -b @ b]]), [a @ between, b @ between])
    return point_of_a + s * a, point_of_b + t * b


def _format_truth_table(truth: params.Parameters) -> str:
    """Format the content of `truth.csv`: name, unit, value of each parameter.

    `truth`: True parameters in the frames of the static trial.
    """
    lines = ["name,unit,value"]
    for name, p, value in zip(params.JP_NAMES, params.JOINT_PARAMETERS, truth.joint, strict=True):
        lines.append(f"{name},{p.kind.unit},{float(value / p.kind.to_si)!r}")
    for name, unit, value in zip(
        params.IP_NAMES, params.IP_UNITS, truth.inertial / params.IP_TO_SI, strict=True
    ):
        lines.append(f"{name},{unit},{float(value)!r}")
    return "\n".join(lines) + "\n"


DEGREE = 5
CORNER_M = 0.1
"""Distance (m) of the corners of a segment from its origin."""
STEPS, TOLERANCE = 30, 1e-8
"""Most Gauss-Newton steps, and the last step (m, rad); the error of the next is its square."""
SAMPLES_PER_FRAME = 3
"""Samples of a motion for each frame, so that accelerations are right at its ends, too."""


@dataclass(frozen=True, kw_only=True)
class ExpectedTrial:
    """Motion and forces of a trial as a calibration without error gives them."""

    time: Array
    """(nf,) s."""
    q: Array
    """(nf, nq) m, rad."""
    velocity: Array
    """(nf, nq) m/s, rad/s."""
    acceleration: Array
    """(nf, nq) m/s^2, rad/s^2."""
    forces: Array | None
    """(nf, nt) N·m (pelvis translations: N) of the 27 coordinates and two knee reactions.

    None without plates.
    """


class TruthConverter:
    """Converts motions of a subject to its linkage in the frames of the static trial.

    Parameters
    ----------
    model
        Subject with true parameters.
    static
        The linkage in these frames.
    zero_rule
        How the zero of ankle angles is defined.
    """

    def __init__(
        self, model: SubjectModel, static: StaticFrames, zero_rule: AnkleZero = AnkleZero.MARKERS
    ) -> None:
        self._true, still = model.parameters, make_standing_pose(model.parameters)
        true_frames = compute_segment_frames(self._true, still)
        segments = [s for s in true_frames if s in static.frames]
        self._offset = {s: _express_frame(true_frames[s], static.frames[s]) for s in segments}
        posture = measure_standing_ankles(static.posture, static.legs, {}, zero_rule).dorsiflexion
        linkage = static.parameters
        pose = self._solve_coordinates(linkage, still[None])[0]
        zero = linkage.zero_angles.copy()
        for side in SIDES:
            mirrored = 1.0 if side == "r" else -1.0
            ankle = pose[COORDINATE_INDEX[f"ankle_angle_{side}"]]
            subtalar = pose[COORDINATE_INDEX[f"subtalar_angle_{side}"]]
            zero[ZERO_ANGLES.index(f"talocrural_{side}.zero")] += ankle - posture[side]
            zero[ZERO_ANGLES.index(f"subtalar_{side}.zero")] += mirrored * subtalar
        self.parameters = params.Parameters(linkage.joint, linkage.inertial, zero)
        """Parameters in static frames, with ankle angles counted from the static posture."""
        self._standing_off = self._solve_coordinates(self.parameters, still[None])[0] - still

    def convert(self, motion: TrueMotion, wrench: Array | None = None) -> ExpectedTrial:
        """Convert a motion of the true linkage.

        Parameters
        ----------
        motion
            Motion of the true linkage.
        wrench
            (nf, 2, 6) N, N·m on right and left foot about the laboratory origin.

        Returns
        -------
        ExpectedTrial
            With forces if a wrench is given.
        """
        time = motion.basis.time
        finer = np.interp(
            np.arange(SAMPLES_PER_FRAME * (len(time) - 1) + 1) / SAMPLES_PER_FRAME,
            np.arange(len(time)),
            time,
        )
        true = convert_to_bspline(motion.basis, motion.coefficients)(finer)
        spline = make_interp_spline(
            finer,
            self._solve_coordinates(self.parameters, true, true + self._standing_off),
            k=DEGREE,
        )
        q, velocity, acceleration = (spline(time, k) for k in range(3))
        forces = None
        if wrench is not None:
            bodies, rows = {}, params.view_as_table(self.parameters.inertial)
            true_rows = params.view_as_table(self._true.inertial)
            for segment, row, true_row in zip(
                params.MASSIVE_SEGMENTS, rows, true_rows, strict=True
            ):
                # The rotated inertia has products of inertia, too.
                rotation = self._offset[segment].rotation
                moments = rotation.T @ np.diag(true_row[4:7]) @ rotation
                bodies[segment] = pin.Inertia(float(row[0]), row[1:4], moments)
            forces = Dynamics(self.parameters, bodies=bodies).compute_forces(
                q, velocity, acceleration, wrench
            )
        return ExpectedTrial(
            time=time, q=q, velocity=velocity, acceleration=acceleration, forces=forces
        )

    def _solve_coordinates(
        self, linkage: params.Parameters, q: Array, start: Array | None = None
    ) -> Array:
        """Solve (nf, nq) coordinates of a linkage with which its segments have the true poses.

        `q`: (nf, nq) of the true linkage; `start`: first guess, `q` unless given.
        """
        chain = get_chain()
        target = _compute_corners(
            Kinematics(chain.body(self._true), q, columns=False), self._offset
        )
        body, out = chain.body(linkage), (q if start is None else start).copy()
        # (coordinate, segment): whether the coordinate moves the segment
        moves = np.stack([chain.support[:, chain.segments.index(s)] for s in self._offset])
        for _ in range(STEPS):
            placed = Kinematics(body, out)
            points, columns = _compute_corners(placed), placed.columns_by_frame
            rotated = np.cross(columns[:, :, None, None, 3:], points[:, None])
            rows = (columns[:, :, None, None, :3] + rotated) * moves.T[None, :, :, None, None]
            rows = rows.reshape(*rows.shape[:2], -1)
            gap = (target - points).reshape(len(q), -1, 1)
            step = np.linalg.solve(rows @ rows.transpose(0, 2, 1), rows @ gap)[..., 0]
            out += step
            if np.abs(step).max() < TOLERANCE:
                break
        return out


def _express_frame(frame: Frame, other: Frame) -> Frame:
    """Express the frame `other` in `frame`."""
    return Frame(frame.rotation.T @ other.rotation, frame.local(other.origin))


def _compute_corners(placed: Kinematics, offset: dict[str, Frame] | None = None) -> Array:
    """Compute (nf, ns, 4, 3) m, origin and three corners of frames of segments.

    `offset`: segment -> pose of its frame in the segment; the segment frames unless given.
    """
    axes, origins = placed.axes, placed.origins
    local = np.concatenate([np.zeros((1, 3)), CORNER_M * np.eye(3)])
    out = []
    for k, segment in enumerate(placed.chain.segments):
        # The talus has no frame in the static trial.
        if segment not in MARKED_SEGMENTS:
            continue
        pose = None if offset is None else offset[segment]
        points = local if pose is None else np.array([pose.point(p) for p in local])
        out.append(np.einsum("cj,jif->fci", points, axes[k]) + origins[k].T[:, None])
    return np.stack(out, axis=1)


PARAMETERS, CURVES = Path("truth.csv"), Path("truth")
LANDMARKS = CURVES / "static_landmarks.csv"
TRUTH: Final = TruthTable(
    parameters=PARAMETERS,
    folder=CURVES,
    landmarks=LANDMARKS,
    markers="published",
    hip_centre=HipCentre.HARRINGTON.value,
    ankle_zero=AnkleZero.AUTO.value,
)
"""`[truth]` of the study: paths of the files, and the rules of the frames of a calibration with
default settings."""


def write_truth(
    folder: Path, model: SubjectModel, trials: Mapping[str, tuple[TrueMotion, Array | None]]
) -> None:
    """Write the true parameters, landmarks, motions and moments of a synthetic subject.

    The files are `truth.csv`, `truth/static_landmarks.csv`, and `truth/TRIAL_motion.csv` and
    `truth/TRIAL_moments.csv` of each trial. Motions of trials with forces have velocities and
    accelerations.

    Parameters
    ----------
    folder
        Of the study.
    model
        Subject with true parameters.
    trials
        Name -> true motion, and wrenches (nf, 2, 6) on right and left foot about the laboratory
        origin, None without plates.
    """
    frames = compute_static_frames(model, HipCentre(TRUTH.hip_centre))
    (folder / PARAMETERS).write_text(_format_truth_table(frames.parameters), encoding="utf-8")
    (folder / CURVES).mkdir()
    (folder / LANDMARKS).write_text(format_landmarks(frames.posture.landmarks), encoding="utf-8")
    converter = TruthConverter(model, frames, AnkleZero(TRUTH.ankle_zero))
    for name, (motion, wrench) in trials.items():
        expected = converter.convert(motion, wrench)
        derivatives = () if wrench is None else (expected.velocity, expected.acceleration)
        text = format_motion(expected.time, expected.q, *derivatives)
        (folder / CURVES / (name + MOTION_SUFFIX)).write_text(text, encoding="utf-8")
        if expected.forces is not None:
            text = format_moments(expected.time, expected.forces, model.subject.bwh)
            (folder / CURVES / (name + MOMENTS_SUFFIX)).write_text(text, encoding="utf-8")
