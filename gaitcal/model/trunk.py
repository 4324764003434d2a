"""Measure trunk, shoulders and arms in the static posture from the available landmarks.

    origin  lumbar joint L
    y       unit(S - L), S the middle of the shoulder centres
    z       to the right: the line of the acromia, else the normal n of the plane of the midline
            landmarks (C7, T10, jugular notch, xiphoid; the sagittal plane of Wu et al., J Biomech
            38:981-992, 2005), else the horizontal part of the pelvis's lateral direction; each
            across y

The shoulder centres are, by the available landmarks,

1. below both acromia, by 17 % of their distance along y (Rab, Petuskey and Bagley 2002);
2. the same with one acromion and its mirror image across the sagittal plane, whose normal is z as
   above;
3. beside S = M - a y, M the middle of C7 and jugular notch, a the height of M above the shoulders
   in de Leva's table (mean of CERV-MIDS and SUPR-MIDS: 52 mm in men, 74 mm in women, in proportion
   to height), each half the nominal subject's shoulder width from it, in proportion to height;
4. straight above the lumbar joint as the person stands, at the nominal subject's height and width.

Only 1 and 2 are measured. The motion of the trunk follows its markers, however few
(`coordinate_prior.py`).

A part without any marker is frozen: its position is assumed, its lengths are de Leva's, scaled by
height. A frozen trunk is upright, its mass and shoulders straight above the lumbar joint. A frozen
arm hangs along the trunk.

Frames in the static posture are as in `segment_frames.py`. One marker at the elbow and one at the
wrist are enough for an arm:

    trunk       as above: y from the lumbar joint to the middle of the shoulders, z to the right
    upper arm   origin shoulder centre; y = unit(shoulder - elbow); z the elbow's axis across y
    forearm     origin elbow centre; y = unit(elbow - wrist); z the same axis across y

The shoulder rotates about two axes, Rz(flexion) Rx(adduction), so the rotation of the upper arm
about its length is a constant, Ry(-trans). Elbow axis, in this order of preference:

1. the line of a medial and a lateral marker;
2. the normal n of the plane of shoulder S, elbow centre E and wrist W: with the lateral marker M =
   E + s d n, d half the elbow's width, n . (W - S) = 0 and n . (M - S) = s d, if the elbow is bent
   enough;
3. the z axis of a hanging arm after flexion and adduction alone.

If an arm is raised sideways by more than `RAISED_ARM`, flexion and rotation about the arm's length
are nearly the same motion. The rotation is then not representative of walking, and `trans` is zero.
With one elbow marker, so is the angle between upper arm and forearm across the elbow's axis.
"""

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model import anthropometry, rotations
from gaitcal.model import segment_frames as axes
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import OTHER_SIDE, SIDE_WORDS, SIDES
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.subject_model import Subject

PLANE_LANDMARKS = 3  # landmarks that a plane goes through
OFF_LINE = 0.020
"""m, RMS distance of these markers from the straight line that is nearest to them. Skin that moves
by 5 mm turns markers which are nearer to one line by more than 15 degrees about it."""
LARGEST_TWIST = np.deg2rad(30.0)
"""More than this between the plane of the midline landmarks and the pelvis's sagittal plane, and
one is mislabelled.
"""
SHOULDER_BELOW_ACROMION = 0.17
"""Of the distance between the acromia, along the trunk: Rab, Petuskey and Bagley, Gait & Posture 15
(2002).
"""
# m from the lumbar joint in the nominal subject
SHOULDER_UP, SHOULDER_OUT = 0.3519, 0.165
_LANDMARK_TITLES = {
    "c7": "C7",
    "t10": "T10",
    "jugular_notch": "jugular notch",
    "xiphoid": "xiphoid",
}
MIDLINE = tuple(_LANDMARK_TITLES)  # landmarks in the trunk's sagittal plane
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class Trunk:
    """Head and trunk in the static posture, laboratory."""

    frame: axes.Frame
    shoulders: dict[str, Array]  # `sjc_r`, `sjc_l`: (3,) m
    observed: bool  # whether any marker with weight shows it
    notes: tuple[str, ...]


