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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.page.body_meshes import Mesh
from gaitcal.page.bones.bone_shape import face_normals, fitted_ball, spread_points, vertex_normals

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
