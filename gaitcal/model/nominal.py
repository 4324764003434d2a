"""A person's nominal model from the static trial, and the published nominal subject.

still window -> static posture -> segment frames -> joint parameters, marker positions, lengths ->
inertial parameters

Positions are the coordinates of the joint centre in the two segments that the joint connects, but
for the subtalar one. A hinge (knee, elbow) lies along the proximal segment's z axis through the
joint centre: A_proximal = 1, and with its direction a in the distal frame, A_distal = Rx(front)
Ry(trans) has trans = asin(a_x), front = atan2(-a_y, a_z).

Ankle. With A = Rx(front) the talocrural axis in the shank, B = Ry(trans) Rz(sag) the subtalar one
in the foot and R the static orientation of the foot in the shank, the chain A Rz(alpha) Ry(t)
Rx(beta) B^-1 = R gives

    M = A^T R B:   t = -asin(M_zx) = talus.trans,
    alpha = atan2(M_yx, M_xx),   beta = atan2(M_zy, M_zz).

The zero angles are alpha - delta and beta, delta the dorsiflexion of the static posture
(`ankle_zero.py`): zero ankle angle is the foot at right angles to the shank. The subtalar point of
the foot closes the chain. So the linkage reproduces the static foot pose exactly.
"""

import json
from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.io.toml import find_models_folder
from gaitcal.model import anthropometry, coordinates, linkage, rotations, trunk
from gaitcal.model.ankle_zero import AnkleZero, measure_standing_ankles
from gaitcal.model.landmarks import StaticPosture, check_plausible, measure_static_posture
from gaitcal.model.marker_set import SEGMENT_OF, MarkerSet, load_marker_set
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    ParameterKind,
    Parameters,
    read_published_parameters,
)
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.model.segment_frames import Frame, HipCentre, JointWidths, measure_lower_body, sign
from gaitcal.model.subject_model import MarkerPlacement, Subject, SubjectModel
from gaitcal.runtime import with_one_blas_thread

__all__ = ["AnkleZero", "HipCentre", "nominal_model", "published_model"]


TALOCRURAL_FRONT = np.deg2rad(7.3)  # 90 - 82.7 deg, Inman 1976
SUBTALAR_TRANS, SUBTALAR_SAG = np.deg2rad(23.0), np.deg2rad(42.0)  # Inman 1976
SUBTALAR_BELOW = 0.010  # m below the talocrural axis, along the talus's y
# m or rad: a smaller parameter is zero by construction, and is set to zero
_ROUNDING = 1e-13
# markers of the pelvis, the free base segment of the linkage
PELVIS_MARKERS_NEEDED = 3
RAISED_ARM_WEIGHT = 0.1
"""Factor of the weights of shoulder and arm markers where the arm is raised sideways in the static
trial: the acromion is then some 40 mm higher and nearer to the neck than in walking."""

CENTRE_OF: dict[str, str] = {
    joint.name: centre + (f"_{side}" if side else "")
    for joint in linkage.JOINTS
    for kind, side in (coordinates.split_side(joint.name),)
    if (centre := coordinates.JOINT_TABLE[kind].centre)
}
"""Joint -> landmark that is its centre."""
_SEGMENT_OF_POINT = SEGMENT_OF | {
    CENTRE_OF[joint.name]: joint.parent for joint in linkage.JOINTS if joint.name in CENTRE_OF
}
"""Landmark or joint centre -> the segment that keeps it."""