def measure_trunk(
    posture: StaticPosture,
    marker_set: MarkerSet,
    pelvis: axes.Frame,
    lumbar: Array,
    subject: Subject,
) -> Trunk:
    """Measure the trunk from its landmarks, or assume it upright on the pelvis.

    `posture`: landmarks of the static posture, m. `pelvis`: frame of the pelvis in the static
    posture. `lumbar`: (3,) lumbar joint, m. `subject`: height and sex give the proportions if no
    acromion is known. Returns: frame, shoulder centres (m), and notes.
    """
    shown = any(
        m in posture.markers and marker_set.weight(m) > 0
        for m in marker_set.tracking.get("head_trunk", ())
    )
    shoulders, z, notes = _locate_shoulders(posture, pelvis, lumbar, subject)
    y = axes.normalise(0.5 * (shoulders["sjc_r"] + shoulders["sjc_l"]) - lumbar)
    if not shown:
        notes = ("head and trunk are taken to stand upright, as no marker with weight shows them",)
    return Trunk(
        frame=axes.build_frame(lumbar, y, z), shoulders=shoulders, observed=shown, notes=notes
    )


def _locate_shoulders(
    posture: StaticPosture, pelvis: axes.Frame, lumbar: Array, subject: Subject
) -> tuple[dict[str, Array], Array, tuple[str, ...]]:
    """Locate the shoulder centres; also the direction (3,) of z, and notes."""
    p = posture.landmarks
    known = [side for side in SIDES if posture.has(f"acromion_{side}")]
    if len(known) == len(SIDES):
        right, left = p["acromion_r"], p["acromion_l"]
        notes = ("shoulder centres 17 % of the distance between the acromia below them (Rab 2002)",)
        return _place_below_acromia(right, left, lumbar), right - left, notes
    z, plane = _find_lateral_direction(posture, pelvis)
    if known:
        side, other = known[0], OTHER_SIDE[known[0]]
        middle = [p[name] for name in MIDLINE if posture.has(name)] or [lumbar]
        acromion = p[f"acromion_{side}"]
        mirrored = acromion - 2.0 * float((acromion - np.mean(middle, axis=0)) @ z) * z
        right, left = (acromion, mirrored) if side == "r" else (mirrored, acromion)
        why = f"acromion, {SIDE_WORDS[other]}: {posture.describe_absence(f'acromion_{other}')}"
        note = f"{why}; taken as the mirror image of the other across the {plane}"
        return _place_below_acromia(right, left, lumbar), right - left, (note,)
    if posture.has("c7", "jugular_notch"):
        middle_of_neck = 0.5 * (p["c7"] + p["jugular_notch"])
        down = compute_neck_height(subject)
        centre = middle_of_neck - down * axes.normalise(middle_of_neck - lumbar)
        out = SHOULDER_OUT / axes.NOMINAL_HEIGHT * subject.height
        sideways = axes.project_across(z, axes.normalise(centre - lumbar))
        note = (
            f"no acromion is known: shoulder centres {1e3 * down:.0f} mm below the middle of C7 "
            "and jugular notch "
            f"(de Leva 1996) and {1e3 * out:.0f} mm beside it (nominal subject), both in "
            "proportion to height; the "
            f"trunk faces along the {plane}"
        )
        return (
            {f"sjc_{side}": centre + axes.sign(side) * out * sideways for side in SIDES},
            z,
            (note,),
        )
    note = (
        "neither acromia nor both C7 and jugular notch are known: shoulder centres straight above "
        "the lumbar joint in "
        "the static trial, as in the nominal subject, in proportion to height; the trunk faces "
        f"along the {plane}"
    )
    scale, sideways = subject.height / axes.NOMINAL_HEIGHT, _project_horizontally(z)
    above = lumbar + scale * SHOULDER_UP * _UP
    return (
        {
            f"sjc_{side}": above + axes.sign(side) * scale * SHOULDER_OUT * sideways
            for side in SIDES
        },
        z,
        (note,),
    )


