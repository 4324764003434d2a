"""The truth that a calibration should find: a known linkage, its motion and forces, in its static
trial's frames.

A calibration measures its parameters in segment frames that it makes from the static trial's
landmarks. A synthetic subject's true axes are lines and points of its segments; seen in those
frames they are what it should find. The signed angles of A = Rx(front) Ry(trans) follow from its z
axis, those of B = Ry(trans) Rz(sag) from its x axis; a hinge is given at the point of its axis that
the parameter list allows (lateral position zero on the proximal side), a talocrural axis at its
common perpendicular with the subtalar one.

Joint angles are between those frames too, which differ from the true ones by up to the drawn 10
degrees. Segments are where they are: at every frame the coordinates q' of the linkage in those
frames are those that put its segments where the true ones are,

    X_s(q) F_s = X'_s(q'),      F_s the static frame of segment s in its true one, constant,

solved by Gauss-Newton over the corners of each segment; the linkages are one, so the residual is
rounding. Ankle angles are counted from the static posture (`model/ankle_zero.py`): dorsiflexion as
its landmarks have it, no inversion. The forces are those of the same bodies about the axes of the
coordinates q', with products of inertia that segments have about axes that are not their principal
ones (a calibration's bodies have none: what that makes is part of its error). Velocities and
accelerations are those of the quintic spline through q', at three times as many instants.
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
    """A linkage as the static trial's landmarks tell it, and what they are."""

    parameters: params.Parameters  # In these frames, zero angles as they were
    posture: landmarks.StaticPosture
    legs: LowerBody
    frames: Mapping[str, Frame]  # Segment -> its frame in the laboratory while standing; no talus