@with_one_blas_thread
def nominal_model(
    static: Recording,
    marker_set: MarkerSet,
    subject: Subject,
    *,
    hip_centre: HipCentre = HipCentre.HARRINGTON,
    ankle_zero: AnkleZero = AnkleZero.AUTO,
    weights: Mapping[str, float] | None = None,
    window: slice | None = None,
) -> SubjectModel:
    """Make the nominal linkage model of a person from the static trial.

    Parameters
    ----------
    static : Recording
        The static trial; m, y up, any heading.
    marker_set : MarkerSet
        Meaning of its markers.
    subject : Subject
        Mass, height and sex, which give joint widths and inertia.
    hip_centre : HipCentre
        Regression for the hip centres, or those of the file.
    ankle_zero : AnkleZero
        Reference direction of zero ankle angles.
    weights : mapping of str to float, optional
        Marker -> weight, instead of the set's.
    window : slice, optional
        Frames to use; the stillest half second if not given.

    Returns
    -------
    SubjectModel
        Joint and inertial parameters, marker positions and notes.

    Raises
    ------
    InputError
        No still window; a required landmark is missing; a leg segment has too few markers; the
        lengths are implausible.
    """
    marker_set = marker_set.with_weights(weights or {})
    static = complete_static(marker_set.renamed(static), marker_set)
    marker_set = resolve_marker_set(marker_set, static)
    scatter = ""
    if window is None:
        found = find_still_window(static, marker_set.labels)
        window, scatter = found.frames, f", markers {1e3 * found.scatter:.1f} mm RMS from it"
    frames_used = range(*window.indices(len(static.time)))
    posture = measure_static_posture(static, marker_set, window)
    check_plausible(posture, subject.height)
    legs = measure_lower_body(
        posture, subject.height, hip_centre, widths=JointWidths.from_subject(subject)
    )
    body = trunk.measure_upper_body(posture, marker_set, legs, subject)
    frames, centres = legs.frames | body.frames, legs.centres | body.centres
    standing = measure_standing_ankles(
        posture, legs, static.facts.static_plantarflexion, ankle_zero
    )
    joint, zero = _compute_joint_parameters(frames, centres, body, standing.dorsiflexion)
    inertial = anthropometry.compute_inertial_parameters(
        subject, _measure_lengths(frames["pelvis"], centres)
    )
    parameters = Parameters(joint, inertial, zero)
    # segments of the legs that do not need markers, and without a visible one
    optional = [
        s
        for leg in linkage.LEGS.values()
        for s in leg
        if linkage.get_segment(s).markers and s not in linkage.LEG_SEGMENTS
    ]
    bare = [s for s in optional if not set(marker_set.tracking.get(s, ())) & set(posture.markers)]
    frozen = (*body.frozen_segments, *bare)
    carried = [
        label
        for label in _list_arm_markers(marker_set, body.raised)
        if label not in (weights or {})
    ]
    raised = {label: marker_set.weight(label) * RAISED_ARM_WEIGHT for label in carried}
    markers, notes = _place_markers(posture, marker_set.with_weights(raised), frames, frozen)
    if raised:
        names = ", ".join(raised)
        notes = (
            *notes,
            "arms raised in the static trial displace the shoulders: weights times "
            f"{RAISED_ARM_WEIGHT:g} on {names}",
        )
    return SubjectModel(
        subject=subject,
        parameters=parameters,
        nominal=parameters,
        markers=markers,
        frozen=linkage.list_joint_coordinates(frozen),
        posture=_compute_posture(frames, standing.dorsiflexion, joint),
        landmarks={
            name: (_SEGMENT_OF_POINT[name], frames[_SEGMENT_OF_POINT[name]].local(point))
            for name, point in sorted({**posture.landmarks, **centres}.items())
            if name in _SEGMENT_OF_POINT and _SEGMENT_OF_POINT[name] not in frozen
        },
        noise=marker_set.noise,
        notes=(
            *(f"static trial: {note}" for note in static.notes),
            f"static posture: mean of {len(frames_used)} frames from "
            f"{static.time[frames_used[0]]:.2f} s{scatter}",
            *marker_set.notes,
            *posture.notes,
            *legs.notes,
            *standing.notes,
            *body.notes,
            *notes,
            *(
                [f"points that are no markers on skin: {marker_set.noise.description}"]
                if marker_set.noise
                else []
            ),
            f"inertia: {anthropometry.describe_mass_table(subject)}",
        ),
    )


def _compute_posture(
    frames: Mapping[str, Frame], dorsiflexion: Mapping[str, float], joint: Array
) -> dict[str, float]:
    """Compute the coordinates (rad) of pelvis, lumbar joint and legs in the static posture."""
    pelvis = frames["pelvis"].rotation
    ahead = rotations.make_axis_rotation(1, float(np.arctan2(pelvis[2, 0], pelvis[0, 0]))) @ pelvis
    turns = {
        linkage.PELVIS_ANGLES: (ahead, 1.0),
        linkage.LUMBAR: (pelvis.T @ frames["head_trunk"].rotation, 1.0),
    }
    for side in linkage.SIDES:
        turns[linkage.list_joint_coordinates([f"thigh_{side}"])] = (
            pelvis.T @ frames[f"thigh_{side}"].rotation,
            sign(side),
        )
    out = {f"ankle_angle_{side}": float(dorsiflexion[side]) for side in linkage.SIDES}
    for side in linkage.SIDES:
        shank = frames[f"thigh_{side}"].rotation.T @ frames[f"shank_{side}"].rotation
        out[f"knee_angle_{side}"] = compute_knee_flexion(shank, joint, side)
    for names, (rotation, mirrored) in turns.items():
        (angles,) = rotations.compute_root_angles(rotation[None]) * [1.0, mirrored, mirrored]
        out |= dict(zip(names, map(float, angles), strict=True))
    return out


