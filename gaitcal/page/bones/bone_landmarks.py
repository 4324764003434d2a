"""Where the landmarks of a bone lie, found on its own surface.

Bones are those of the right side in the axes of OpenSim's models: x forward, y up, z to the right, m.

    ball (head of femur or humerus)   sphere through the surface around the most medial point of the upper end, its
                                      points chosen anew until they no longer change
    epicondyles                       the most lateral and the most medial point of the lower end
    condyles of the femur             circles in the sagittal plane through the hind and lower surface of each condyle,
                                      which the tibia rolls on: their centres are the geometric centre axis (Eckhoff et
                                      al. 2005, J Bone Joint Surg Am 87 Suppl 2)
    acetabulum                        the place towards which most of the surface of the hip bone is hollow: every
                                      triangle, carried along its outward normal by the radius of the femoral head,
                                      votes for it
    tibial plateau                    mean of the upper end's upward surface
    malleoli                          the most medial point of the tibia's, the most lateral of the fibula's lower end
    ASIS, PSIS                        the most forward point above the acetabulum, the hindmost of the hip bone

Whether bones are right ones with x forward, y up, z to the right, by their own shape.

A left bone, or one that is turned, has surfaces like a right one, and landmarks are found on it: elsewhere. What tells
them apart is where the parts of a bone lie to each other:

    femur     above, it reaches furthest from the shaft medially, by its head;
              below, the condyles reach further behind the shaft than before it
    shank     the fibula is lateral of the tibia, and not before it
    pelvis    right of the middle; the PSIS behind the acetabulum, above it, and nearer to the middle than the ASIS

Where a person's bones must lie: landmarks of the static trial and joint centres, in the segment frames.

Nothing here is taken from a fitted axis. The knee is the middle between the epicondyles and the line through them, as
palpated; so a bone that stands on these landmarks shows whether the fitted knee axis passes through its condyles. Had
the bone been laid on the fitted axis, it would pass through them whatever the fit is. Hip centres, which nobody can
palpate, are the fitted ones: there the bones follow the fit and say nothing about it.

A marker's centre lies its radius off the skin; epicondyles, malleoli and spines are taken that much nearer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.chain import Chain, forward, segment_poses
from gaitcal.model.linkage import COORDINATES, SEGMENTS, SIDES
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.segment_frames import JointWidths
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.body_meshes import Mesh, vertex_above_lumbar, wrist
from gaitcal.page.bones.bone_files import face_normals, fitted_ball, spread_points, vertex_normals

MEDIAL = np.array([1.0, 1.0, -1.0])
"""Mirrors a bone of the right side to the left."""
_END = 0.12
"""Share of a bone's length that is its end."""
_ON_SURFACE = 0.0035
"""Of a bone's length: how far a point may be from a sphere or circle that it belongs to."""
_ROUNDS = 30
_FEWEST = 6
"""Points below which no sphere or circle is believed."""
_MALLEOLUS, _UPWARD, _SIDEWAYS = 0.08, 0.8, 0.6
_VOTES_TOGETHER = 0.010
"""m: votes for one acetabulum."""


class NoLandmark(ValueError):  # noqa: N818 - said as it is read: "no landmark"
    """A surface is not the bone it should be."""


@dataclass(frozen=True)
class Ball:
    """A sphere, or in the sagittal plane a circle, fitted to a joint surface."""

    centre: Array
    """(3,) m, in the bone's own frame."""
    radius: float
    """m."""


@dataclass(frozen=True)
class LongBone:
    """Thigh or upper arm bone."""

    head: Ball
    lateral: Array
    """(3,) m, lateral epicondyle."""
    medial: Array
    """(3,) m, medial epicondyle."""

    @property
    def middle(self) -> Array:
        """(3,) m, midway between the epicondyles."""
        return 0.5 * (self.lateral + self.medial)


@dataclass(frozen=True)
class Condyles:
    """The two condyles of a femur."""

    medial: Ball
    lateral: Ball
    drop: float
    """m from the middle of the epicondyles down to the lowest points of the condyles, their mean."""

    @property
    def axis(self) -> Array:
        """(3,) from the medial centre to the lateral one."""
        return self.lateral.centre - self.medial.centre