def compute_static_frames(
    model: SubjectModel, hip_centre: HipCentre = HipCentre.BELL
) -> StaticFrames:
    """Express the linkage of a model with its static markers in the frames that quiet standing
    gives a calibration.

    `hip_centre`: the regression that this calibration places hips with, from which its thighs
    begin.
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
    """Pose of every segment frame of a linkage at coordinates (nq,)."""
    axes, origins = compute_body_poses(parameters, q[None])
    return {name: Frame(axes[name][..., 0].T, origins[name][..., 0]) for name in axes}


def convert_joint_parameters(
    parameters: params.Parameters, q: Array, frames: dict[str, Frame]
) -> Array:
    """(np,) joint parameters of the linkage, at pose q (nq,), in the segment `frames` of the same
    pose (no talus).
    """
    lines = _compute_joint_lines(parameters, q)
    points: dict[str, Array] = {}
    z_axes: dict[str, Array] = {}
    x_axes: dict[str, Array] = {}
    by_name: dict[str, float] = {}
    for joint in JOINTS:
        turns = [e for e in joint.elements if e.source is Source.COORDINATE]
        places = {
            p.segment: p.name.rpartition(".")[0]
            for p in params.JOINT_PARAMETERS
            if p.joint == joint.name
        }
        axis, point = lines[turns[0].name]
        if len(turns) == 3:  # a ball: the point in which the axes meet
            points |= dict.fromkeys(places.values(), point)
        elif (
            len(turns) == 1 and turns[0].axis == 2 and len(places) == 2
        ):  # a hinge; the knee flexes about -z
            axis, frame = turns[0].sign * axis, frames[next(iter(places))]
            lateral = frame.rotation[:, 2]
            point = point - axis * ((point - frame.origin) @ lateral) / (axis @ lateral)
            points |= dict.fromkeys(places.values(), point)
            z_axes |= dict.fromkeys(places.values(), axis)
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
        place, _, direction = parameter.name.rpartition(".")
        if parameter.name in by_name:
            out[k] = by_name[parameter.name]
        elif parameter.kind is params.ParameterKind.POSITION:
            out[k] = frames[parameter.segment].local(points[place])[
                ("ant", "sup", "lat").index(direction)
            ]
        elif place in z_axes:
            d = frames[parameter.segment].rotation.T @ z_axes[place]
            out[k] = (
                np.arctan2(-d[1], d[2]) if direction == "front" else np.arcsin(np.clip(d[0], -1, 1))
            )
        else:
            d = frames[parameter.segment].rotation.T @ x_axes[place]
            out[k] = (
                np.arctan2(-d[2], d[0]) if direction == "trans" else np.arcsin(np.clip(d[1], -1, 1))
            )
    return out


def convert_inertial_parameters(
    inertial: Array, true: dict[str, Frame], frames: dict[str, Frame]
) -> Array:
    """(ni,) in other frames of the same pose; of a turned inertia the moments about the new axes."""
    out = params.view_as_table(inertial).copy()
    for row, segment in zip(out, params.MASSIVE_SEGMENTS, strict=True):
        turn = frames[segment].rotation.T @ true[segment].rotation
        row[1:4] = frames[segment].local(true[segment].point(row[1:4]))
        row[4:7] = np.diag(turn @ np.diag(row[4:7]) @ turn.T)
    return out.ravel()


def _compute_joint_lines(parameters: params.Parameters, q: Array) -> dict[str, tuple[Array, Array]]:
    """Coordinate -> direction of its positive turn and a point of its axis, in the laboratory."""
    chain = get_chain()
    axes, points = compute_coordinate_axes(chain.body(parameters), q[None])
    turning = [e.name for joint in JOINTS for e in joint.elements if e.source is Source.COORDINATE]
    at = {name: chain.coordinates.index(name) for name in turning}
    return {name: (axes[0, k], points[0, k]) for name, k in at.items()}


def compute_common_perpendicular(
    a: Array, point_of_a: Array, b: Array, point_of_b: Array
) -> tuple[Array, Array]:
    """Nearest points of two lines, each given by its direction and one of its points."""
    between = point_of_b - point_of_a
    s, t = np.linalg.solve(np.array([[a @ a, -a @ b], [a @ b, -b @ b]]), [a @ between, b @ between])
    return point_of_a + s * a, point_of_b + t * b


def format_truth_table(truth: params.Parameters) -> str:
    """The content of `truth.csv`: name, unit, value."""
    lines = ["name,unit,value"]
    for name, p, value in zip(params.JP_NAMES, params.JOINT_PARAMETERS, truth.joint, strict=True):
        lines.append(f"{name},{p.kind.unit},{float(value / p.kind.to_si)!r}")
    for name, unit, value in zip(
        params.IP_NAMES, params.IP_UNITS, truth.inertial / params.IP_TO_SI, strict=True
    ):
        lines.append(f"{name},{unit},{float(value)!r}")
    return "\n".join(lines) + "\n"


DEGREE = 5
CORNER_M = 0.1  # m from a segment's origin to its corners
STEPS, TOLERANCE = 30, 1e-8
"""Gauss-Newton steps, and the step (m, rad) that ends them: its square, the next one, is rounding.
"""
# Instants a frame at which a motion is told, so that accelerations are right at its ends, too
SAMPLES_PER_FRAME = 3


@dataclass(frozen=True, kw_only=True)
class ExpectedTrial:
    """One trial of the truth, as a calibration without error would tell it."""

    time: Array  # (nf,) s
    q: Array  # (nf, nq) m, rad
    velocity: Array  # (nf, nq) m/s, rad/s
    acceleration: Array  # (nf, nq) m/s^2, rad/s^2
    forces: Array | None
    """(nf, nt) N·m (pelvis translations: N), the 27 coordinates and the two knee reactions; None
    without plates.
    """


class TruthConverter:
    """Tells motions of one person: its linkage in the static trial's frames, found once."""

    def __init__(
        self, model: SubjectModel, static: StaticFrames, zero_rule: AnkleZero = AnkleZero.MARKERS
    ) -> None:
        self._true, still = model.parameters, make_standing_pose(model.parameters)
        own = compute_segment_frames(self._true, still)
        massive = [s for s in own if s in static.frames]
        self._offset = {s: _express_frame(own[s], static.frames[s]) for s in massive}
        posture = measure_standing_ankles(static.posture, static.legs, {}, zero_rule).dorsiflexion
        told, pose = static.parameters, self._coordinates(static.parameters, still[None])[0]
        zero = told.zero_angles.copy()
        for side in SIDES:
            mirrored = 1.0 if side == "r" else -1.0
            ankle, subtalar = (
                pose[COORDINATE_INDEX[f"{name}_{side}"]]
                for name in ("ankle_angle", "subtalar_angle")
            )
            zero[ZERO_ANGLES.index(f"talocrural_{side}.zero")] += ankle - posture[side]
            zero[ZERO_ANGLES.index(f"subtalar_{side}.zero")] += mirrored * subtalar
        self.parameters = params.Parameters(told.joint, told.inertial, zero)
        """Of the linkage in static frames, its ankle angles counted from the static posture."""
        self._standing_off = self._coordinates(self.parameters, still[None])[0] - still

    def tell(self, motion: TrueMotion, wrench: Array | None = None) -> ExpectedTrial:
        """A motion of the true linkage, with its forces where wrenches (nf, 2, 6) on the feet are
        given.
        """
        time = motion.basis.time
        finer = np.interp(
            np.arange(SAMPLES_PER_FRAME * (len(time) - 1) + 1) / SAMPLES_PER_FRAME,
            np.arange(len(time)),
            time,
        )
        true = convert_to_bspline(motion.basis, motion.coefficients)(finer)
        spline = make_interp_spline(
            finer, self._coordinates(self.parameters, true, true + self._standing_off), k=DEGREE
        )
        q, velocity, acceleration = (spline(time, k) for k in range(3))
        forces = None
        if wrench is not None:
            bodies, rows = {}, params.view_as_table(self.parameters.inertial)
            for k, (row, own) in enumerate(
                zip(rows, params.view_as_table(self._true.inertial), strict=True)
            ):
                turn = self._offset[params.MASSIVE_SEGMENTS[k]].rotation  # products of inertia too
                moments = turn.T @ np.diag(own[4:7]) @ turn
                bodies[params.MASSIVE_SEGMENTS[k]] = pin.Inertia(float(row[0]), row[1:4], moments)
            forces = Dynamics(self.parameters, bodies=bodies).compute_forces(
                q, velocity, acceleration, wrench
            )
        return ExpectedTrial(
            time=time, q=q, velocity=velocity, acceleration=acceleration, forces=forces
        )

    def _coordinates(self, told: params.Parameters, q: Array, start: Array | None = None) -> Array:
        """(nf, nq) coordinates of the linkage `told` that put its segments where the true ones are
        at q (nf, nq), sought from `start`.
        """
        chain = get_chain()
        wanted = _compute_corners(
            Kinematics(chain.body(self._true), q, columns=False), self._offset
        )
        body, out = chain.body(told), (q if start is None else start).copy()
        moves = np.stack([chain.support[:, chain.segments.index(s)] for s in self._offset])
        for _ in range(STEPS):
            placed = Kinematics(body, out)
            points, columns = _compute_corners(placed), placed.columns_by_frame
            turned = np.cross(columns[:, :, None, None, 3:], points[:, None])
            rows = (columns[:, :, None, None, :3] + turned) * moves.T[None, :, :, None, None]
            rows = rows.reshape(*rows.shape[:2], -1)
            gap = (wanted - points).reshape(len(q), -1, 1)
            step = np.linalg.solve(rows @ rows.transpose(0, 2, 1), rows @ gap)[..., 0]
            out += step
            if np.abs(step).max() < TOLERANCE:
                break
        return out


