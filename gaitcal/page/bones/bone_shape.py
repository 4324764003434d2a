"""Measuring a bone's surface: outward normals, spheres, circles, and the same shape with fewer triangles.

A sphere |p - c|^2 = r^2 is linear in (c, r^2 - c.c) and solved by least squares; so is a circle in two coordinates.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array, IntArray
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
        group = _grouped(mesh, cell)
        triangles, keys = _kept(mesh, group)
        ordered = np.sort(keys)
        if int((ordered[1:] != ordered[:-1]).sum()) + len(keys[:1]) <= most:
            return _clustered(mesh, group, triangles, keys)
        cell *= _COARSER


def _grouped(mesh: Mesh, cell: float) -> IntArray:
    """The cell that each corner lies in, as its number among those that hold some."""
    x, y, z = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64).T
    _, group = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_inverse=True)
    return group.reshape(-1)


def _kept(mesh: Mesh, group: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles (n, 3) between three cells, and (n,) a number that only those between the same three share."""
    a, b, c = group[mesh.triangles.T]
    kept = (a != b) & (b != c) & (c != a)
    a, b, c = (corner[kept] for corner in (a, b, c))
    i, k = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    size = group.max() + 1
    return np.stack([a, b, c], axis=1), (i * size + (a + b + c - i - k)) * size + k


def _clustered(mesh: Mesh, group: IntArray, triangles: IntArray, keys: IntArray) -> Mesh:
    """The mean corners of the cells. The same three twice are one triangle, or two that lie on each other."""
    count = np.bincount(group)
    means = np.column_stack([np.bincount(group, mesh.vertices[:, k]) / count for k in range(3)])
    _, first = np.unique(keys, return_index=True)
    triangles = triangles[np.sort(first)]
    used, place = np.unique(triangles, return_inverse=True)
    return Mesh(means[used], place.reshape(-1, 3))
