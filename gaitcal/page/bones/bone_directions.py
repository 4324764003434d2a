"""Whether bones are right ones with x forward, y up, z to the right, by their own shape.

A left bone, or one that is turned, has surfaces like a right one, and landmarks are found on it: elsewhere. What tells
them apart is where the parts of a bone lie to each other:

    femur     above, it reaches furthest from the shaft medially, by its head;
              below, the condyles reach further behind the shaft than before it
    shank     the fibula is lateral of the tibia, and not before it
    pelvis    right of the middle; the PSIS behind the acetabulum, above it, and nearer to the middle than the ASIS
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.page.body_meshes import Mesh
from gaitcal.page.bones.bone_landmarks import HipBone, NoLandmark

_UPPER_SHAFT, _LOWER_SHAFT = (0.6, 0.8), (0.25, 0.5)
_END = 0.12
"""Shares of a bone's length, from below; `_END` of either end."""


def check_directions(femur: Mesh, hip: HipBone, tibia: Mesh, fibula: Mesh) -> None:
    """Raise `NoLandmark` for a bone that is a left one, or turned."""
    upper, lower = _reach(femur, _UPPER_SHAFT, 1.0 - _END), _reach(femur, _LOWER_SHAFT, _END)
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
