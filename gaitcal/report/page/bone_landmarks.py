"""Find landmarks on the surface of bones, and locate the same landmarks in a subject.

Bones are those of the right side in the axes of OpenSim's models: x forward, y up, z to the right,
m.

    ball (head of femur or humerus)   sphere through the surface around the most medial point of the
                                      upper end, its points chosen anew until they no longer change
    epicondyles                       the most lateral and the most medial point of the lower end
    condyles of the femur             circles in the sagittal plane through the hind and lower
                                      surface of each condyle, which the tibia rolls on: their
                                      centres are the geometric centre axis (Eckhoff et al. 2005, J
                                      Bone Joint Surg Am 87 Suppl 2)
    acetabulum                        the place towards which most of the surface of the hip bone is
                                      hollow: every triangle, carried along its outward normal by
                                      the radius of the femoral head, votes for it
    tibial plateau                    mean of the upper end's upward surface
    malleoli                          the most medial point of the tibia's, the most lateral of the
                                      fibula's lower end
    ASIS, PSIS                        the most forward point above the acetabulum, the hindmost of
                                      the hip bone

A sphere |p - c|^2 = r^2 is linear in (c, r^2 - c.c) and solved by least squares; so is a circle in
two coordinates.

The landmarks of a subject are those of the static trial and the joint centres, in segment frames.
The knee is given by the palpated epicondyles, not by the fitted axis: a bone placed this way shows
whether the fitted knee axis passes through its condyles. Hip centres cannot be palpated and are the
fitted ones. The centre of a marker is its radius away from the skin, and epicondyles, malleoli and
spines are corrected for it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import JointWidths
from gaitcal.model.subject_model import SubjectModel
from gaitcal.report.page.body_meshes import (
    Mesh,
    compute_upright_poses,
    compute_vertex_height,
    locate_wrist,
)

_END = 0.12  # Share of a bone's length that is its end
_UPPER_SHAFT, _LOWER_SHAFT = (0.6, 0.8), (0.25, 0.5)  # Shares of a bone's length, from below
_MALLEOLUS = 0.08  # Share of a bone's length in which its malleolus is
_ON_SURFACE = (
    0.0035  # Of a bone's length: how far a point may be from a sphere or circle that it belongs to
)
_ROUNDS = 30
_FEWEST_POINTS = 6  # Of a sphere or circle
_UPWARD, _SIDEWAYS = 0.8, 0.6  # Least upward and largest sideways part of a unit normal
_VOTES_TOGETHER = 0.010  # m: votes for one acetabulum
_PARTS = 5  # Parts of a triangle's side between points spread over it


class NoLandmark(ValueError):  # noqa: N818 - reads "no landmark"
    """A surface does not show a landmark of its bone."""


@dataclass(frozen=True)
class Ball:
    """A sphere, or in the sagittal plane a circle, fitted to a joint surface."""

    centre: Array  # (3,) m, in the frame of the bone
    radius: float  # m


@dataclass(frozen=True)
class LongBone:
    """Thigh or upper arm bone."""

    head: Ball
    lateral: Array  # (3,) m, lateral epicondyle
    medial: Array  # (3,) m, medial epicondyle

    @property
    def middle(self) -> Array:
        """(3,) m, midway between the epicondyles."""
        return 0.5 * (self.lateral + self.medial)


@dataclass(frozen=True)
class Condyles:
    """The two condyles of a femur."""

    medial: Ball
    lateral: Ball
    # m from the middle of the epicondyles down to the lowest points of the condyles, their mean
    drop: float

    @property
    def axis(self) -> Array:
        """(3,) from the medial centre to the lateral one."""
        return self.lateral.centre - self.medial.centre


@dataclass(frozen=True)
class HipBone:
    """The right half of a pelvis; every position (3,) m."""

    socket: Array
    asis: Array
    psis: Array


@dataclass(frozen=True)
class ShankBones:
    """Tibia and fibula, in one frame; every position (3,) m."""

    plateau: Array
    medial: Array  # Malleolus
    lateral: Array  # Malleolus


def compute_volume(mesh: Mesh) -> float:
    """Compute the volume, m^3; positive if corners are counter-clockwise seen from outside."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def _compute_face_normals(mesh: Mesh) -> tuple[Array, Array]:
    """Compute (nt, 3) outward normals, length = area (m^2), and (nt, 3) centroids (m)."""
    corners = mesh.vertices[mesh.triangles]
    outward = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return outward * (1.0 if compute_volume(mesh) > 0 else -1.0), corners.mean(axis=1)


