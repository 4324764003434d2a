"""Place bones on a subject's landmarks, and compare knee axes with the femoral condyles.

Every bone has an affine map from its frame to that of a segment. With y the direction between the
two ends of a bone, z to its right across y (`segment_frames.build_frame`), R the axes in the bone
and R' those in the person, and b, b' the lower ends,

    p' = b' + R' diag(l, l, w) R^T (p - b)
    l = ratio of the lengths, w = ratio of the widths across y

Both ends and the rotation about the length thus follow the subject. In the sagittal plane a bone is
scaled equally in both directions, so that round condyles stay round. The inclination of the
epicondylar line to the length stays that of the bone, as palpation is less accurate than anatomy:
10 mm between two markers in height are 7 degrees. The remaining distance of epicondyle and marker
is `KneeAxis.misfit`. The pelvis has four landmarks (both hips, mid-ASIS, mid-PSIS) and the affine
map that meets all of them. The foot is scaled equally in all directions, about the ankle.

The position of a knee axis relative to the condyles is given by its distances from their centres
and its angle to the line through them. For an axis through a with direction u, and the centre m of
a condyle of the femur,

    foot of m:  f = a + u (u.(m - a)),      offset = f - m,      distance = |offset|,

and with covariances C_a of the centre and C_u of the direction, taken as independent, and h = u.(m
- a), the standard error of the distance is the root of the trace of P (C_a + h^2 C_u) P / 2, P = 1
- u u^T: the mean over the two directions across the axis. The angle is that between u and the line
through both condyles' centres; its error is the same root of C_u.
"""

import math
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import build_frame, normalise
from gaitcal.report.page import bone_files, bone_landmarks, scene
from gaitcal.report.page.body_meshes import FOOT_OF_HEIGHT, FittedMesh, Mesh

MIRROR = {
    "r": np.ones(3),
    "l": np.array([1.0, 1.0, -1.0]),
}  # From a bone of the right side to that of a side
CARTILAGE = 0.004
"""m between the bones of the knee: twice the 2 mm of cartilage of a healthy tibia and femur (Cohen
et al. 1999).
"""
TALUS_IN_FOOT = np.array([0.04877, 0.04195, -0.00792])
TOES_IN_FOOT = np.array([0.1788, -0.002, 0.00108])
RADIUS_IN_ULNA = np.array([-0.006727, -0.013007, 0.026083])
SHOULDER_IN_TRUNK = np.array([0.003155, 0.3715, 0.17])
"""m: frames of the bodies to each other in Rajagopal et al. (2016), in which these bones are drawn.
"""
_TOE_TIP_OF_HEIGHT = 0.131
"""Of body height: markers of heel and toe further apart than this stand on the tip of the foot,
nearer ones on the second metatarsal's head (the head at 0.73 of the foot's length, Drillis and
Contini 1966)."""
_HEAD_OF_METATARSAL = 0.73
_ALLOWED_FOOT = (0.8, 1.25)
"""Of the length that goes with body height; a foot by its markers beyond that is drawn by height.
"""


@dataclass(frozen=True)
class Landmarked:
    """Bones with their landmarks."""

    bones: bone_files.BoneMeshes
    femur: bone_landmarks.LongBone
    condyles: bone_landmarks.Condyles
    hip: bone_landmarks.HipBone
    shank: bone_landmarks.ShankBones

    @property
    def foot_length(self) -> float:
        """Distance of heel and toes, m."""
        foot = self.bones.meshes["foot"].vertices[:, 0]
        toes = (
            self.bones.meshes["toes"].vertices[:, 0] + TOES_IN_FOOT[0]
            if "toes" in self.bones.meshes
            else foot
        )
        return float(max(toes.max(), foot.max()) - foot.min())


