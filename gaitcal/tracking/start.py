"""Start of tracking: coordinates from rigid fits of the segments, frame by frame.

The base segment follows its markers. Every joint then takes the angles that bring the child's
orientation nearest to its rigid fit. For one rotation q about axis e between rotations P and Q, the
q that maximises trace(B^T P Re(q) Q) is atan2(G_cb - G_bc, G_bb + G_cc),  G = P^T B Q^T, with (b,
c) the axes after e. Several rotations of one joint are solved in turn until they settle; three
orthogonal ones have a closed form. No joint starts outside its limits (`coordinate_prior.py`). A
foot whose markers are nearly on one line with the ankle may come out upside down, and starts from
zero then. B is the rigid fit. A segment of too few markers for one has another matrix B = sum w (x
- c) (l - l_c)^T, with c its joint centre as placed by the segments before it. The rotations then
bring its markers nearest to their measured positions. Frames that determine neither are
interpolated.
"""

from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.chain import HALF_TURNS, LinkageModel
from gaitcal.model.rotations import compute_root_angles
from gaitcal.tracking.coordinate_prior import clip_to_joint_limits
from gaitcal.tracking.marker_residual import MarkerData
from gaitcal.tracking.rigid import RigidFit, SegmentMoments
from gaitcal.tracking.spline import SplineBasis, select_spaced_frames

SWEEPS = 2
"""Sweeps over the rotations of a joint that has several; tracking corrects what remains."""
STRAIGHT_WEIGHT = 0.02
"""Weight of the straight joint relative to markers that are too few for a rigid fit. It outweighs a
marker within 40 mm of a line of 300 mm from the joint through another marker."""
MAX_CORRECTION_RAD = np.deg2rad(60.0)
"""rad, largest rotation of a joint by two markers, relative to the solution held straight. A thigh
marker 30 mm off the line from hip to knee rotated a child's leg about itself by 150 degrees."""
ROOT_COORDINATES = 6
ROUNDING = 1e-12
"""Largest entry by which equal rotation matrices differ."""
SAMPLES_PER_NODE = 3
"""Frames for each control point that a start needs."""


def find_start_coefficients(body: LinkageModel, data: MarkerData, basis: SplineBasis) -> Array:
    """Find the spline coefficients that tracking starts from.

    Parameters
    ----------
    body
        Linkage with its joint parameters.
    data
        Markers of all frames.
    basis
        Splines of the trial.

    Returns
    -------
    (nn, nq) array
        m, rad.
    """
    nf, wanted = len(basis.time), SAMPLES_PER_NODE * basis.control_points
    if nf <= wanted:
        return basis.fit(find_start_coordinates(body, data))
    chosen = select_spaced_frames(nf, wanted)
    return basis.select_frames(chosen).fit(find_start_coordinates(body, data.select_frames(chosen)))


def find_start_coordinates(body: LinkageModel, data: MarkerData) -> Array:
    """Find coordinates from rigid fits, continuous in time.

    `body`: linkage with its joint parameters. Returns: (nf, nq) m, rad.
    """
    chain, links = body.chain, _Links(body)
    nf = data.measured.shape[-1]
    q = np.zeros((nf, len(chain.coordinates)))
    moments = SegmentMoments(data)
    fits = moments.fit_segments()
    root = fits.get(0)
    done = set(range(ROOT_COORDINATES))
    # Without a fit of the base segment, another segment determines its pose.
    if root is None or not root.determined.any():
        root, path = _place_root_from_segment(links, fits)
        done.update(path)
    if root is not None:
        known = root.determined
        angles = _fill(_unwrap(compute_root_angles(root.rotation), known), known)
        q[:, :ROOT_COORDINATES] = np.hstack([_fill(root.origin, known), angles])
    settled = _SettledFrames(links, q)
    # Coordinates that are known in every frame: their whole turns are removed together at the end.
    wrapped: list[int] = []
    for s in range(1, len(chain.segments)):
        rotations, fit = [k for k in _list_path(links, s) if k not in done], fits.get(s)
        if rotations and fit is not None:
            angles, known = _find_joint_angles(links, settled, moments, s, rotations, fit)
            if known.any():
                names = [chain.coordinates[k] for k in rotations]
                determined = bool(fit.determined.any())
                angles = clip_to_joint_limits(names, angles, known, determined=determined)
                if known.all():
                    q[:, rotations] = angles
                    wrapped += rotations
                else:
                    q[:, rotations] = _fill(_unwrap(angles, known), known)
        # The rotations before a segment without markers are left to the segments after it.
        is_last = (chain.support[links.segment_coordinate[s]] > 0).sum() <= 1
        if rotations and (fit is not None or is_last):
            done.update(rotations)
    q[:, wrapped] = _unwrap(q[:, wrapped], np.ones(nf, dtype=bool))
    return q