@dataclass(frozen=True)
class HipBone:
    """The right half of a pelvis."""

    socket: Array
    """(3,) m, centre of the acetabulum."""
    asis: Array
    """(3,) m."""
    psis: Array
    """(3,) m."""


@dataclass(frozen=True)
class ShankBones:
    """Tibia and fibula, in one frame."""

    plateau: Array
    """(3,) m."""
    medial: Array
    """(3,) m, medial malleolus."""
    lateral: Array
    """(3,) m, lateral malleolus."""


def long_bone(mesh: Mesh) -> LongBone:
    """Head and epicondyles of a femur or humerus."""
    v = mesh.vertices
    low, length = _low_and_length(v)
    upper = v[:, 1] > low + (1.0 - _END) * length
    lower = v[v[:, 1] < low + _END * length]
    return LongBone(
        _head(v, vertex_normals(mesh), upper, length), lower[np.argmax(lower[:, 2])], lower[np.argmin(lower[:, 2])]
    )


def _head(v: Array, normals: Array, upper: BoolArray, length: float) -> Ball:
    seed = v[upper][np.argmin(v[upper][:, 2])]
    chosen = upper & (np.linalg.norm(v - seed, axis=1) < 0.06 * length)
    for _ in range(_ROUNDS):
        if chosen.sum() < _FEWEST:
            raise NoLandmark("no round head")
        centre, radius = fitted_ball(v[chosen])
        outwards = np.einsum("ij,ij->i", v - centre, normals) > 0.5 * radius
        following = upper & outwards & (np.abs(np.linalg.norm(v - centre, axis=1) - radius) < _ON_SURFACE * length)
        if np.array_equal(following, chosen):
            break
        chosen = following
    return Ball(centre, radius)


def condyles(mesh: Mesh) -> Condyles:
    """The condyles of a femur."""
    bone = long_bone(mesh)
    points, normals, area = spread_points(mesh)
    low, length = _low_and_length(mesh.vertices)
    half = 0.5 * float(bone.lateral[2] - bone.medial[2])
    balls, lowest = [], []
    for side in (-1.0, 1.0):
        across = side * (points[:, 2] - bone.middle[2]) / half
        one = (
            (points[:, 1] < low + _END * length) & (np.abs(across - 0.55) < 0.35) & (np.abs(normals[:, 2]) < _SIDEWAYS)
        )
        if one.sum() < _FEWEST:
            raise NoLandmark("no condyles")
        balls.append(_condyle(points[one], normals[one], area[one], length))
        lowest.append(float(points[one][:, 1].min()))
    return Condyles(balls[0], balls[1], float(bone.middle[1]) - 0.5 * sum(lowest))


def _condyle(points: Array, normals: Array, area: Array, length: float) -> Ball:
    """(n, 3) surface of one condyle, without its sides -> circle through its hind and lower part."""
    chosen = points[:, 0] < np.median(points[:, 0])
    for _ in range(_ROUNDS):
        if chosen.sum() < _FEWEST:
            raise NoLandmark("no round condyle")
        centre, radius = fitted_ball(points[chosen][:, :2], area[chosen])
        away = points[:, :2] - centre
        far = np.linalg.norm(away, axis=1)
        outwards = np.einsum("ij,ij->i", away, normals[:, :2]) > _UPWARD * far * np.linalg.norm(normals[:, :2], axis=1)
        following = outwards & (np.abs(far - radius) < _ON_SURFACE * length) & (away[:, 0] < 0.5 * radius)
        if np.array_equal(following, chosen):
            break
        chosen = following
    return Ball(np.array([*centre, np.average(points[chosen][:, 2], weights=area[chosen])]), radius)


def hip_bone(mesh: Mesh, head_radius: float) -> HipBone:
    """Acetabulum and spines of the right half of a pelvis; `head_radius` (m) of the femur that belongs to it."""
    outward, middles = face_normals(mesh)
    area = np.linalg.norm(outward, axis=1)
    votes = middles + head_radius * outward / np.maximum(area, 1e-30)[:, None]
    near = np.linalg.norm(votes[:, None] - votes, axis=2) < _VOTES_TOGETHER
    best = near[np.argmax(near @ area)]
    socket = np.average(votes[best], axis=0, weights=area[best])
    v = mesh.vertices
    above = v[v[:, 1] > socket[1]]
    if len(above) < _FEWEST:
        raise NoLandmark("no acetabulum")
    return HipBone(socket, above[np.argmax(above[:, 0])], v[np.argmin(v[:, 0])])