def find_landmarks(bones: bone_files.BoneMeshes) -> Landmarked:
    """Find the landmarks of all bones.

    Raises
    ------
    InputError
        A bone lacks a landmark: its shape, unit or direction is not as expected.
    """
    femur, tibia, fibula, pelvis = (
        bones.meshes[name] for name in ("femur", "tibia", "fibula", "pelvis")
    )
    try:
        thigh = bone_landmarks.find_long_bone(femur)
        found = Landmarked(
            bones,
            thigh,
            bone_landmarks.find_condyles(femur),
            bone_landmarks.find_hip_bone(pelvis, thigh.head.radius),
            bone_landmarks.find_shank_bones(tibia, fibula),
        )
        bone_landmarks.check_directions(femur, found.hip, tibia, fibula)
    except bone_landmarks.NoLandmark as error:
        message = (
            f"found {error} on its surface; allowed: right bones with x forward, y up, z to the "
            "right, m"
        )
        raise InputError(message, source=bones.source, code=Code.BONES) from error
    return found


@dataclass(frozen=True)
class _Ends:
    """Upper and lower end of a bone, and the direction to its right with its width."""

    upper: Array
    lower: Array
    right: Array


def _map_between(bone: _Ends, person: _Ends) -> Array:
    """Return the (3, 4) affine map from a bone to a subject."""
    frames, lengths, widths = [], [], []
    for ends in (bone, person):
        along = ends.upper - ends.lower
        frame = build_frame(ends.lower, normalise(along), ends.right)
        frames.append(frame.rotation)
        lengths.append(float(np.linalg.norm(along)))
        widths.append(float(abs(ends.right @ frame.rotation[:, 2])))
    long, wide = lengths[1] / lengths[0], widths[1] / widths[0]
    matrix = frames[1] @ np.diag([long, long, wide]) @ frames[0].T
    return np.column_stack([matrix, person.lower - matrix @ bone.lower])


def apply_map(place: Array, points: Array) -> Array:
    """Apply a (3, 4) map to points (..., 3)."""
    out: Array = points @ place[:, :3].T + place[:, 3]
    return out


def _mirror_map(place: Array, side: str) -> Array:
    """Convert the map of a mirrored left bone to the map of the mesh of the right bone."""
    return place if side == "r" else np.column_stack([place[:, :3] * MIRROR[side], place[:, 3]])


def _shift_map(place: Array, offset: Array) -> Array:
    """Return the map of a mesh whose frame has its origin at `offset` in the mapped frame."""
    return np.column_stack([place[:, :3], apply_map(place, offset)])


def map_femur(bones: Landmarked, person: bone_landmarks.PersonLandmarks, side: str) -> Array:
    """Return the (3, 4) map from the femur of that side (the left one mirrored) to the thigh."""
    bone, mirror, s, thigh = (
        bones.femur,
        MIRROR[side],
        1.0 if side == "r" else -1.0,
        f"thigh_{side}",
    )
    # Three points determine the map: hip, knee, and the epicondyle line for breadth and rotation.
    across = person.point(thigh, "epicondyle_lat") - person.point(thigh, "epicondyle_med")
    return _map_between(
        _Ends(
            bone.head.centre * mirror,
            bone.middle * mirror,
            s * (bone.lateral - bone.medial) * mirror,
        ),
        _Ends(person.point(thigh, "hip"), person.point(thigh, "knee"), s * across),
    )


def map_shank(bones: Landmarked, person: bone_landmarks.PersonLandmarks, side: str) -> Array:
    """Return the (3, 4) map from tibia and fibula to the shank, plateau below the condyles."""
    bone, pair, mirror, s, shank = (
        bones.shank,
        bones.condyles,
        MIRROR[side],
        1.0 if side == "r" else -1.0,
        f"shank_{side}",
    )
    # Scale of the femur along its shaft, person over bone.
    long = float(np.linalg.norm(map_femur(bones, person, side)[:, 1]))
    # The condyles' centres are behind the epicondyles; the shank is upright in the static trial.
    behind = 0.5 * float(pair.medial.centre[0] + pair.lateral.centre[0]) - float(
        bones.femur.middle[0]
    )
    knee = person.point(shank, "knee") + [long * behind, -long * pair.drop - CARTILAGE, 0.0]
    across = person.point(shank, "malleolus_lat") - person.point(shank, "malleolus_med")
    middle = 0.5 * (bone.lateral + bone.medial)
    return _map_between(
        _Ends(bone.plateau * mirror, middle * mirror, s * (bone.lateral - bone.medial) * mirror),
        _Ends(knee, person.point(shank, "ankle"), s * across),
    )