def _find_joint_angles(
    links: "_Links",
    settled: "_SettledFrames",
    moments: SegmentMoments,
    segment: int,
    rotations: list[int],
    fit: RigidFit,
) -> tuple[Array, BoolArray]:
    """Find the angles (nf, n) rad of the rotations before a segment, and known frames (nf,)."""
    before = settled.compute_rotation(links.parents[rotations[0]])
    to_joint = links.segment_rotation[segment]
    straight: Array | None = None
    if fit.determined.any():
        spread, known = fit.rotation, fit.determined
    else:
        # Too few markers for a rigid fit: rotate about the joint centre, weakly held straight.
        local_centre = -to_joint.T @ links.segment_translation[segment]
        centre = settled.compute_centre(rotations[0])
        spread, known = moments.compute_spread(segment, centre, local_centre)
        scale = np.sqrt((spread**2).sum(axis=(1, 2)))
        unrotated = np.eye(3)
        for k in rotations:
            unrotated = unrotated @ links.offset_rotation[k]
        straight = spread + STRAIGHT_WEIGHT * scale[:, None, None] * (before @ unrotated @ to_joint)
        if not known.any():
            # One marker: the smallest rotation that brings the joint's line towards it.
            spread, known, straight = straight, scale > 0, None
    if not known.any():
        return np.zeros((len(spread), len(rotations))), known
    wanted = spread if straight is None else np.stack([spread, straight])
    joint = before.transpose(0, 2, 1) @ wanted @ to_joint.T
    angles = _solve_joint_angles(links, rotations, joint.reshape(-1, 3, 3))
    if straight is not None:
        # Two markers that rotate the joint far from straight are not used in the whole trial.
        angles, held = np.split(angles, 2)
        difference = np.abs(np.angle(np.exp(1j * (angles - held)[known])))
        angles = held if (difference > MAX_CORRECTION_RAD).any() else angles
    return angles, known


class _Links:
    """Constant transforms between the coordinates of a linkage, at zero coordinates.

    The frame of coordinate k has the pose X_k = X_parent C_k M_k, M_k the motion of the coordinate;
    a segment is D_s beyond its last coordinate. Frames of reversed axes are rotated back
    (`HALF_TURNS`).
    """

    def __init__(self, body: LinkageModel) -> None:
        chain = body.chain
        joints = chain.at_coordinates + 1
        placed, segments = body.rest
        elements = [chain.elements[name] for name in chain.coordinates]
        self.axes = [e.axis for e in elements]
        self.signs = np.array([e.sign for e in elements])
        self.rotates = [e.rotates for e in elements]
        self.parents, self.segment_coordinate = chain.parents, chain.segment_coordinate

        # the ground comes last, so that it is the parent -1
        rotation = np.append(placed[joints, :3].transpose(0, 2, 1), np.eye(3)[None], axis=0)
        for k, e in enumerate(elements):
            if e.sign < 0:
                rotation[k] = rotation[k] @ HALF_TURNS[e.axis]
        origin = np.append(placed[joints, 3], np.zeros((1, 3)), axis=0)
        back = rotation[self.parents].transpose(0, 2, 1)
        self.offset_rotation = back @ rotation[:-1]
        self.offset_translation = (back @ (origin[:-1] - origin[self.parents])[:, :, None])[:, :, 0]
        self.plain = (np.abs(self.offset_rotation - np.eye(3)).max(axis=(1, 2)) < ROUNDING).tolist()
        """Whether C_k does not rotate."""

        # segments at zero coordinates, in the laboratory: rotation, and origin (m)
        self.rotation_at_zero = segments[:, :3].transpose(0, 2, 1)
        self.origin_at_zero = segments[:, 3]
        back = rotation[self.segment_coordinate].transpose(0, 2, 1)
        away = self.origin_at_zero - origin[self.segment_coordinate]
        self.segment_rotation = back @ self.rotation_at_zero
        self.segment_translation = (back @ away[:, :, None])[:, :, 0]


def _place_root_from_segment(
    links: _Links, fits: Mapping[int, RigidFit]
) -> tuple[RigidFit | None, list[int]]:
    """Place the base segment by the first segment with a rigid fit.

    The coordinates between them, which are zero, are returned too.
    """
    for s, fit in sorted(fits.items()):
        if fit.determined.any():
            rotation = fit.rotation @ links.rotation_at_zero[s].T
            return RigidFit(
                rotation, fit.origin - rotation @ links.origin_at_zero[s], fit.determined
            ), _list_path(links, s)
    return None, []