def shank_bones(tibia: Mesh, fibula: Mesh) -> ShankBones:
    """Plateau and malleoli."""
    v, normals = tibia.vertices, vertex_normals(tibia)
    low, length = _low_and_length(v)
    plateau = v[(v[:, 1] > low + (1.0 - 0.5 * _END) * length) & (normals[:, 1] > _UPWARD)]
    if len(plateau) < _FEWEST:
        raise NoLandmark("no tibial plateau")
    inner = v[v[:, 1] < low + _MALLEOLUS * length]
    f = fibula.vertices
    base, tall = _low_and_length(f)
    outer = f[f[:, 1] < base + _MALLEOLUS * tall]
    return ShankBones(plateau.mean(axis=0), inner[np.argmin(inner[:, 2])], outer[np.argmax(outer[:, 2])])


def _low_and_length(vertices: Array) -> tuple[float, float]:
    return float(vertices[:, 1].min()), float(np.ptp(vertices[:, 1]))


_UPPER_SHAFT, _LOWER_SHAFT = (0.6, 0.8), (0.25, 0.5)
_CUT_END = 0.12
"""Shares of a bone's length, from below; `_END` of either end."""


def check_directions(femur: Mesh, hip: HipBone, tibia: Mesh, fibula: Mesh) -> None:
    """Raise `NoLandmark` for a bone that is a left one, or turned."""
    upper, lower = _reach(femur, _UPPER_SHAFT, 1.0 - _CUT_END), _reach(femur, _LOWER_SHAFT, _CUT_END)
    if upper[0, 2] <= max(upper[1, 2], *upper[:, 0]):
        raise NoLandmark("no femoral head medial of the femur's shaft")
    if lower[0, 0] <= lower[1, 0]:
        raise NoLandmark("no condyles behind the femur's shaft")
    beside = fibula.vertices.mean(axis=0) - tibia.vertices.mean(axis=0)
    if beside[2] <= 0.25 * abs(beside[0]) + 1e-3 or beside[0] >= 0.5 * beside[2]:
        raise NoLandmark("no fibula lateral of the tibia")
    socket, asis, psis = hip.socket, hip.asis, hip.psis
    if min(socket[2], asis[2]) <= 0.0 or asis[0] <= socket[0] or asis[2] <= psis[2]:
        raise NoLandmark("no right ASIS in front of the acetabulum")
    if psis[0] >= socket[0] or psis[1] <= socket[1]:
        raise NoLandmark("no PSIS behind the acetabulum")


def _reach(bone: Mesh, shaft: tuple[float, float], end: float) -> Array:
    """(2, 3) m by which the end of a bone reaches below and above its shaft's middle along each axis."""
    v = bone.vertices
    share = (v[:, 1] - v[:, 1].min()) / np.ptp(v[:, 1])
    between = (share > shaft[0]) & (share < shaft[1])
    part = v[share > end] if end > shaft[1] else v[share < end]
    if not between.any():
        raise NoLandmark("no shaft")
    middle = 0.5 * (v[between].min(axis=0) + v[between].max(axis=0))
    out: Array = np.array([middle - part.min(axis=0), part.max(axis=0) - middle])
    return out


class KneeEvidence(Enum):
    """What tells where the femur's epicondyles are."""

    BOTH = "both epicondyles"
    """Markers on both."""
    DEVICE = "lateral epicondyle and knee alignment device"
    """A marker on the lateral one, and a rod along the axis that a person chose."""
    LATERAL = "lateral epicondyle"
    """One marker: the bone's turn about its length is the pelvis's in the static trial."""
    NOMINAL = "nominal joint"
    """No marker: the bone stands on the nominal knee."""


