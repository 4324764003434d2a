"""Points that move together as one rigid body: its motion in every frame, and what it carries."""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array


def rigid_motions(points: Array, paths: Array) -> tuple[Array, Array]:
    """R (nf, 3, 3) and o (nf, 3) of the rigid motions of points (n, 3) nearest to paths (nf, n, 3), Kabsch 1976."""
    middle, middles = points.mean(axis=0), paths.mean(axis=1)
    spread = np.einsum("fni,nj->fij", paths - middles[:, None], points - middle)
    u, _, vt = np.linalg.svd(spread)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    return rotation, middles - rotation @ middle


def off_line(points: Array) -> float:
    """m, RMS distance of points (n, 3) from the line that is nearest to them."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(np.sqrt((sizes[1:] ** 2).sum() / len(points)))


def left_share(count: int) -> float:
    """Share of the variance of points that a rigid fit to them leaves: it hides six of their directions."""
    return (3.0 * count - 6.0) / (3.0 * count)


def lever(points: Array, place: Array) -> float:
    """1/n + trace([r] I^-1 [r]^T) / 3: variance of a place (3,) for one of every point (n, 3) that carries it."""
    away, r = points - points.mean(axis=0), place - points.mean(axis=0)
    inertia = np.eye(3) * (away**2).sum() - away.T @ away
    cross = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    return 1.0 / len(points) + float(np.trace(cross @ np.linalg.pinv(inertia) @ cross.T)) / 3.0


def carried(place: Array, points: Array, paths: Array) -> Array:
    """(nf, 3) path of a place (3,) fixed to points (n, 3) with paths (nf, n, 3); NaN where one of them is not seen."""
    path = np.full((len(paths), 3), np.nan)
    seen = np.isfinite(paths).all(axis=(1, 2))
    rotation, origin = rigid_motions(points, paths[seen])
    path[seen] = rotation @ place + origin
    return path