class _SettledFrames:
    """Frames of the coordinates that are settled, computed when needed."""

    def __init__(self, links: _Links, q: Array) -> None:
        self.links, self.q = links, q
        self._rotations: dict[int, Array] = {-1: np.broadcast_to(np.eye(3), (len(q), 3, 3))}
        self._origins: dict[int, Array] = {-1: np.zeros((len(q), 3))}

    def compute_rotation(self, k: int) -> Array:
        """Compute the rotation (nf, 3, 3) of the frame of coordinate k."""
        if k not in self._rotations:
            links = self.links
            rotation = self.compute_rotation(links.parents[k])
            if not links.plain[k]:
                rotation = rotation @ links.offset_rotation[k]
            angle = links.signs[k] * self.q[:, k]
            self._rotations[k] = (
                _rotate_about_axis(rotation, links.axes[k], angle) if links.rotates[k] else rotation
            )
        return self._rotations[k]

    def compute_centre(self, k: int) -> Array:
        """Compute the centre (nf, 3) m of the rotation of coordinate k."""
        parent = self.links.parents[k]
        return (
            self._compute_origin(parent)
            + self.compute_rotation(parent) @ self.links.offset_translation[k]
        )

    def _compute_origin(self, k: int) -> Array:
        if k not in self._origins:
            origin, links = self.compute_centre(k), self.links
            if not links.rotates[k]:
                along = self.compute_rotation(k)[:, :, links.axes[k]]
                origin = origin + along * (links.signs[k] * self.q[:, k, None])
            self._origins[k] = origin
        return self._origins[k]


def _list_path(links: _Links, segment: int) -> list[int]:
    """List the coordinates from the base segment to a segment."""
    path, k = [], links.segment_coordinate[segment]
    while k >= 0:
        path.append(k)
        k = links.parents[k]
    return path[::-1]


def _unwrap(angles: Array, known: BoolArray) -> Array:
    """Unwrap angles over the known frames, with medians within half a turn of zero."""
    out = angles.copy()
    out[known] = np.unwrap(angles[known], axis=0)
    out[known] -= 2 * np.pi * np.round(np.median(out[known], axis=0) / (2 * np.pi))
    return out


def _fill(values: Array, known: BoolArray) -> Array:
    """Interpolate frames that are not known; the ends keep the nearest known value."""
    if known.all():
        return values
    frames = np.arange(len(values))
    return np.stack(
        [np.interp(frames, frames[known], column[known]) for column in values.T], axis=1
    )


def _rotate_about_axis(rotation: Array, axis: int, angle: Array) -> Array:
    """Return (nf, 3, 3) rotation @ R_axis(angle), of one rotation (1, 3, 3) or of many."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = np.empty((len(angle), 3, 3))
    out[:, :, axis] = rotation[:, :, axis]
    out[:, :, a] = c * rotation[:, :, a] + s * rotation[:, :, b]
    out[:, :, b] = c * rotation[:, :, b] - s * rotation[:, :, a]
    return out


def _solve_joint_angles(links: _Links, rotations: list[int], target: Array) -> Array:
    """Solve the angles (nf, n) of successive rotations that come nearest to matrices (nf, 3, 3)."""
    axes, plain = [links.axes[k] for k in rotations], [links.plain[k] for k in rotations]
    signs = links.signs[rotations]
    if axes == [2, 0, 1] and all(plain[1:]):
        return signs * compute_root_angles(
            target if plain[0] else links.offset_rotation[rotations[0]].T @ target
        )
    angles = np.zeros((len(target), len(rotations)))
    for _ in range(SWEEPS if len(rotations) > 1 else 1):
        # Rotations on the left are removed as they are solved; those on the right are kept from the
        # last sweep.
        after: list[Array] = []
        for i in range(len(rotations) - 1, 0, -1):
            inner = _rotate_about_axis(
                links.offset_rotation[None, rotations[i]], axes[i], angles[:, i]
            )
            after.append(inner @ after[-1] if after else inner)
        remaining = target
        for i, k in enumerate(rotations):
            if not plain[i]:
                remaining = links.offset_rotation[k].T @ remaining
            last = i + 1 == len(rotations)
            g = remaining if last else remaining @ after[len(rotations) - 2 - i].transpose(0, 2, 1)
            b, c = (axes[i] + 1) % 3, (axes[i] + 2) % 3
            angles[:, i] = np.arctan2(g[:, c, b] - g[:, b, c], g[:, b, b] + g[:, c, c])
            if not last:
                remaining = _rotate_about_axis(
                    remaining.transpose(0, 2, 1), axes[i], angles[:, i]
                ).transpose(0, 2, 1)
    return signs * angles