@dataclass(frozen=True)
class PersonLandmarks:
    """Targets of the bones' landmarks."""

    points: Mapping[str, Array]
    """`segment/landmark` -> (3,) m in the segment frame; `talus_r/foot` -> (3, 4), the foot's frame in the talus."""
    knees: Mapping[str, KneeEvidence]
    """Side -> where its epicondyles are from."""

    def point(self, segment: str, landmark: str) -> Array:
        """(3,) m."""
        return self.points[f"{segment}/{landmark}"]

    @property
    def complete(self) -> bool:
        """Whether all is there that bones need, of the right size and finite."""
        return set(self.knees) == set(SIDES) and all(
            name in self.points and self.points[name].shape == shape and bool(np.isfinite(self.points[name]).all())
            for name, shape in _shapes().items()
        )


def _shapes() -> dict[str, tuple[int, ...]]:
    """Every target that must be there, and its shape; the PSIS alone may be unknown."""
    sided = {
        "thigh": ("hip", "knee", "epicondyle_lat", "epicondyle_med"),
        "shank": ("knee", "ankle", "malleolus_lat", "malleolus_med"),
        "foot": ("ankle", "up", "heel_to_toe"),
        "upper_arm": ("shoulder", "elbow"),
        "forearm_hand": ("elbow", "wrist"),
    }
    single = [f"{part}_{side}/{name}" for part, names in sided.items() for name in names for side in SIDES]
    single += ["pelvis/asis", "head_trunk/lumbar", "head_trunk/vertex"]
    single += [f"{place}_{side}" for place in ("pelvis/hip", "head_trunk/shoulder") for side in SIDES]
    return dict.fromkeys(single, (3,)) | {f"talus_{side}/foot": (3, 4) for side in SIDES}


def person_landmarks(model: SubjectModel) -> PersonLandmarks:
    """The targets of a person's bones."""
    fitted = dict(zip(JP_INDEX, model.parameters.joint, strict=True))
    radius = JointWidths.of(model.subject).marker_radius
    points = _pelvis(model, fitted, radius) | _trunk(model, fitted)
    knees = {}
    for side in SIDES:
        thigh, knees[side] = _thigh(model, fitted, side)
        points |= thigh | _shank(model, side) | _foot(model, side) | _arm(model, fitted, side)
    return PersonLandmarks(points, knees)


def _joint(jp: Mapping[str, float], place: str) -> Array:
    """(3,) m of a joint centre in one of its segments; what is no parameter is zero by definition of the frames."""
    return np.array([jp.get(f"{place}.{axis}", 0.0) for axis in ("ant", "sup", "lat")])


def _nominal(model: SubjectModel, place: str) -> Array:
    return _joint(dict(zip(JP_INDEX, model.nominal.joint, strict=True)), place)


def _known(model: SubjectModel, landmark: str, segment: str) -> Array | None:
    found = model.landmarks.get(landmark)
    return found[1] if found is not None and found[0] == segment else None


def _pelvis(model: SubjectModel, jp: Mapping[str, float], radius: float) -> dict[str, Array]:
    """Mid-ASIS is the origin of the pelvis, x forward; without markers there the nominal subject's depth."""
    hips = {f"pelvis/hip_{side}": _joint(jp, f"hip_{side}.pelvis") for side in SIDES}
    out = {**hips, "pelvis/asis": np.array([-radius, 0.0, 0.0])}
    sacrum = _known(model, "sacrum", "pelvis")
    if sacrum is not None:
        out["pelvis/psis"] = sacrum + [radius, 0.0, 0.0]
    return out


def _thigh(model: SubjectModel, jp: Mapping[str, float], side: str) -> tuple[dict[str, Array], KneeEvidence]:
    segment = f"thigh_{side}"
    hip = _joint(jp, f"hip_{side}.thigh")
    lateral = _known(model, f"knee_lat_{side}", segment)
    medial = _known(model, f"knee_med_{side}", segment)
    middle = _known(model, f"kjc_{side}", segment)
    outwards = np.array([0.0, 0.0, 1.0 if side == "r" else -1.0])
    widths = JointWidths.of(model.subject)
    half = widths.inwards("knee", side) - widths.marker_radius
    if lateral is not None and medial is not None:
        evidence, middle = KneeEvidence.BOTH, 0.5 * (lateral + medial)
        outwards = lateral - medial
        if not widths.is_measured("knee", side):
            half = 0.5 * float(np.linalg.norm(outwards)) - widths.marker_radius
    elif lateral is not None and middle is not None:
        device = f"knee_axis_{side}" in model.landmarks
        evidence, outwards = KneeEvidence.DEVICE if device else KneeEvidence.LATERAL, lateral - middle
    else:
        evidence, middle = KneeEvidence.NOMINAL, _nominal(model, f"knee_{side}.thigh")
    outwards = outwards / np.linalg.norm(outwards)
    points = {"hip": hip, "knee": middle, "epicondyle_lat": middle + half * outwards}
    points["epicondyle_med"] = middle - half * outwards
    return {f"{segment}/{name}": point for name, point in points.items()}, evidence