def _map_pelvis(bones: Landmarked, person: bone_landmarks.PersonLandmarks) -> Array:
    """Return the (3, 4) map of the pelvis that meets hips, mid-ASIS and mid-PSIS."""
    bone, flat = bones.hip, np.array([1.0, 1.0, 0.0])
    right, left = (person.point("pelvis", f"hip_{side}") for side in SIDES)
    middle, socket = 0.5 * (right + left), bone.socket * flat
    of_bone = [bone.socket - socket, bone.asis * flat - socket]
    of_person = [right - middle, person.point("pelvis", "asis") - middle]
    if "pelvis/psis" in person.points:
        of_bone.append(bone.psis * flat - socket)
        of_person.append(person.point("pelvis", "psis") - middle)
    else:  # across the two others, as long as mid-hip to mid-ASIS makes it
        of_bone.append(np.cross(normalise(of_bone[0]), of_bone[1]))
        of_person.append(np.cross(normalise(of_person[0]), of_person[1]))
    matrix = np.column_stack(of_person) @ np.linalg.inv(np.column_stack(of_bone))
    return np.column_stack([matrix, middle - matrix @ socket])


def _map_foot(
    bones: Landmarked, person: bone_landmarks.PersonLandmarks, side: str, height: float
) -> Array:
    """Return the (3, 4) map of the foot: ankle on ankle, upright, along the heel-toe line."""
    segment = f"foot_{side}"
    up, heel_to_toe = (
        person.point(segment, "up"),
        float(np.linalg.norm(person.point(segment, "heel_to_toe"))),
    )
    expected = FOOT_OF_HEIGHT * height
    # The toe marker may be on the tip of the foot or on a metatarsal head: m, from heel to tip.
    length = (
        heel_to_toe
        if heel_to_toe > _TOE_TIP_OF_HEIGHT * height
        else heel_to_toe / _HEAD_OF_METATARSAL
    )
    # Markers elsewhere on the foot would give an impossible foot.
    if not _ALLOWED_FOOT[0] * expected <= length <= _ALLOWED_FOOT[1] * expected:
        length = expected
    rotation = build_frame(np.zeros(3), up, np.cross(np.array([1.0, 0.0, 0.0]), up)).rotation
    scaled = rotation * (length / bones.foot_length)
    return np.column_stack(
        [scaled, person.point(segment, "ankle") - scaled @ (TALUS_IN_FOOT * MIRROR[side])]
    )


def _map_trunk(person: bone_landmarks.PersonLandmarks) -> Array:
    """Return the (3, 4) map of spine and ribs, from the lumbar joint to the shoulders."""
    right, left = (person.point("head_trunk", f"shoulder_{side}") for side in SIDES)
    return _map_between(
        _Ends(
            SHOULDER_IN_TRUNK * [1.0, 1.0, 0.0], np.zeros(3), SHOULDER_IN_TRUNK * [0.0, 0.0, 2.0]
        ),
        _Ends(0.5 * (right + left), person.point("head_trunk", "lumbar"), right - left),
    )


def _map_head(skull: Array, trunk: Array, vertex: Array) -> Array:
    """Return the (3, 4) map of the head: neck on the trunk, top of the skull at the vertex."""
    root = np.array([0.0, SHOULDER_IN_TRUNK[1] + 0.04, 0.0])
    rise = float((vertex - apply_map(trunk, root)) @ normalise(trunk[:, 1]))
    scale = rise / float(skull[:, 1].max() - root[1])
    matrix = np.column_stack([normalise(trunk[:, k]) for k in range(3)]) * scale
    return np.column_stack([matrix, apply_map(trunk, root) - matrix @ root])


