"""Rigid motions, and the axes that they turn about.

Markers l_m of a body at rest and x_m moved: the rotation R that maximises trace(R^T sum (x_m - x)(l_m - l)^T) is
U diag(1, 1, det U V^T) V^T of its singular value decomposition (Kabsch 1976), and p = x - R l.

Screw. A turn (R, p) leaves the line {c + s n} in place but for a slide along it: R n = n, (1 - R) c = p across n. With
the small residue of rounding, c is the least-norm solution by the pseudo-inverse, the nearest point to the origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array


@dataclass(frozen=True)
class Line:
    """An axis in space."""

    point: Array
    """(3,) m, one of its points."""
    direction: Array
    """(3,) unit vector."""

    def moved(self, rotation: Array, origin: Array) -> Line:
        """The same line after a rigid motion (3, 3), (3,)."""
        return Line(rotation @ self.point + origin, rotation @ self.direction)

    def distance(self, point: Array) -> float:
        """Distance (m) of a point from the line."""
        return float(np.linalg.norm(across(point - self.point, self.direction)))

    def angle(self, direction: Array) -> float:
        """Angle (deg, 0 to 90) to a direction, whichever way either of them points."""
        turn = np.linalg.norm(np.cross(self.direction, direction))
        return float(np.rad2deg(np.arctan2(turn, abs(self.direction @ direction))))


def across(vectors: Array, direction: Array) -> Array:
    """The part of vectors (..., 3) at right angles to unit vectors (..., 3)."""
    out: Array = vectors - (vectors * direction).sum(axis=-1, keepdims=True) * direction
    return out


def rigid_motion(local: Array, measured: Array) -> tuple[Array, Array]:
    """Rotations (nf, 3, 3) and origins (nf, 3) that carry points (nm, 3) nearest to measured ones (nf, nm, 3)."""
    l_mean, x_mean = local.mean(axis=0), measured.mean(axis=1)
    u, _, vt = np.linalg.svd(np.einsum("fmi,mj->fij", measured - x_mean[:, None], local - l_mean))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation: Array = u @ vt
    return rotation, x_mean - rotation @ l_mean


def relative(parent: tuple[Array, Array], child: tuple[Array, Array]) -> tuple[Array, Array]:
    """The pose of a child in the frame of its parent, from the poses of both: (..., 3, 3) and (..., 3)."""
    back = np.swapaxes(parent[0], -1, -2)
    return back @ child[0], np.einsum("...ij,...j->...i", back, child[1] - parent[1])


def screw_axis(before: tuple[Array, Array], after: tuple[Array, Array]) -> Line:
    """The axis about which a body turned from one pose (3, 3), (3,) to another; right-handed about its direction."""
    rotation = after[0] @ before[0].T
    shift = after[1] - rotation @ before[1]
    skew = rotation - rotation.T
    turn = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return Line(np.linalg.pinv(np.eye(3) - rotation, rcond=1e-8) @ shift, turn / np.linalg.norm(turn))