def compute_knee_flexion(shank: Array, joint: Array, side: str) -> float:
    """Compute the flexion of a knee from the orientation of its segments.

    `shank`: (3, 3) orientation of the shank in the thigh. `joint`: (np,) joint parameters, m and
    rad. `side`: `r` or `l`. Returns: flexion, rad.
    """
    front, trans = (
        float(joint[JP_INDEX[f"knee_{side}.shank.{name}"]]) for name in ("front", "trans")
    )
    about = shank @ rotations.make_axis_rotation(0, front) @ rotations.make_axis_rotation(1, trans)
    return float(-np.arctan2(about[1, 0], about[0, 0]))


def _list_arm_markers(marker_set: MarkerSet, sides: tuple[str, ...]) -> list[str]:
    """List the markers with weight on shoulders and arms of these sides."""
    labels: list[str] = []
    for side in sides:
        labels += marker_set.landmarks.get(f"acromion_{side}", ())
        labels += [
            m
            for part in ("upper_arm", "forearm_hand")
            for m in marker_set.tracking.get(f"{part}_{side}", ())
        ]
    return [label for label in labels if marker_set.weight(label) > 0]


def _measure_lengths(pelvis: Frame, centres: Mapping[str, Array]) -> anthropometry.BodyLengths:
    """Measure the lengths that inertia depends on, from joint centres (3,) m in the laboratory."""
    legs = {"thigh": ("hjc", "kjc"), "shank": ("kjc", "ajc")}
    ends = legs | {"upper_arm": ("sjc", "ejc"), "forearm_hand": ("ejc", "wjc")}
    limbs = {
        f"{segment}_{side}": float(np.linalg.norm(centres[f"{a}_{side}"] - centres[f"{b}_{side}"]))
        for segment, (a, b) in ends.items()
        for side in linkage.SIDES
    }
    hips = pelvis.local(0.5 * (centres["hjc_r"] + centres["hjc_l"]))
    return anthropometry.BodyLengths(
        limbs, hips[:2], float(pelvis.local(centres["lumbar"])[1] - hips[1])
    )


def _place_markers(
    posture: StaticPosture,
    marker_set: MarkerSet,
    frames: Mapping[str, Frame],
    frozen: tuple[str, ...],
) -> tuple[MarkerPlacement, tuple[str, ...]]:
    """Compute local positions of all visible markers in segments that move, with notes."""
    weight = marker_set.weight
    labels, segments, dropped = list[str](), list[str](), list[str]()
    for segment in (s for s in linkage.SEGMENTS if s not in frozen):
        tracking = marker_set.tracking.get(segment, ())
        present = [label for label in tracking if label in posture.markers]
        missing = [label for label in tracking if label not in posture.markers]
        kept = sum(weight(label) > 0 for label in present)
        # whether the joints tell the rest: quality/marker_checks.py
        needed = PELVIS_MARKERS_NEEDED if segment == "pelvis" else 1
        if kept < needed and segment in ("pelvis", *linkage.LEG_SEGMENTS):
            lost = ", ".join(f"'{label}'" for label in missing if weight(label) > 0)
            why = (
                f"{lost} not visible while the subject stood still"
                if lost
                else "the marker set gives it no more"
            )
            message = f"found {kept} markers with weight, {why}; allowed: at least {needed}"
            raise InputError(
                message,
                source=posture.source,
                field=f"segment {segment}",
                code=Code.TOO_LITTLE_SEEN,
            )
        dropped += missing
        static_only = [
            label for label in marker_set.static_only.get(segment, ()) if label in posture.markers
        ]
        labels += [*present, *static_only]
        segments += [segment] * (len(present) + len(static_only))
    local = np.array(
        [frames[s].local(posture.markers[m]) for m, s in zip(labels, segments, strict=True)]
    )
    notes = (
        (f"markers of the set that the static trial lacks, left out: {', '.join(dropped)}",)
        if dropped
        else ()
    )
    return MarkerPlacement(
        tuple(labels), tuple(segments), local, np.array([weight(m) for m in labels])
    ), notes