def fit_bones(
    bones: Landmarked, person: bone_landmarks.PersonLandmarks, height: float
) -> tuple[FittedMesh, ...]:
    """Fit all bones of a subject into their segments; `height` (m) of the subject."""
    available = bones.bones.meshes
    pelvis = _map_pelvis(bones, person)
    out = [
        ("pelvis", "pelvis", pelvis),
        ("pelvis", "pelvis", _mirror_map(pelvis, "l")),
        ("sacrum", "pelvis", pelvis),
    ]
    # Ribs and spine move as one segment of the model.
    trunk = _map_trunk(person)
    out += [
        (bone, "head_trunk", trunk) for bone in ("ribs", "spine", "thoracic spine", "lumbar spine")
    ]
    if "skull" in available:
        head = _map_head(available["skull"].vertices, trunk, person.point("head_trunk", "vertex"))
        out += [(bone, "head_trunk", head) for bone in ("neck", "skull", "jaw")]
    for side in SIDES:
        femur, shank = map_femur(bones, person, side), map_shank(bones, person, side)
        out.append(("femur", f"thigh_{side}", _mirror_map(femur, side)))
        out += [(bone, f"shank_{side}", _mirror_map(shank, side)) for bone in ("tibia", "fibula")]
        out += _place_foot_bones(bones, person, side, height) if "foot" in available else []
        out += _place_arm_bones(bones, person, side)
    return tuple(
        FittedMesh(bone, segment, place) for bone, segment, place in out if bone in available
    )


def _place_foot_bones(
    bones: Landmarked, person: bone_landmarks.PersonLandmarks, side: str, height: float
) -> list[tuple[str, str, Array]]:
    foot = _mirror_map(_map_foot(bones, person, side, height), side)
    into_talus = person.points[f"talus_{side}/foot"]
    talus = _shift_map(foot, TALUS_IN_FOOT)
    moved = np.column_stack([into_talus[:, :3] @ talus[:, :3], apply_map(into_talus, talus[:, 3])])
    return [
        ("foot", f"foot_{side}", foot),
        ("toes", f"foot_{side}", _shift_map(foot, TOES_IN_FOOT)),
        ("talus", f"talus_{side}", moved),
    ]


def _place_arm_bones(
    bones: Landmarked, person: bone_landmarks.PersonLandmarks, side: str
) -> list[tuple[str, str, Array]]:
    available, mirror = bones.bones.meshes, MIRROR[side]
    upper, fore, right = f"upper_arm_{side}", f"forearm_hand_{side}", np.array([0.0, 0.0, 1.0])
    out = []
    if "humerus" in available:
        bone = bone_landmarks.find_long_bone(available["humerus"])
        length = float(np.linalg.norm(bone.head.centre - bone.middle))
        ends = person.point(upper, "shoulder"), person.point(upper, "elbow")
        wide = (
            float(np.linalg.norm(ends[0] - ends[1]))
            / length
            * abs(float(bone.lateral[2] - bone.medial[2]))
        )
        across = right * (bone.lateral[2] - bone.medial[2])
        place = _map_between(
            _Ends(bone.head.centre * mirror, bone.middle * mirror, across),
            _Ends(*ends, right * wide),
        )
        out.append(("humerus", upper, _mirror_map(place, side)))
    if "ulna" in available:
        # The lowest centimetre is the wrist.
        lower = available["ulna"].vertices
        end = lower[lower[:, 1] < lower[:, 1].min() + 0.01].mean(axis=0) * mirror
        ends = person.point(fore, "elbow"), person.point(fore, "wrist")
        wide = float(np.linalg.norm(ends[0] - ends[1]) / np.linalg.norm(end))
        place = _mirror_map(
            _map_between(_Ends(np.zeros(3), end, right), _Ends(*ends, right * wide)), side
        )
        out += [("ulna", fore, place), ("radius", fore, _shift_map(place, RADIUS_IN_ULNA))]
    return out