def _compute_vertex_normals(mesh: Mesh) -> Array:
    """Compute (nv, 3) outward unit normals, averaged over adjacent triangles by area."""
    faces, _ = _compute_face_normals(mesh)
    sums = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(sums, mesh.triangles[:, k], faces)
    out: Array = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    return out


def _sample_surface(mesh: Mesh) -> tuple[Array, Array, Array]:
    """Sample a surface: points (n, 3), outward unit normals (n, 3), and the area (n,) of each.

    Large triangles get their weight in a fit, which their corners alone would not give.
    """
    outward, _ = _compute_face_normals(mesh)
    area = np.linalg.norm(outward, axis=1)
    places = [(i + 1 / 3, j + 1 / 3) for i in range(_PARTS) for j in range(_PARTS - i)]
    shares = np.array([(a / _PARTS, b / _PARTS, 1.0 - (a + b) / _PARTS) for a, b in places])
    points = np.einsum("pc,tcd->tpd", shares, mesh.vertices[mesh.triangles]).reshape(-1, 3)
    normals = np.repeat(outward / np.maximum(area, 1e-30)[:, None], len(shares), axis=0)
    return points, normals, np.repeat(area / len(shares), len(shares))


def fit_ball(points: Array, weights: Array | None = None) -> tuple[Array, float]:
    """Fit a sphere (in two dimensions a circle) to points (n, d): centre (d,) and radius, m."""
    root = np.ones(len(points)) if weights is None else np.sqrt(weights)
    rows = np.column_stack([2.0 * points, np.ones(len(points))]) * root[:, None]
    solution = np.linalg.lstsq(rows, np.sum(points**2, axis=1) * root, rcond=None)[0]
    centre = solution[:-1]
    return centre, float(np.sqrt(max(solution[-1] + centre @ centre, 0.0)))


