"""Rigid fit of each segment to its markers, frame by frame.

With weights w_m, model positions l_m and measured positions x_m about their weighted means, the
best rotation maximises trace(R^T B),  B = sum_m w_m x_m l_m^T  (Wahba 1965). Markley's closed form
(FOAM, J. Astronautical Sciences 41, 1993) needs no singular value decomposition and works for
markers in a plane, as three always are:

    R = [ (k + |B|^2) B + s adj(B)^T - B B^T B ] / (k s - det B),   k = (s^2 - |B|^2) / 2,

s is the largest root of (s^2 - |B|^2)^2 - 8 s det B - 4 |adj B|^2, found by Newton from above. The
remaining distances are the rigid-segment floor: no linkage of these segments fits better. Arrays
have the frame index last.
"""

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, find_visible
from gaitcal.model.segment_frames import find_nearest_rotation
from gaitcal.model.subject_model import MarkerPlacement
from gaitcal.tracking.marker_residual import MarkerData

COLLINEAR_RATIO = 1e-3
"""Ratio of the second to the first singular value of B below which the rotation about the line of
the markers is undetermined."""
MOST_STEPS = 60
"""Largest number of Newton steps for s."""
FEWEST_MARKERS = 3
"""Markers that determine position and orientation of a segment."""


@dataclass(frozen=True)
class RigidFit:
    """Rigid motion of one segment."""

    rotation: Array  # (nf, 3, 3) segment to laboratory
    origin: Array  # (nf, 3) m, of the segment frame
    determined: BoolArray  # (nf,) whether three markers off one line are visible


def fit_rigid(local: Array, measured: Array, weight: Array) -> RigidFit:
    """Fit a rigid motion to the markers of one segment.

    Parameters
    ----------
    local
        (nm, 3) m, positions in the segment frame.
    measured
        (nm, 3, nf) m, laboratory axes.
    weight
        (nm, nf) >= 0.

    Returns
    -------
    RigidFit
    """
    spread, x_mean, l_mean = _compute_moments(local, measured, weight)
    rotation, two_dimensional = find_best_rotation(spread)
    determined = ((weight > 0).sum(axis=0) >= FEWEST_MARKERS) & two_dimensional
    origin = x_mean - np.einsum("ijf,jf->if", rotation, l_mean)
    return RigidFit(np.ascontiguousarray(rotation.transpose(2, 0, 1)), origin.T.copy(), determined)


def fit_segment(markers: MarkerPlacement, segment: str, recording: Recording) -> RigidFit | None:
    """Fit a segment to the markers that a recording has of it, all with the same weight.

    Parameters
    ----------
    markers
        Markers of the model.
    segment
        Name of the segment.
    recording
        Measured markers.

    Returns
    -------
    RigidFit or None
        None where fewer than three markers are recorded, or no frame determines the orientation.
    """
    column = {label: i for i, label in enumerate(recording.labels)}
    on = markers.find_markers(segment, column)
    if len(on) < FEWEST_MARKERS:
        return None
    measured = recording.markers[:, [column[markers.labels[i]] for i in on]]
    visible = find_visible(measured)
    placed = np.where(visible[:, :, None], measured, 0.0).transpose(1, 2, 0)
    fit = fit_rigid(markers.local[on], placed, visible.T.astype(float))
    return fit if fit.determined.any() else None


class SegmentMoments:
    """First and second moments of the markers of all segments, for simultaneous fits."""

    def __init__(self, data: MarkerData) -> None:
        nf = data.measured.shape[-1]
        pull = data.weight[:, None] * data.measured
        groups = data.placed.groups
        self._place = {s: k for k, (s, _) in enumerate(groups)}
        self._seen = np.array([(data.weight[markers] > 0).sum(axis=0) for _, markers in groups])
        self._local = data.moments
        # sum of w [l; 1]_j x
        self._mixed = np.empty((len(groups), 4, 3, nf))
        for k, (_, markers) in enumerate(groups):
            flat = pull[markers].reshape(-1, 3 * nf)
            np.matmul(data.placed.extended[markers].T, flat, out=self._mixed[k].reshape(4, 3 * nf))
            if data.shift is not None:
                self._mixed[k, :3] += np.einsum("mjf,mif->jif", data.shift[markers], pull[markers])

    def fit_segments(self) -> dict[int, RigidFit]:
        """Fit every segment that carries markers.

        Returns
        -------
        dict
            Segment index -> RigidFit.
        """
        n, nf = len(self._place), self._mixed.shape[-1]
        total = np.broadcast_to(self._local[:, 3, 3], (n, nf))
        safe = np.where(total > 0, total, 1.0)
        x_mean, l_mean = self._mixed[:, 3] / safe[:, None], self._local[:, 3, :3] / safe[:, None]
        spread = self._mixed[:, :3] - l_mean[:, :, None] * self._mixed[:, 3, None]
        rotation, two_dimensional = find_best_rotation(
            spread.transpose(2, 1, 0, 3).reshape(3, 3, n * nf)
        )
        rotation = rotation.reshape(3, 3, n, nf)
        determined = (self._seen >= FEWEST_MARKERS) & two_dimensional.reshape(n, nf)
        origin = x_mean - np.einsum("ijsf,sjf->sif", rotation, l_mean)
        by_frame = np.ascontiguousarray(rotation.transpose(2, 3, 0, 1))
        return {
            s: RigidFit(by_frame[k], origin[k].T, determined[k]) for s, k in self._place.items()
        }

    def compute_spread(
        self, segment: int, centre: Array, local_centre: Array
    ) -> tuple[Array, BoolArray]:
        """Compute B of a segment about known centres.

        Parameters
        ----------
        segment
            Index of the segment.
        centre
            (nf, 3) m, c in the laboratory.
        local_centre
            (3,) m, l_c in the segment frame.

        Returns
        -------
        (nf, 3, 3) array
            Sum of w (x - c) (l - l_c)^T.
        (nf,) array of bool
            Whether it determines a rotation.
        """
        k = self._place[segment]
        mixed, local = self._mixed[k], self._local[k]
        # (3, nf) sum of w (l - l_c)
        arm = local[:3, 3] - local_centre[:, None] * local[3, 3]
        spread = mixed[:3] - local_centre[:, None, None] * mixed[3] - arm[:, None] * centre.T
        scale, minors = (spread * spread).sum(axis=(0, 1)), _compute_row_products(spread)
        two_dimensional = np.sqrt((minors * minors).sum(axis=(0, 1))) > COLLINEAR_RATIO * scale
        return spread.transpose(2, 1, 0), (scale > 0) & two_dimensional