PALPATION_M = 0.008
"""m a coordinate: epicondyles found by different examiners (Della Croce et al., Gait Posture
21:226-237, 2005, give 6 to 21 mm for landmarks of the leg, all directions together)."""
_STANDS = {
    bone_landmarks.KneeEvidence.BOTH: (
        "The femur is placed by the markers of both epicondyles and by the fitted hip centre."
    ),
    bone_landmarks.KneeEvidence.DEVICE: (
        "The femur is placed by the lateral epicondyle's marker, the knee alignment device and the "
        "fitted hip centre."
    ),
    bone_landmarks.KneeEvidence.LATERAL: (
        "Only the lateral epicondyle has a marker: the femur's rotation is assumed from the "
        "pelvis, and proves nothing."
    ),
    bone_landmarks.KneeEvidence.NOMINAL: (
        "No landmark of this knee is known: the femur is placed by the nominal knee, and proves "
        "nothing."
    ),
}
_PASSES = {
    "circle": ("through both condyles", "through the {} condyle"),
    "bone": (
        "through the bone, outside both condyles' circles",
        "through the bone outside the {} condyle's circle",
    ),
    "outside": ("past both condyles", "past the {} condyle"),
}
"""Where an axis passes: at both condyles, at one."""


@dataclass(frozen=True, kw_only=True)
class AxisInCondyle:
    """Position of an axis at one condyle."""

    distance: float  # m from the condyle's centre to the axis
    radius: float  # m of the condyle's circle
    standard_error: float  # m of the distance, from the fit; NaN where none is known
    inside: bool
    """Whether the axis is within the bone where it passes the centre: the femur as a whole, not the
    condyle alone.
    """


@dataclass(frozen=True, kw_only=True)
class AxisInKnee:
    """Position of an axis at both condyles."""

    medial: AxisInCondyle
    lateral: AxisInCondyle
    angle: float  # Rad between the axis and the line through the condyles' centres
    angle_error: float
    """Rad, standard error of the axis's direction, the mean over its two directions; NaN where none
    is known.
    """

    @property
    def ends(self) -> dict[str, AxisInCondyle]:
        """Condyle -> the axis there."""
        return {"medial": self.medial, "lateral": self.lateral}


@dataclass(frozen=True, kw_only=True)
class KneeAxis:
    """The axes of one knee relative to its condyles."""

    side: str
    evidence: bone_landmarks.KneeEvidence
    misfit: float  # m from the bone's epicondyles to where the markers have them, the larger one
    fitted: AxisInKnee | None  # None where the knee was not fitted
    nominal: AxisInKnee
    centres: Array  # (2, 3) m, medial and lateral condyle, in the thigh
    radii: Array  # (2,) m of their circles
    across: Array  # (3,) unit normal of both circles, in the thigh


def measure_knee_axes(
    bones: Landmarked, person: bone_landmarks.PersonLandmarks, joints: tuple[scene.JointMark, ...]
) -> tuple[KneeAxis, ...]:
    """Measure the axes of right and left knee relative to the condyles."""
    out = []
    bone, pair = bones.bones.meshes["femur"], bones.condyles
    for side in SIDES:
        mark = next(j for j in joints if (j.joint, j.segment) == (f"knee_{side}", f"thigh_{side}"))
        place, mirror = map_femur(bones, person, side), MIRROR[side]
        femur = Mesh(apply_map(place, bone.vertices * mirror), bone.triangles)
        centres = apply_map(place, np.array([pair.medial.centre, pair.lateral.centre]) * mirror)
        # The sagittal plane is scaled alike: the factor is the length of the map of its y axis.
        radii = np.array([pair.medial.radius, pair.lateral.radius]) * float(
            np.linalg.norm(place[:, 1])
        )
        drawn = apply_map(place, np.array([bones.femur.lateral, bones.femur.medial]) * mirror)
        wanted = np.array(
            [person.point(f"thigh_{side}", f"epicondyle_{end}") for end in ("lat", "med")]
        )
        none = np.full((3, 3), np.nan)
        fitted = (mark.fitted_centre, mark.fitted_axis, mark.centre_spread, mark.axis_spread)
        out.append(
            KneeAxis(
                side=side,
                evidence=person.knees[side],
                misfit=float(np.linalg.norm(drawn - wanted, axis=1).max()),
                fitted=_measure_axis(femur, centres, radii, *fitted) if mark.fitted else None,
                nominal=_measure_axis(
                    femur, centres, radii, mark.nominal_centre, mark.nominal_axis, none, none
                ),
                centres=centres,
                radii=radii,
                across=normalise(place[:, 2]),
            )
        )
    return tuple(out)