def compute_neck_height(subject: Subject) -> float:
    """Compute the height (m) of the middle of the neck above the shoulder centres."""
    whole = [anthropometry.compute_default_length(name, subject) for name in ("Trunk", "Trunk2")]
    return float(np.mean(whole)) - anthropometry.compute_default_length("Trunk3", subject)


def _find_lateral_direction(posture: StaticPosture, pelvis: axes.Frame) -> tuple[Array, str]:
    """Find the unit vector (3,) to the trunk's right, and the name of its normal plane."""
    of_pelvis = _project_horizontally(pelvis.rotation[:, 2])
    there = [name for name in MIDLINE if posture.has(name)]
    points = np.array([posture.landmarks[name] for name in there])
    if len(there) < PLANE_LANDMARKS or axes.measure_distance_from_line(points) < OFF_LINE:
        return of_pelvis, "pelvis's sagittal plane"
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    normal = normal if normal @ of_pelvis > 0 else -normal
    angle = float(np.arccos(np.clip(normal @ of_pelvis, -1.0, 1.0)))
    names = ", ".join(_LANDMARK_TITLES[name] for name in there)
    if angle > LARGEST_TWIST:
        return of_pelvis, (
            f"pelvis's sagittal plane (that of {names} is turned by {np.rad2deg(angle):.0f} deg "
            "against it, more than "
            f"{np.rad2deg(LARGEST_TWIST):.0f} deg: one of them is not where its name says)"
        )
    return normal, f"plane of {names}"


def _place_below_acromia(right: Array, left: Array, lumbar: Array) -> dict[str, Array]:
    """Place the shoulder centres (3,) m below the acromia."""
    down = (
        -SHOULDER_BELOW_ACROMION
        * float(np.linalg.norm(right - left))
        * axes.normalise(0.5 * (right + left) - lumbar)
    )
    return {"sjc_r": right + down, "sjc_l": left + down}


def _project_horizontally(direction: Array) -> Array:
    """Compute the horizontal part of a direction, as a unit vector."""
    return axes.normalise(direction - (direction @ _UP) * _UP)


RAISED_ARM = np.deg2rad(45.0)
"""Largest angle of an arm from the trunk's sagittal plane at which its rotation about its length is
measured."""
# distance of the elbow marker from the line shoulder-wrist, in half elbow widths, for the plane to
# be used
BENT_ELBOW = 1.5


@dataclass(frozen=True, kw_only=True)
class UpperBody:
    """Frames and joint centres of trunk and arms, laboratory."""

    frames: dict[str, axes.Frame]
    centres: dict[str, Array]  # `sjc ejc wjc` of both sides, (3,) m
    shoulder_turn: dict[str, float]  # side -> `shoulder.upperarm.trans`, rad
    # side -> (3,) direction in the laboratory of the elbow's axis as the forearm has it
    elbow_axis: dict[str, Array]
    # sides whose arm is raised sideways in the static trial
    raised: tuple[str, ...]
    frozen_segments: tuple[str, ...]
    notes: tuple[str, ...]