def is_inside(mesh: Mesh, point: Array) -> bool:
    """Return whether a point (3,) m is inside a closed surface.

    The solid angles of all triangles, seen from the point, sum to 4 pi inside and to 0 outside (Van
    Oosterom and Strackee 1983, IEEE Trans Biomed Eng 30).
    """
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a))]
    angles = 2.0 * np.arctan2(triple, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return abs(float(angles.sum())) > 2.0 * np.pi


def _measure_length(vertices: Array) -> tuple[float, float]:
    return float(vertices[:, 1].min()), float(np.ptp(vertices[:, 1]))


def find_long_bone(mesh: Mesh) -> LongBone:
    """Find head and epicondyles of a femur or humerus."""
    v = mesh.vertices
    low, length = _measure_length(v)
    upper = v[:, 1] > low + (1.0 - _END) * length
    lower = v[v[:, 1] < low + _END * length]
    head = _find_head(v, _compute_vertex_normals(mesh), upper, length)
    return LongBone(head, lower[np.argmax(lower[:, 2])], lower[np.argmin(lower[:, 2])])


def _find_head(v: Array, normals: Array, upper: BoolArray, length: float) -> Ball:
    # The head is the most medial part of a right femur's upper end.
    seed = v[upper][np.argmin(v[upper][:, 2])]
    chosen = upper & (np.linalg.norm(v - seed, axis=1) < 0.06 * length)
    for _ in range(_ROUNDS):
        if chosen.sum() < _FEWEST_POINTS:
            raise NoLandmark("no round head")
        centre, radius = fit_ball(v[chosen])
        # Points whose normal leaves the ball and that are on its surface; the neck is left out.
        outwards = np.einsum("ij,ij->i", v - centre, normals) > 0.5 * radius
        following = (
            upper
            & outwards
            & (np.abs(np.linalg.norm(v - centre, axis=1) - radius) < _ON_SURFACE * length)
        )
        if np.array_equal(following, chosen):
            break
        chosen = following
    return Ball(centre, radius)


def find_condyles(mesh: Mesh) -> Condyles:
    """Find the condyles of a femur."""
    bone = find_long_bone(mesh)
    points, normals, area = _sample_surface(mesh)
    low, length = _measure_length(mesh.vertices)
    half = 0.5 * float(bone.lateral[2] - bone.medial[2])
    balls, lowest = [], []
    for side in (-1.0, 1.0):
        # From 0 in the middle to 1 at the epicondyle of this side.
        across = side * (points[:, 2] - bone.middle[2]) / half
        one = (
            (points[:, 1] < low + _END * length)
            & (np.abs(across - 0.55) < 0.35)
            & (np.abs(normals[:, 2]) < _SIDEWAYS)
        )
        if one.sum() < _FEWEST_POINTS:
            raise NoLandmark("no condyles")
        balls.append(_fit_condyle(points[one], normals[one], area[one], length))
        lowest.append(float(points[one][:, 1].min()))
    return Condyles(balls[0], balls[1], float(bone.middle[1]) - 0.5 * sum(lowest))


def _fit_condyle(points: Array, normals: Array, area: Array, length: float) -> Ball:
    """Fit a circle to the posterior and distal part of the surface (n, 3) of one condyle."""
    # Only the posterior part of a condyle is round in the sagittal plane.
    chosen = points[:, 0] < np.median(points[:, 0])
    for _ in range(_ROUNDS):
        if chosen.sum() < _FEWEST_POINTS:
            raise NoLandmark("no round condyle")
        centre, radius = fit_ball(points[chosen][:, :2], area[chosen])
        away = points[:, :2] - centre
        far = np.linalg.norm(away, axis=1)
        outwards = np.einsum("ij,ij->i", away, normals[:, :2]) > _UPWARD * far * np.linalg.norm(
            normals[:, :2], axis=1
        )
        following = (
            outwards & (np.abs(far - radius) < _ON_SURFACE * length) & (away[:, 0] < 0.5 * radius)
        )
        if np.array_equal(following, chosen):
            break
        chosen = following
    return Ball(np.array([*centre, np.average(points[chosen][:, 2], weights=area[chosen])]), radius)


def find_hip_bone(mesh: Mesh, head_radius: float) -> HipBone:
    """Find acetabulum and spines of the right half of a pelvis.

    `head_radius`: m, of the femoral head.
    """
    outward, middles = _compute_face_normals(mesh)
    area = np.linalg.norm(outward, axis=1)
    votes = middles + head_radius * outward / np.maximum(area, 1e-30)[:, None]
    near = np.linalg.norm(votes[:, None] - votes, axis=2) < _VOTES_TOGETHER
    best = near[np.argmax(near @ area)]
    socket = np.average(votes[best], axis=0, weights=area[best])
    v = mesh.vertices
    above = v[v[:, 1] > socket[1]]
    if len(above) < _FEWEST_POINTS:
        raise NoLandmark("no acetabulum")
    return HipBone(socket, above[np.argmax(above[:, 0])], v[np.argmin(v[:, 0])])


def find_shank_bones(tibia: Mesh, fibula: Mesh) -> ShankBones:
    """Find tibial plateau and malleoli."""
    v, normals = tibia.vertices, _compute_vertex_normals(tibia)
    low, length = _measure_length(v)
    plateau = v[(v[:, 1] > low + (1.0 - 0.5 * _END) * length) & (normals[:, 1] > _UPWARD)]
    if len(plateau) < _FEWEST_POINTS:
        raise NoLandmark("no tibial plateau")
    inner = v[v[:, 1] < low + _MALLEOLUS * length]
    f = fibula.vertices
    base, tall = _measure_length(f)
    outer = f[f[:, 1] < base + _MALLEOLUS * tall]
    return ShankBones(
        plateau.mean(axis=0), inner[np.argmin(inner[:, 2])], outer[np.argmax(outer[:, 2])]
    )


def check_directions(femur: Mesh, hip: HipBone, tibia: Mesh, fibula: Mesh) -> None:
    """Raise `NoLandmark` for a left or rotated bone.

    Proximally, a femur extends furthest from its shaft medially, by its head. Distally, its
    condyles extend further behind the shaft than in front of it. The fibula is lateral of the
    tibia, and not in front of it. The right half of a pelvis is right of the middle. Its PSIS is
    behind and above the acetabulum, and nearer to the middle than the ASIS.
    """
    upper, lower = (
        _measure_reach(femur, _UPPER_SHAFT, 1.0 - _END),
        _measure_reach(femur, _LOWER_SHAFT, _END),
    )
    if upper[0, 2] <= max(upper[1, 2], *upper[:, 0]):
        raise NoLandmark("no femoral head medial of the femur's shaft")
    if lower[0, 0] <= lower[1, 0]:
        raise NoLandmark("no condyles behind the femur's shaft")
    # On a right leg the fibula is lateral: z to the right.
    to_fibula = fibula.vertices.mean(axis=0) - tibia.vertices.mean(axis=0)
    if to_fibula[2] <= 0.25 * abs(to_fibula[0]) + 1e-3 or to_fibula[0] >= 0.5 * to_fibula[2]:
        raise NoLandmark("no fibula lateral of the tibia")
    # x forward, y up, z to the right, m, of the right hip bone.
    socket, asis, psis = hip.socket, hip.asis, hip.psis
    if min(socket[2], asis[2]) <= 0.0 or asis[0] <= socket[0] or asis[2] <= psis[2]:
        raise NoLandmark("no right ASIS in front of the acetabulum")
    if psis[0] >= socket[0] or psis[1] <= socket[1]:
        raise NoLandmark("no PSIS behind the acetabulum")


def _measure_reach(bone: Mesh, shaft: tuple[float, float], end: float) -> Array:
    """Measure the (2, 3) m extent of a bone end below and above its shaft's middle, by axis."""
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
    """Evidence for the position of the femur's epicondyles."""

    BOTH = "both epicondyles"  # Markers on both
    DEVICE = "lateral epicondyle and knee alignment device"
    """A marker on the lateral one, and a rod along the axis that a person chose."""
    # One marker: the bone's turn about its length is the pelvis's in the static trial
    LATERAL = "lateral epicondyle"
    NOMINAL = "nominal joint"  # No marker: the nominal knee places the bone


_SIDED = {
    "thigh": ("hip", "knee", "epicondyle_lat", "epicondyle_med"),
    "shank": ("knee", "ankle", "malleolus_lat", "malleolus_med"),
    "foot": ("ankle", "up", "heel_to_toe"),
    "upper_arm": ("shoulder", "elbow"),
    "forearm_hand": ("elbow", "wrist"),
}
_POINTS = (
    *(
        f"{part}_{side}/{name}"
        for part, names in _SIDED.items()
        for name in names
        for side in SIDES
    ),
    *(f"{place}_{side}" for place in ("pelvis/hip", "head_trunk/shoulder") for side in SIDES),
    *("pelvis/asis", "head_trunk/lumbar", "head_trunk/vertex"),
)
_SHAPES = dict.fromkeys(_POINTS, (3,)) | {f"talus_{side}/foot": (3, 4) for side in SIDES}
"""Every target that must be there; the PSIS alone may be unknown."""


@dataclass(frozen=True)
class PersonLandmarks:
    """Target positions of bone landmarks."""

    points: Mapping[str, Array]
    """`segment/landmark` -> (3,) m in the segment frame; `talus_r/foot` -> (3, 4), the foot's frame
    in the talus.
    """
    knees: Mapping[str, KneeEvidence]  # Side -> where its epicondyles are from

    def point(self, segment: str, landmark: str) -> Array:
        """Return a landmark, (3,) m."""
        return self.points[f"{segment}/{landmark}"]

    @property
    def complete(self) -> bool:
        """Whether all required landmarks exist, with the right shape and finite."""
        return set(self.knees) == set(SIDES) and all(
            name in self.points
            and self.points[name].shape == shape
            and bool(np.isfinite(self.points[name]).all())
            for name, shape in _SHAPES.items()
        )


def collect_person_landmarks(model: SubjectModel) -> PersonLandmarks:
    """Collect the target landmarks of a subject's bones."""
    fitted = model.parameters
    radius = JointWidths.from_subject(model.subject).marker_radius
    # m, in the axes of each segment; fitted joint centres, else landmarks of the static trial.
    lumbar = fitted.centre("back", "head_trunk")
    points = {f"pelvis/hip_{side}": fitted.centre(f"hip_{side}", "pelvis") for side in SIDES}
    points["pelvis/asis"] = np.array(
        [-radius, 0.0, 0.0]
    )  # mid-ASIS is the origin of the pelvis, x forward
    if (sacrum := _get_landmark(model, "sacrum", "pelvis")) is not None:
        points["pelvis/psis"] = sacrum + [radius, 0.0, 0.0]
    points |= {
        f"head_trunk/shoulder_{side}": fitted.centre(f"shoulder_{side}", "head_trunk")
        for side in SIDES
    }
    points["head_trunk/lumbar"] = lumbar
    points["head_trunk/vertex"] = lumbar + [0.0, compute_vertex_height(model), 0.0]
    knees = {}
    for side in SIDES:
        points[f"thigh_{side}/hip"] = fitted.centre(f"hip_{side}", f"thigh_{side}")
        thigh, knees[side] = _locate_knee(model, side)
        points |= thigh | _locate_ankle(model, side) | _locate_foot(model, side)
        points[f"upper_arm_{side}/shoulder"] = fitted.centre(
            f"shoulder_{side}", f"upper_arm_{side}"
        )
        points[f"upper_arm_{side}/elbow"] = fitted.centre(f"elbow_{side}", f"upper_arm_{side}")
        points[f"forearm_hand_{side}/elbow"] = fitted.centre(
            f"elbow_{side}", f"forearm_hand_{side}"
        )
        points[f"forearm_hand_{side}/wrist"] = locate_wrist(model, fitted, side)
    return PersonLandmarks(points, knees)


def _get_landmark(model: SubjectModel, landmark: str, segment: str) -> Array | None:
    found = model.landmarks.get(landmark)
    return found[1] if found is not None and found[0] == segment else None


def _locate_hinge(
    model: SubjectModel, segment: str, joint: str
) -> tuple[Array | None, Array, bool]:
    """Locate a hinge (`knee`, `ankle`) in an adjacent segment.

    Returns the (3,) m middle (None without markers), the (3,) m half width to the lateral end, and
    whether both markers exist.
    """
    side, widths = segment[-1], JointWidths.from_subject(model.subject)
    lateral, medial = (
        _get_landmark(model, f"{joint}_{end}_{side}", segment) for end in ("lat", "med")
    )
    middle = _get_landmark(model, f"{joint[0]}jc_{side}", segment)
    outwards = np.array([0.0, 0.0, 1.0 if side == "r" else -1.0])
    half, both = (
        widths.compute_inset(joint, side) - widths.marker_radius,
        lateral is not None and medial is not None,
    )
    if lateral is not None and medial is not None:
        middle, outwards = 0.5 * (lateral + medial), lateral - medial
        if not widths.is_measured(joint, side):
            half = 0.5 * float(np.linalg.norm(outwards)) - widths.marker_radius
    elif lateral is not None and middle is not None:
        outwards = lateral - middle
    return middle, half * (outwards / np.linalg.norm(outwards)), both


def _locate_knee(model: SubjectModel, side: str) -> tuple[dict[str, Array], KneeEvidence]:
    segment = f"thigh_{side}"
    middle, half, both = _locate_hinge(model, segment, "knee")
    device = f"knee_axis_{side}" in model.landmarks
    evidence = (
        KneeEvidence.BOTH if both else KneeEvidence.DEVICE if device else KneeEvidence.LATERAL
    )
    if middle is None or _get_landmark(model, f"knee_lat_{side}", segment) is None:
        evidence, middle = (
            KneeEvidence.NOMINAL,
            model.nominal.centre(f"knee_{side}", f"thigh_{side}"),
        )
    points = {"knee": middle, "epicondyle_lat": middle + half, "epicondyle_med": middle - half}
    return {f"{segment}/{name}": point for name, point in points.items()}, evidence


def _locate_ankle(model: SubjectModel, side: str) -> dict[str, Array]:
    """Locate knee and ankle; the shank's origin is the middle of the knee in the static trial."""
    middle, half, _ = _locate_hinge(model, f"shank_{side}", "ankle")
    middle = (
        model.nominal.centre(f"talocrural_{side}", f"shank_{side}") if middle is None else middle
    )
    points = {
        "knee": np.zeros(3),
        "ankle": middle,
        "malleolus_lat": middle + half,
        "malleolus_med": middle - half,
    }
    return {f"shank_{side}/{name}": point for name, point in points.items()}


def _locate_foot(model: SubjectModel, side: str) -> dict[str, Array]:
    """Locate ankle centre, upward direction and heel-toe line (x) at zero nominal coordinates."""
    foot, talus = f"foot_{side}", f"talus_{side}"
    axes, origins = compute_upright_poses(model.nominal)
    into_foot, in_talus = axes[foot], axes[talus]
    toe, heel = (_get_landmark(model, f"{name}_{side}", foot) for name in ("toe", "heel"))
    return {
        f"{foot}/ankle": into_foot @ (origins[talus] - origins[foot]),
        f"{foot}/up": into_foot[:, 1].copy(),
        f"{foot}/heel_to_toe": np.zeros(3) if toe is None or heel is None else toe - heel,
        f"{talus}/foot": np.column_stack(
            [in_talus @ into_foot.T, in_talus @ (origins[foot] - origins[talus])]
        ),
    }
