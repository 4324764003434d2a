"""The truth that a calibration should find: a known linkage, told in the segment frames of its static trial.

A calibration measures its parameters in segment frames that it makes from the static trial's landmarks. A synthetic
subject's true axes are lines and points of its segments; told in those frames they are what it should find. The signed
angles of A = Rx(front) Ry(trans) follow from its z axis, those of B = Ry(trans) Rz(sag) from its x axis; a hinge is
told at the point of its axis that the parameter list allows (lateral position zero on the proximal side), a talocrural
axis at its common perpendicular with the subtalar one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.model.chain import Chain, forward, segment_poses
from gaitcal.model.landmarks import StaticPosture, static_posture
from gaitcal.model.linkage import JOINTS, SIDES, Source
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.parameters import (
    IP_NAMES,
    IP_TO_SI,
    IP_UNITS,
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    MASSIVE_SEGMENTS,
    Parameters,
    table,
)
from gaitcal.model.segment_frames import Frame, HipCentre, LowerBody, lower_body
from gaitcal.model.subject_model import SubjectModel
from gaitcal.model.trunk import upper_body
from gaitcal.synthetic.measurements import synthetic_markers
from gaitcal.synthetic.motion import standing_pose


@dataclass(frozen=True)
class StaticFrames:
    """A linkage as the static trial's landmarks tell it, and what they are."""

    parameters: Parameters
    """In these frames, zero angles as they were."""
    posture: StaticPosture
    legs: LowerBody
    frames: Mapping[str, Frame]
    """Segment -> its frame in the laboratory while standing; no talus."""


def in_static_frames(model: SubjectModel, hip_centre: HipCentre = HipCentre.BELL) -> Parameters:
    """The linkage of a model with its static markers, told in the frames that quiet standing gives a calibration.

    `hip_centre`: the regression that this calibration places hips with, from which its thighs begin.
    """
    return static_frames(model, hip_centre).parameters


def static_frames(model: SubjectModel, hip_centre: HipCentre = HipCentre.BELL) -> StaticFrames:
    """The same, with the frames and the posture that they are from."""
    true, pose = model.parameters, standing_pose(model.parameters)
    markers = synthetic_markers(true, model.markers, pose[None])
    still = Recording(source="static", time=np.zeros(1), labels=model.markers.labels, markers=markers)
    marker_set = load_marker_set("published")
    posture = static_posture(still, marker_set, slice(0, 1))
    legs = lower_body(posture, model.subject.height, hip_centre)
    frames = legs.frames | upper_body(posture, marker_set, legs, model.subject).frames
    inertial = inertial_parameters_in(true.inertial, segment_frames(true, pose), frames)
    in_frames = Parameters(joint_parameters_in(true, pose, frames), inertial, true.zero_angles)
    return StaticFrames(in_frames, posture, legs, frames)


def segment_frames(parameters: Parameters, q: Array) -> dict[str, Frame]:
    """Pose of every segment frame of a linkage at coordinates (nq,)."""
    chain = Chain()
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, q[None]))
    return {name: Frame(axes[i, :, :, 0].T, origins[i, :, 0]) for i, name in enumerate(chain.segments)}