def _compute_joint_parameters(
    frames: dict[str, Frame],
    centres: dict[str, Array],
    body: trunk.UpperBody,
    dorsiflexion: Mapping[str, float],
) -> tuple[Array, Array]:
    """Compute nominal joint parameters and zero angles from the static posture.

    `frames`: frames of all segments but the tali, laboratory. `centres`: `lumbar`, and for each
    side `hjc kjc ajc sjc ejc`: (3,) m, laboratory. `body`: rotation of the shoulders and axes of
    the elbows. `dorsiflexion`: side -> ankle angle of the static posture, rad. Returns: (np,) joint
    parameters and (nz,) zero angles, m and rad.
    """
    values = {
        p.name: float(frames[p.segment].local(centres[CENTRE_OF[p.joint]])[p.axis])
        for p in JOINT_PARAMETERS
        if p.kind is ParameterKind.POSITION and p.joint in CENTRE_OF
    }
    zero: dict[str, float] = {}
    for side in linkage.SIDES:
        values[f"shoulder_{side}.upperarm.trans"] = body.shoulder_turn[side]
        knee_axis = frames[f"thigh_{side}"].rotation[:, 2]
        for hinge, segment, axis in (
            (f"knee_{side}.shank", f"shank_{side}", knee_axis),
            (f"elbow_{side}.forearm", f"forearm_hand_{side}", body.elbow_axis[side]),
        ):
            a = frames[segment].rotation.T @ axis
            values[f"{hinge}.front"] = np.arctan2(-a[1], a[2])
            values[f"{hinge}.trans"] = np.arcsin(np.clip(a[0], -1.0, 1.0))
        s, shank, foot = sign(side), frames[f"shank_{side}"], frames[f"foot_{side}"]
        first = rotations.make_axis_rotation(0, s * TALOCRURAL_FRONT)
        second = rotations.make_axis_rotation(1, s * SUBTALAR_TRANS) @ rotations.make_axis_rotation(
            2, SUBTALAR_SAG
        )
        m = first.T @ (shank.rotation.T @ foot.rotation) @ second
        alpha, beta = np.arctan2(m[1, 0], m[0, 0]), np.arctan2(m[2, 1], m[2, 2])
        talus = shank.rotation @ first @ rotations.make_axis_rotation(2, float(alpha))
        subtalar = foot.local(centres[f"ajc_{side}"] - SUBTALAR_BELOW * talus[:, 1])
        values |= {
            f"talocrural_{side}.shank.front": s * TALOCRURAL_FRONT,
            f"subtalar_{side}.talus.trans": -float(np.arcsin(np.clip(m[2, 0], -1.0, 1.0))),
            f"subtalar_{side}.talus.sup": -SUBTALAR_BELOW,
            f"subtalar_{side}.foot.trans": s * SUBTALAR_TRANS,
            f"subtalar_{side}.foot.sag": SUBTALAR_SAG,
            **{
                f"subtalar_{side}.foot.{d}": x
                for d, x in zip(("ant", "sup", "lat"), subtalar, strict=True)
            },
        }
        zero |= {
            f"talocrural_{side}.zero": alpha - dorsiflexion[side],
            f"subtalar_{side}.zero": beta,
        }
    joint = np.array([values.get(name, 0.0) for name in JP_INDEX])
    joint[np.abs(joint) < _ROUNDING] = 0.0
    return joint, np.array([zero[name] for name in linkage.ZERO_ANGLES])


PUBLISHED = Subject("published nominal subject", 69.4, 1.70, "male")


@with_one_blas_thread
def published_model(*, static_only: bool = False) -> SubjectModel:
    """Make the published nominal subject with its markers (`models/nominal_subject.json`).

    Parameters
    ----------
    static_only : bool
        Whether to include the medial and lateral knee and ankle markers of the static trial.

    Returns
    -------
    SubjectModel
        SI units.
    """
    data = json.loads((find_models_folder() / "nominal_subject.json").read_text(encoding="utf-8"))
    placed: dict[str, tuple[str, Array]] = {}
    bodies = {name.replace("_", ""): name for name in linkage.SEGMENT_TABLE}
    for body, listed in data["markers_local_mm_right_side"].items():
        segment = bodies[body]
        for label, position in listed.items():
            local = 1e-3 * np.array(position, dtype=float)
            if segment in linkage.SEGMENTS:
                placed[label] = (segment, local)
            else:
                placed[f"R.{label}"] = (f"{segment}_r", local)
                placed[f"L.{label}"] = (f"{segment}_l", local * [1.0, 1.0, -1.0])
    marker_set = load_marker_set("published")
    taken_off = {label for group in marker_set.static_only.values() for label in group}
    kept = [label for label in placed if static_only or label not in taken_off]
    labels = tuple(sorted(kept, key=lambda label: linkage.SEGMENTS.index(placed[label][0])))
    markers = MarkerPlacement(
        labels,
        tuple(placed[label][0] for label in labels),
        np.array([placed[label][1] for label in labels]),
        np.array([marker_set.weight(label) for label in labels]),
    )
    parameters = read_published_parameters()
    landmarks = {
        name: (placed[group[0]][0], np.mean([placed[label][1] for label in group], axis=0))
        for name, group in marker_set.landmarks.items()
    }
    for joint in linkage.JOINTS:
        if joint.name in CENTRE_OF:
            landmarks[CENTRE_OF[joint.name]] = (
                joint.parent,
                parameters.centre(joint.name, joint.parent),
            )
    return SubjectModel(
        subject=PUBLISHED,
        parameters=parameters,
        nominal=parameters,
        markers=markers,
        landmarks=dict(sorted(landmarks.items())),
        notes=(
            "the published nominal subject; markers and inertia as in models/nominal_subject.json",
        ),
    )
