"""Measuring a bone's surface: outward normals, spheres, circles, and the same shape with fewer triangles.

A sphere |p - c|^2 = r^2 is linear in (c, r^2 - c.c) and solved by least squares; so is a circle in two coordinates.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.page.body_meshes import Mesh

_COARSER = 1.2
_PARTS = 5
"""Parts of a triangle's side between points spread over it."""


def volume(mesh: Mesh) -> float:
    """m^3, positive where the corners of the triangles go round counter-clockwise seen from outside."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def vertex_normals(mesh: Mesh) -> Array:
    """(nv, 3) outward unit vectors, the triangles around weighted by their area."""
    faces, _ = face_normals(mesh)
    sums = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(sums, mesh.triangles[:, k], faces)
    out: Array = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    return out


def face_normals(mesh: Mesh) -> tuple[Array, Array]:
    """(nt, 3) outward normals as long as the area (m^2), and (nt, 3) the triangles' middles, m."""
    corners = mesh.vertices[mesh.triangles]
    outward = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return outward * (1.0 if volume(mesh) > 0 else -1.0), corners.mean(axis=1)


def spread_points(mesh: Mesh) -> tuple[Array, Array, Array]:
    """Points (n, 3) spread over the whole surface, outward unit normals (n, 3) and the area (n,) each stands for.

    A few large triangles weigh as they should in a fit to these, which they do not by their corners alone.
    """
    outward, _ = face_normals(mesh)
    area = np.linalg.norm(outward, axis=1)
    places = [(i + 1 / 3, j + 1 / 3) for i in range(_PARTS) for j in range(_PARTS - i)]
    shares = np.array([(a / _PARTS, b / _PARTS, 1.0 - (a + b) / _PARTS) for a, b in places])
    points = np.einsum("pc,tcd->tpd", shares, mesh.vertices[mesh.triangles]).reshape(-1, 3)
    normals = np.repeat(outward / np.maximum(area, 1e-30)[:, None], len(shares), axis=0)
    return points, normals, np.repeat(area / len(shares), len(shares))


def fitted_ball(points: Array, weights: Array | None = None) -> tuple[Array, float]:
    """Centre (d,) and radius (m) of the sphere, or in two dimensions the circle, nearest to points (n, d)."""
    root = np.ones(len(points)) if weights is None else np.sqrt(weights)
    rows = np.column_stack([2.0 * points, np.ones(len(points))]) * root[:, None]
    solution = np.linalg.lstsq(rows, np.sum(points**2, axis=1) * root, rcond=None)[0]
    centre = solution[:-1]
    return centre, float(np.sqrt(max(solution[-1] + centre @ centre, 0.0)))


def is_inside(mesh: Mesh, point: Array) -> bool:
    """Whether a point (3,) m lies inside a closed surface.

    The solid angles of all triangles, seen from the point, add up to 4 pi inside and to 0 outside (Van Oosterom and
    Strackee 1983, IEEE Trans Biomed Eng 30).
    """
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a))]
    angles = 2.0 * np.arctan2(triple, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return abs(float(angles.sum())) > 2.0 * np.pi


def with_fewer_triangles(mesh: Mesh, most: int) -> Mesh:
    """The shape with at most so many triangles: corners that share a cell of a grid become their mean.

    A mesh that has no more is returned as it is.
    """
    if len(mesh.triangles) <= most:
        return mesh
    corners = mesh.vertices[mesh.triangles]
    cell = 0.5 * float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
    while True:
        simple = _clustered(mesh, cell)
        if len(simple.triangles) <= most:
            return simple
        cell *= _COARSER


def _clustered(mesh: Mesh, cell: float) -> Mesh:
    x, y, z = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64).T
    _, group = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    means = np.column_stack([np.bincount(group, mesh.vertices[:, k]) / count for k in range(3)])
    triangles = group[mesh.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    # The same three corners twice are one triangle, or two that lie on each other.
    i, j, k = np.sort(triangles, axis=1).astype(np.int64).T
    _, first = np.unique((i * (group.max() + 1) + j) * (group.max() + 1) + k, return_index=True)
    triangles = triangles[np.sort(first)]
    used, place = np.unique(triangles, return_inverse=True)
    return Mesh(means[used], place.reshape(-1, 3))
