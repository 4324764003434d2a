"""Rigid motions.

Joint centres and axes from two clusters of markers alone: SCoRE and SARA, to stand beside ours.

(R_i, p_i) and (S_i, q_i) are the poses of the two segments in frame i; c and d a point's coordinates in them.

    SCoRE   minimises sum |R_i c + p_i - S_i d - q_i|^2 over (c, d): the point that both segments carry most alike
            (Ehrig, Taylor, Duda and Heller, J Biomech 39:2798-2809, 2006)
    SARA    where both segments turn about one axis, these equations (R_i  -S_i) (c; d) = q_i - p_i do not see (n; m),
            that axis in either: the right singular vector of the least singular value. The least-norm solution across
            it is a point of the axis (Ehrig, Taylor, Duda and Heller, J Biomech 40:2150-2157, 2007)
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.export.peer_model import Axis


def angle(one: Array, other: Array) -> float:
    """Angle (deg, 0 to 90) of two directions, whichever way either of them points."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other)), abs(one @ other))))


def across(vectors: Array, direction: Array) -> Array:
    """The part of vectors (..., 3) at right angles to unit vectors (..., 3)."""
    out: Array = vectors - (vectors * direction).sum(axis=-1, keepdims=True) * direction
    return out


def relative(parent: tuple[Array, Array], child: tuple[Array, Array]) -> tuple[Array, Array]:
    """The pose of a child in the frame of its parent, from the poses of both: (..., 3, 3) and (..., 3)."""
    back = np.swapaxes(parent[0], -1, -2)
    return back @ child[0], np.einsum("...ij,...j->...i", back, child[1] - parent[1])


Poses = tuple[Array, Array]
"""(nf, 3, 3) and (nf, 3) m."""


def score(proximal: Poses, distal: Poses) -> tuple[Array, Array]:
    """The joint's centre (3,) m in the frames of both segments."""
    matrix, right = _equations(proximal, distal)
    both = np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], dtype=np.float64)
    return both[:3], both[3:]


def sara(proximal: Poses, distal: Poses) -> tuple[Axis, Axis]:
    """The joint's axis in the frames of both segments."""
    matrix, right = _equations(proximal, distal)
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    both = vt[:-1].T @ ((u[:, :-1].T @ right) / s[:-1])
    n, m = vt[-1, :3], vt[-1, 3:]
    return Axis(both[:3], n / np.linalg.norm(n)), Axis(both[3:], m / np.linalg.norm(m))


def _equations(proximal: Poses, distal: Poses) -> tuple[Array, Array]:
    matrix = np.concatenate([proximal[0], -distal[0]], axis=2).reshape(-1, 6)
    return matrix, (distal[1] - proximal[1]).ravel()