def joint_parameters_in(parameters: Parameters, q: Array, frames: dict[str, Frame]) -> Array:
    """(np,) joint parameters of the linkage, at pose q (nq,), in the segment `frames` of the same pose (no talus)."""
    lines = _joint_lines(parameters, q)
    out = np.full(len(JP_INDEX), np.nan)

    def put(name: str, value: float | np.floating | Array) -> None:
        out[JP_INDEX[name]] = value

    def put_point(prefix: str, segment: str, point: Array, directions: str = "ant sup lat") -> None:
        local = frames[segment].local(point)
        for direction in directions.split():
            put(f"{prefix}.{direction}", local[("ant", "sup", "lat").index(direction)])

    def put_z_axis(prefix: str, segment: str, axis: Array) -> None:
        d = frames[segment].rotation.T @ axis
        put(f"{prefix}.front", np.arctan2(-d[1], d[2]))
        put(f"{prefix}.trans", np.arcsin(np.clip(d[0], -1, 1)))

    def put_x_axis(prefix: str, segment: str, axis: Array) -> None:
        d = frames[segment].rotation.T @ axis
        put(f"{prefix}.trans", np.arctan2(-d[2], d[0]))
        put(f"{prefix}.sag", np.arcsin(np.clip(d[1], -1, 1)))

    def put_hinge(places: Mapping[str, str], line: tuple[Array, Array]) -> None:
        axis, point = line
        proximal, distal = places
        frame = frames[proximal]
        lateral = frame.rotation[:, 2]
        point = point - axis * ((point - frame.origin) @ lateral) / (axis @ lateral)
        put_z_axis(places[proximal], proximal, axis)
        put_point(places[proximal], proximal, point, "ant sup")
        put_z_axis(places[distal], distal, axis)
        put_point(places[distal], distal, point)

    for joint in JOINTS:
        turns = [e for e in joint.elements if e.source is Source.COORDINATE]
        places = {p.segment: p.name.rpartition(".")[0] for p in JOINT_PARAMETERS if p.joint == joint.name}
        line = lines[turns[0].name]
        if len(turns) == 3:  # a ball: the point in which the axes meet
            for segment, prefix in places.items():
                put_point(prefix, segment, line[1])
        elif len(turns) == 1 and turns[0].axis == 2 and len(places) == 2:
            put_hinge(places, line if turns[0].sign > 0 else _reversed(line))
    for side in SIDES:
        shank, foot, arm = (f"{s}_{side}" for s in ("shank", "foot", "upper_arm"))
        z, point_of_z = lines[f"ankle_angle_{side}"]
        x, point_of_x = lines[f"subtalar_angle_{side}"]
        x = x if side == "r" else -x
        talus_origin, foot_point = _common_perpendicular(z, point_of_z, x, point_of_x)
        up = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
        put_z_axis(f"talocrural_{side}.shank", shank, z)
        put_point(f"talocrural_{side}.shank", shank, talus_origin)
        put(f"subtalar_{side}.talus.trans", -np.arcsin(np.clip(z @ x, -1, 1)))
        put(f"subtalar_{side}.talus.sup", (foot_point - talus_origin) @ up)
        put_x_axis(f"subtalar_{side}.foot", foot, x)
        put_point(f"subtalar_{side}.foot", foot, foot_point)
        z, shoulder = lines[f"arm_flex_{side}"]
        x = lines[f"arm_add_{side}"][0] * (1.0 if side == "r" else -1.0)
        put_z_axis(f"shoulder_{side}.trunk", "head_trunk", z)
        put_point(f"shoulder_{side}.trunk", "head_trunk", shoulder)
        put_x_axis(f"shoulder_{side}.upperarm", arm, x)
        put_point(f"shoulder_{side}.upperarm", arm, shoulder)
    return out


def inertial_parameters_in(inertial: Array, true: dict[str, Frame], frames: dict[str, Frame]) -> Array:
    """(ni,) in other frames of the same pose; of a turned inertia the moments about the new axes."""
    out = table(inertial).copy()
    for row, segment in zip(out, MASSIVE_SEGMENTS, strict=True):
        turn = frames[segment].rotation.T @ true[segment].rotation
        row[1:4] = frames[segment].local(true[segment].point(row[1:4]))
        row[4:7] = np.diag(turn @ np.diag(row[4:7]) @ turn.T)
    return out.ravel()


def _joint_lines(parameters: Parameters, q: Array) -> dict[str, tuple[Array, Array]]:
    """Coordinate -> direction of its positive turn and a point of its axis, in the laboratory."""
    chain = Chain()
    poses = forward(chain, chain.constants(parameters.joint, parameters.zero_angles), q[None])
    turning = [e.name for joint in JOINTS for e in joint.elements if e.source is Source.COORDINATE]
    return {
        name: (e.sign * poses.axes[k, e.axis, :, 0], poses.origins[k, :, 0])
        for k, (name, e) in enumerate(zip(chain.coordinates, chain.elements, strict=True))
        if name in turning
    }


def _reversed(line: tuple[Array, Array]) -> tuple[Array, Array]:
    """The knee flexes about -z of its frame; its parameters tell the z axis."""
    return -line[0], line[1]


def _common_perpendicular(a: Array, point_of_a: Array, b: Array, point_of_b: Array) -> tuple[Array, Array]:
    """Nearest points of two lines, each given by its direction and one of its points."""
    between = point_of_b - point_of_a
    s, t = np.linalg.solve(np.array([[a @ a, -a @ b], [a @ b, -b @ b]]), [a @ between, b @ between])
    return point_of_a + s * a, point_of_b + t * b


def truth_table(truth: Parameters) -> str:
    """The content of `truth.csv`: name, unit, value."""
    lines = ["name,unit,value"]
    for name, p, value in zip(JP_NAMES, JOINT_PARAMETERS, truth.joint, strict=True):
        lines.append(f"{name},{p.kind.unit},{float(value / p.kind.to_si)!r}")
    for name, unit, value in zip(IP_NAMES, IP_UNITS, truth.inertial / IP_TO_SI, strict=True):
        lines.append(f"{name},{unit},{float(value)!r}")
    return "\n".join(lines) + "\n"