def _measure_axis(
    femur: Mesh,
    centres: Array,
    radii: Array,
    start: Array,
    direction: Array,
    centre_spread: Array,
    axis_spread: Array,
) -> AxisInKnee:
    """Measure the axis through `start` (3,) m along `direction`; spreads as in `JointMark`."""
    # Errors along the axis do not move it: only the part across it counts.
    across = np.eye(3) - np.outer(direction, direction)
    tilted = axis_spread @ axis_spread.T

    def error(covariance: Array) -> float:
        return math.sqrt(max(float(np.trace(across @ covariance @ across)), 0.0) / 2.0)

    def condyle(centre: Array, radius: float) -> AxisInCondyle:
        # The nearest point of the axis to the centre of the condyle.
        reach = float(direction @ (centre - start))
        passing = start + reach * direction
        return AxisInCondyle(
            distance=float(np.linalg.norm(passing - centre)),
            radius=float(radius),
            standard_error=error(centre_spread @ centre_spread.T + reach**2 * tilted),
            inside=bone_landmarks.is_inside(femur, passing),
        )

    line = centres[1] - centres[0]
    cosine = abs(float(direction @ line)) / float(np.linalg.norm(line))
    medial, lateral = (
        condyle(centre, radius) for centre, radius in zip(centres, radii, strict=True)
    )
    return AxisInKnee(
        medial=medial, lateral=lateral, angle=math.acos(min(1.0, cosine)), angle_error=error(tilted)
    )


def describe_knee(knee: KneeAxis) -> list[str]:
    """Describe where fitted and nominal axis pass the condyles, and the evidence for it."""
    lines = [] if knee.fitted else ["Not fitted: the axis is the nominal one"]
    for name, axis in (("Fitted (solid)", knee.fitted), ("Nominal (dashed)", knee.nominal)):
        if axis is not None:
            far = [
                f"{_format_with_error(1e3 * end.distance, 1e3 * end.standard_error)} mm"
                for end in axis.ends.values()
            ]
            angle = _format_with_error(math.degrees(axis.angle), math.degrees(axis.angle_error))
            places = f"{far[0]} from the medial centre, {far[1]} from the lateral one"
            lines.append(f"{name}: {_describe_path(axis)}, {places}, {angle}° off their line")
    # How far the bone's epicondyles miss their markers, and palpation's scatter in the two
    # directions across the axis.
    uncertainty = 1e3 * math.hypot(knee.misfit, math.sqrt(2.0) * PALPATION_M)
    uncertain = (
        f"Its position is uncertain by about {uncertainty:.0f} mm; the nominal axis is inside it "
        "by construction."
    )
    return [*lines, f"{_STANDS[knee.evidence]} {uncertain}"]


def _describe_path(axis: AxisInKnee) -> str:
    places = {
        name: "circle" if end.distance <= end.radius else "bone" if end.inside else "outside"
        for name, end in axis.ends.items()
    }
    if places["medial"] == places["lateral"]:
        return _PASSES[places["medial"]][0]
    return " and ".join(_PASSES[place][1].format(name) for name, place in places.items())


def _format_with_error(value: float, error: float) -> str:
    return f"{value:.0f}" if math.isnan(error) else f"{value:.0f} ± {error:.0f}"