def _express_frame(frame: Frame, other: Frame) -> Frame:
    """`other` as seen from `frame`."""
    return Frame(frame.rotation.T @ other.rotation, frame.local(other.origin))


def _compute_corners(placed: Kinematics, offset: dict[str, Frame] | None = None) -> Array:
    """(nf, ns, 4, 3) m: origin and three corners of the frames that `offset` places in segments, or
    of their own.
    """
    axes, origins = placed.axes, placed.origins
    local = np.concatenate([np.zeros((1, 3)), CORNER_M * np.eye(3)])
    out = []
    for k, segment in enumerate(placed.chain.segments):
        if segment not in MARKED_SEGMENTS:  # the talus has no frame of its own
            continue
        place = None if offset is None else offset[segment]
        points = local if place is None else np.array([place.point(p) for p in local])
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
"""`[truth]` of the study: where the files lie, and the rules of the frames that `truth.py` makes:
those of a calibration that is told nothing."""


def write_truth(
    folder: Path, model: SubjectModel, trials: Mapping[str, tuple[TrueMotion, Array | None]]
) -> None:
    """Write `truth.csv`, `truth/static_landmarks.csv`, and `truth/TRIAL_motion.csv` and
    `TRIAL_moments.csv` of each trial; velocities and accelerations, on which forces depend, where
    there are forces.

    `folder`: of the study. `model`: with the true parameters. `trials`: name -> the true motion,
    and the wrenches (nf, 2, 6) on right and left foot about the laboratory origin that it was
    given; None without plates.
    """
    frames = compute_static_frames(model, HipCentre(TRUTH.hip_centre))
    (folder / PARAMETERS).write_text(format_truth_table(frames.parameters), encoding="utf-8")
    (folder / CURVES).mkdir()
    (folder / LANDMARKS).write_text(format_landmarks(frames.posture.landmarks), encoding="utf-8")
    teller = TruthConverter(model, frames, AnkleZero(TRUTH.ankle_zero))
    for name, (motion, wrench) in trials.items():
        told = teller.tell(motion, wrench)
        derivatives = () if wrench is None else (told.velocity, told.acceleration)
        text = format_motion(told.time, told.q, *derivatives)
        (folder / CURVES / (name + MOTION_SUFFIX)).write_text(text, encoding="utf-8")
        if told.forces is not None:
            text = format_moments(told.time, told.forces, model.subject.bwh)
            (folder / CURVES / (name + MOMENTS_SUFFIX)).write_text(text, encoding="utf-8")