def compute_rigid_distances(local: Array, measured: Array, weight: Array) -> Array:
    """Compute the distances that remain when a segment follows its markers.

    Parameters
    ----------
    local
        (nm, 3) m, or (nm, 3, nf) where the markers move in the segment.
    measured
        (nm, 3, nf) m, laboratory axes.
    weight
        (nm, nf) >= 0.

    Returns
    -------
    (nm, nf) array
        m; NaN where the weight is zero.
    """
    spread, x_mean, l_mean = _compute_moments(local, measured, weight)
    rotation, determined = find_best_rotation(spread)
    # one or two markers, or all on a line: any of the best rotations will do
    if not determined.all():
        any_best = find_nearest_rotation(spread[:, :, ~determined].transpose(2, 0, 1))
        rotation[:, :, ~determined] = any_best.transpose(1, 2, 0)
    by_frame = local.reshape(*local.shape[:2], -1)
    model = np.einsum("ijf,mjf->mif", rotation, by_frame - l_mean) + x_mean
    distance: Array = np.linalg.norm(model - measured, axis=1)
    distance[weight <= 0] = np.nan
    return distance


def _compute_moments(local: Array, measured: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Compute B (3, 3, nf), and the weighted means (3, nf) of measured and local positions.

    Local positions are (nm, 3) or (nm, 3, nf).
    """
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1.0)
    x_mean = np.einsum("mf,mif->if", weight, measured) / safe
    pull = weight[:, None] * (measured - x_mean)
    if local.ndim == 2:
        return np.einsum("mif,mj->ijf", pull, local), x_mean, (local.T @ weight) / safe
    l_mean = np.einsum("mf,mjf->jf", weight, local) / safe
    return np.einsum("mif,mjf->ijf", pull, local), x_mean, l_mean


def find_best_rotation(b: Array) -> tuple[Array, BoolArray]:
    """Find the rotations nearest to matrices.

    Parameters
    ----------
    b
        (3, 3, nf) matrices B.

    Returns
    -------
    (3, 3, nf) array
        Rotations; identities where they are undetermined.
    (nf,) array of bool
        Whether each is determined.
    """
    scale = np.sqrt(np.einsum("ijf,ijf->f", b, b))
    b = b / np.where(scale > 0, scale, 1.0)
    adjugate = _compute_row_products(b)
    determinant = np.einsum("jf,jf->f", b[0], adjugate[0])
    square = np.einsum("ijf,ijf->f", adjugate, adjugate)
    determined = (scale > 0) & (np.sqrt(square) > COLLINEAR_RATIO)
    s = _find_largest_root(8.0 * determinant, 4.0 * square, determined)
    k = 0.5 * (s * s - 1.0)
    bbb = np.einsum("ikf,klf->ilf", np.einsum("ijf,kjf->ikf", b, b), b)
    rotation = (k + 1.0) * b + s * adjugate
    rotation -= bbb
    denominator = k * s - determinant
    determined &= denominator > 1e-12
    rotation /= np.where(determined, denominator, 1.0)
    rotation[:, :, ~determined] = np.eye(3)[:, :, None]
    # one step towards the nearest rotation, R (3 - R^T R) / 2, squares the rounding error
    gram = np.einsum("kif,kjf->ijf", rotation, rotation)
    return 1.5 * rotation - 0.5 * np.einsum("ikf,kjf->ijf", rotation, gram), determined


def _find_largest_root(linear: Array, constant: Array, determined: BoolArray) -> Array:
    """Find the largest root s (nf,) of (s^2 - 1)^2 - linear s - constant.

    For |B| = 1 it is at most sqrt(3), and Newton falls onto it. Only the steps of `determined`
    frames count, as others have a double root, which takes Newton long.
    """
    s = np.full_like(linear, np.sqrt(3.0))
    for _ in range(MOST_STEPS):
        gap = s * s
        gap -= 1.0
        slope = 4.0 * s
        slope *= gap
        slope -= linear
        step = gap * gap
        step -= linear * s
        step -= constant
        step /= np.where(np.abs(slope) > 1e-14, slope, 1.0)
        s -= step
        if np.abs(step).max(initial=0.0, where=determined) < 1e-15:
            break
    return s


def _compute_row_products(b: Array) -> Array:
    """Compute (3, 3, nf) adj(B)^T: its rows are the cross products of the rows of B."""
    out = np.empty_like(b)
    for i in range(3):
        first, second = b[(i + 1) % 3], b[(i + 2) % 3]
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            np.multiply(first[k], second[m], out=out[i, j])
            out[i, j] -= first[m] * second[k]
    return out