def _shank(model: SubjectModel, side: str) -> dict[str, Array]:
    """Its origin is the middle of the knee in the static trial."""
    segment = f"shank_{side}"
    widths = JointWidths.of(model.subject)
    lateral = _known(model, f"ankle_lat_{side}", segment)
    medial = _known(model, f"ankle_med_{side}", segment)
    half = widths.inwards("ankle", side) - widths.marker_radius
    middle = _known(model, f"ajc_{side}", segment)
    outwards = np.array([0.0, 0.0, 1.0 if side == "r" else -1.0])
    if lateral is not None and medial is not None:
        middle, outwards = 0.5 * (lateral + medial), lateral - medial
        if not widths.is_measured("ankle", side):
            half = 0.5 * float(np.linalg.norm(outwards)) - widths.marker_radius
    elif lateral is not None and middle is not None:
        outwards = lateral - middle
    if middle is None:
        middle = _nominal(model, f"talocrural_{side}.shank")
    outwards = outwards / np.linalg.norm(outwards)
    return {
        f"{segment}/knee": np.zeros(3),
        f"{segment}/ankle": middle,
        f"{segment}/malleolus_lat": middle + half * outwards,
        f"{segment}/malleolus_med": middle - half * outwards,
    }


def _foot(model: SubjectModel, side: str) -> dict[str, Array]:
    """Ankle centre, upward direction and the line of heel and toe (x) at zero nominal coordinates."""
    foot, talus = f"foot_{side}", f"talus_{side}"
    axes, origins = _upright(model.nominal)
    into_foot, in_talus = axes[foot], axes[talus]
    ankle = into_foot @ (origins[talus] - origins[foot])
    rotation = in_talus @ into_foot.T
    toe, heel = (_known(model, f"{name}_{side}", foot) for name in ("toe", "heel"))
    length = np.zeros(3) if toe is None or heel is None else toe - heel
    return {
        f"{foot}/ankle": ankle,
        f"{foot}/up": into_foot[:, 1].copy(),
        f"{foot}/heel_to_toe": length,
        f"{talus}/foot": np.column_stack([rotation, in_talus @ (origins[foot] - origins[talus])]),
    }


def _upright(parameters: Parameters) -> tuple[dict[str, Array], dict[str, Array]]:
    """Segment -> (3, 3) rotation from laboratory to segment, (3,) m origin; all coordinates zero."""
    chain = Chain("pelvis", SEGMENTS)
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, np.zeros((1, len(COORDINATES)))))
    index = {segment: i for i, segment in enumerate(chain.segments)}
    return {s: axes[i, :, :, 0] for s, i in index.items()}, {s: origins[i, :, 0] for s, i in index.items()}


def _trunk(model: SubjectModel, jp: dict[str, float]) -> dict[str, Array]:
    lumbar = _joint(jp, "back.trunk")
    out = {f"head_trunk/shoulder_{side}": _joint(jp, f"shoulder_{side}.trunk") for side in SIDES}
    rise = np.array([0.0, vertex_above_lumbar(jp, model.subject.height), 0.0])
    return {**out, "head_trunk/lumbar": lumbar, "head_trunk/vertex": lumbar + rise}


def _arm(model: SubjectModel, jp: dict[str, float], side: str) -> dict[str, Array]:
    upper, fore = f"upper_arm_{side}", f"forearm_hand_{side}"
    return {
        f"{upper}/shoulder": _joint(jp, f"shoulder_{side}.upperarm"),
        f"{upper}/elbow": _joint(jp, f"elbow_{side}.upperarm"),
        f"{fore}/elbow": _joint(jp, f"elbow_{side}.forearm"),
        f"{fore}/wrist": wrist(model, jp, side),
    }