def measure_upper_body(
    posture: StaticPosture, marker_set: MarkerSet, legs: axes.LowerBody, subject: Subject
) -> UpperBody:
    """Measure trunk and arms as far as there are markers.

    Parameters
    ----------
    posture : StaticPosture
        Landmarks of the static posture, m.
    marker_set : MarkerSet
        Meaning of the markers.
    legs : LowerBody
        Frames and centres of pelvis and legs.
    subject : Subject
        Height and sex give the lengths of parts without markers.

    Returns
    -------
    UpperBody
        Frames, centres (m), elbow axes, and segments frozen for lack of markers.
    """
    body = measure_trunk(
        posture, marker_set, legs.frames["pelvis"], legs.centres["lumbar"], subject
    )
    trunk, centres, notes, frozen = body.frame, dict(body.shoulders), [*body.notes], list[str]()
    frames, down = {"head_trunk": trunk}, -trunk.rotation[:, 1]
    turn, axis, raised = dict.fromkeys(SIDES, 0.0), dict.fromkeys(SIDES, trunk.rotation[:, 2]), []
    limbs = anthropometry.compute_default_limb_lengths(subject)

    def why_not(segment: str, landmark: str) -> str:
        """Why a segment of an arm cannot be measured; nothing where it can."""
        if not posture.has(landmark):
            return posture.describe_absence(landmark)
        shown = any(label in posture.markers for label in marker_set.tracking.get(segment, ()))
        return "" if shown else "no tracking marker was seen"

    for side in SIDES:
        upper_arm, forearm = f"upper_arm_{side}", f"forearm_hand_{side}"
        shoulder = centres[f"sjc_{side}"]
        if no_arm := why_not(upper_arm, f"elbow_lat_{side}"):
            frozen += [upper_arm, forearm]
            notes.append(f"{upper_arm} and {forearm} hang along the trunk, as {no_arm}")
            elbow = shoulder + limbs[upper_arm] * down
            frames |= {
                upper_arm: axes.Frame(trunk.rotation, shoulder),
                forearm: axes.Frame(trunk.rotation, elbow),
            }
            centres |= {f"ejc_{side}": elbow, f"wjc_{side}": elbow + limbs[forearm] * down}
            continue
        arm = measure_arm(posture, side, trunk, shoulder, subject.height)
        notes += arm.notes
        frames[upper_arm], centres[f"ejc_{side}"] = arm.upper, arm.elbow
        turn[side], axis[side] = arm.turn, arm.axis
        raised += [side] if arm.raised else []
        no_forearm = why_not(forearm, f"wrist_{side}")
        if not no_forearm and arm.forearm is not None and arm.wrist is not None:
            frames[forearm], centres[f"wjc_{side}"] = arm.forearm, arm.wrist
        else:
            frozen.append(forearm)
            notes.append(f"{forearm} is taken to be straight with the upper arm, as {no_forearm}")
            frames[forearm], axis[side] = (
                axes.Frame(arm.upper.rotation, arm.elbow),
                arm.upper.rotation[:, 2],
            )
            centres[f"wjc_{side}"] = arm.elbow - limbs[forearm] * arm.upper.rotation[:, 1]
    if not body.observed and all(f"upper_arm_{side}" in frozen for side in SIDES):
        frozen.insert(0, "head_trunk")
    return UpperBody(
        frames=frames,
        centres=centres,
        shoulder_turn=turn,
        elbow_axis=axis,
        raised=tuple(raised),
        frozen_segments=tuple(frozen),
        notes=tuple(notes),
    )


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One arm in the static posture."""

    upper: axes.Frame
    elbow: Array  # (3,) m, elbow centre
    forearm: axes.Frame | None  # None where no wrist is known
    wrist: Array | None  # (3,) m
    turn: float  # rad, the joint parameter `shoulder.upperarm.trans`
    axis: Array  # (3,) the elbow's axis as the forearm has it, pointing right
    raised: bool  # whether the arm is raised sideways
    notes: tuple[str, ...]


def measure_arm(
    posture: StaticPosture, side: str, trunk: axes.Frame, shoulder: Array, height: float
) -> Arm:
    """Measure one arm from `elbow_lat` and, if known, `elbow_med` and `wrist`.

    `posture`: landmarks of the static posture, m. `side`: `r` or `l`. `shoulder`: (3,) shoulder
    centre, m. `height`: body height, m. Returns: frames, centres (m) and the elbow's axis,
    laboratory.
    """
    p = posture.landmarks
    lateral, wrist = p[f"elbow_lat_{side}"], p.get(f"wrist_{side}")
    notes: list[str] = []
    elbow_words, shoulder_words = (
        f"{joint}, {SIDE_WORDS[side]}" for joint in ("elbow", "shoulder")
    )
    if posture.has(f"elbow_med_{side}"):
        medial = p[f"elbow_med_{side}"]
        elbow = 0.5 * (lateral + medial)
        axis = axes.sign(side) * (lateral - medial)
        if axis @ _compute_unrotated_axis(axes.normalise(shoulder - elbow), trunk) < 0:
            axis = -axis
            notes.append(
                f"{elbow_words}: the lateral marker is on the medial side; the two labels were "
                "swapped"
            )
    else:
        inwards = axes.sign(side) * axes.compute_half_width("elbow", height)
        normal = (
            None if wrist is None else _find_arm_plane_normal(shoulder, lateral, wrist, inwards)
        )
        elbow = axis = lateral
        for _ in range(
            1 if normal is not None else axes.ROUNDS
        ):  # without a bent arm, as of an arm not turned
            before = elbow
            axis = (
                _compute_unrotated_axis(axes.normalise(shoulder - elbow), trunk)
                if normal is None
                else normal
            )
            elbow = lateral - inwards * axis
            if np.abs(elbow - before).max() <= axes.SETTLED:
                break
        how = (
            "at right angles to the plane of the bent arm"
            if normal is not None
            else "as in an arm not turned"
        )
        notes.append(
            f"{elbow_words}: one marker; its centre is assumed {1e3 * abs(inwards):.0f} mm "
            f"inwards, its axis {how}"
        )
    upper = axes.build_frame(shoulder, axes.normalise(shoulder - elbow), axis)
    forearm = (
        None
        if wrist is None
        else axes.build_frame(elbow, axes.normalise(elbow - wrist), upper.rotation[:, 2])
    )
    rotation = trunk.rotation.T @ upper.rotation  # Rz Rx Ry(-trans)
    is_raised = abs(np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))) > RAISED_ARM
    axis = upper.rotation[:, 2]
    if is_raised:
        notes.append(
            f"{shoulder_words}: the arm is raised sideways in the static trial, so that its turn "
            "about its own "
            "length is assumed zero; the static posture of the arm is met less closely"
        )
        if forearm is not None and not posture.has(f"elbow_med_{side}"):
            axis = forearm.rotation[:, 2]
    return Arm(
        upper=upper,
        elbow=elbow,
        forearm=forearm,
        wrist=wrist,
        turn=0.0 if is_raised else float(np.arctan2(rotation[2, 0], rotation[2, 2])),
        axis=axis,
        raised=bool(is_raised),
        notes=tuple(notes),
    )


def _compute_unrotated_axis(y: Array, trunk: axes.Frame) -> Array:
    """Compute the z axis of an arm that flexion and adduction alone bring to this y."""
    a = trunk.rotation.T @ y
    lift = rotations.make_axis_rotation(0, float(np.arcsin(np.clip(a[2], -1.0, 1.0))))
    if abs(np.arcsin(np.clip(a[2], -1.0, 1.0))) > RAISED_ARM:
        return trunk.rotation @ axes.project_across(lift[:, 2], a)
    return (
        trunk.rotation
        @ rotations.make_axis_rotation(2, float(np.arctan2(-a[0], a[1])))
        @ lift[:, 2]
    )


def _find_arm_plane_normal(
    shoulder: Array, lateral: Array, wrist: Array, inwards: float
) -> Array | None:
    """Find the normal (3,) of the plane of a bent arm (rule 2); None if the elbow is too straight.

    With w from shoulder to wrist and m from their line to the marker: n = cos m - sin (w x m), cos
    = s d / |marker - line|. The other solution, + sin, would bend the forearm backwards.
    """
    w = axes.normalise(wrist - shoulder)
    off = (lateral - shoulder) - ((lateral - shoulder) @ w) * w
    distance = float(np.linalg.norm(off))
    if distance < BENT_ELBOW * abs(inwards):
        return None
    m, cosine = off / distance, inwards / distance
    return cosine * m - np.sqrt(1.0 - cosine**2) * np.cross(w, m)
