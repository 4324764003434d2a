"""Rigid motions, and the axes that they turn about.

Screw. A turn (R, p) leaves the line {c + s n} in place but for a slide along it: R n = n, (1 - R) c = p across n. With
the small residue of rounding, c is the least-norm solution by the pseudo-inverse, the nearest point to the origin.

Joint centres and axes from two clusters of markers alone: SCoRE and SARA, to stand beside ours.

(R_i, p_i) and (S_i, q_i) are the poses of the two segments in frame i; c and d a point's coordinates in them.

    SCoRE   minimises sum |R_i c + p_i - S_i d - q_i|^2 over (c, d): the point that both segments carry most alike
            (Ehrig, Taylor, Duda and Heller, J Biomech 39:2798-2809, 2006)
    SARA    where both segments turn about one axis, these equations (R_i  -S_i) (c; d) = q_i - p_i do not see (n; m),
            that axis in either: the right singular vector of the least singular value. The least-norm solution across
            it is a point of the axis (Ehrig, Taylor, Duda and Heller, J Biomech 40:2150-2157, 2007)
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


# ------------------------------------------------------------------------------------- joints from two clusters

Poses = tuple[Array, Array]
"""(nf, 3, 3) and (nf, 3) m."""


def score(proximal: Poses, distal: Poses) -> tuple[Array, Array]:
    """The joint's centre (3,) m in the frames of both segments."""
    matrix, right = _equations(proximal, distal)
    both = np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], dtype=np.float64)
    return both[:3], both[3:]


def sara(proximal: Poses, distal: Poses) -> tuple[Line, Line]:
    """The joint's axis in the frames of both segments."""
    matrix, right = _equations(proximal, distal)
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    both = vt[:-1].T @ ((u[:, :-1].T @ right) / s[:-1])
    n, m = vt[-1, :3], vt[-1, 3:]
    return Line(both[:3], n / np.linalg.norm(n)), Line(both[3:], m / np.linalg.norm(m))


def _equations(proximal: Poses, distal: Poses) -> tuple[Array, Array]:
    matrix = np.concatenate([proximal[0], -distal[0]], axis=2).reshape(-1, 6)
    return matrix, (distal[1] - proximal[1]).ravel()
