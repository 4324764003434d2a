"""Where tracking starts: rigid fits of the segments turned into coordinates, frame by frame.

The root follows its own markers; every joint then takes the angles that bring the child's
orientation nearest to its rigid fit. For one turn q about axis e between rotations P and Q, the q
that maximises trace(B^T P Re(q) Q) is
atan2(G_cb - G_bc, G_bb + G_cc),  G = P^T B Q^T, (b, c) the axes after e; several turns of one joint are visited one
after the other until they settle, and three orthogonal ones are read off. None starts beyond a wall
(`coordinate_prior.py`); a foot whose markers lie nearly on one line with the ankle may come out
upside down, and
starts from zero then. B is the rigid fit. A segment of too few markers for one has  B = sum w (x - c) (l - l_c)^T
instead, c its joint's centre as the segments before it place it: the turns then bring its markers
nearest to where they were seen. Frames that determine neither are interpolated.
"""

from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.chain import HALF_TURNS, LinkageModel
from gaitcal.model.rotations import compute_root_angles
from gaitcal.tracking.coordinate_prior import within_walls
from gaitcal.tracking.marker_residual import MarkerData
from gaitcal.tracking.rigid import RigidFit, SegmentMoments
from gaitcal.tracking.spline import SplineBasis, spaced

SWEEPS = 2  # visits to the turns of a joint of several, until they settle; tracking does the rest
STRAIGHT = 0.02
"""Weight of the straight joint against the markers of a segment that are too few for a rigid fit:
it outweighs one that lies within 40 mm of a line of 300 mm from the joint through another."""
BELIEVED = np.deg2rad(60.0)
"""Two markers are believed where they turn the joint by at most so much from where they and a
straight joint have it: a thigh marker 30 mm off the line from hip to knee turned a child's leg
about itself by 150 degrees."""
ROOT_COORDINATES = 6
ROUNDING = 1e-12  # of rotation matrices that are one but for rounding
SAMPLES_PER_NODE = 3  # frames looked at per spline node: a start needs no more


def starting_nodes(body: LinkageModel, data: MarkerData, basis: SplineBasis) -> Array:
    """(nn, nq) coefficients to start from."""
    nf, wanted = len(basis.time), SAMPLES_PER_NODE * basis.nodes
    if nf <= wanted:
        return basis.fit(starting_coordinates(body, data))
    chosen = spaced(nf, wanted)
    return basis.at(chosen).fit(starting_coordinates(body, data.frames(chosen)))


def starting_coordinates(body: LinkageModel, data: MarkerData) -> Array:
    """(nf, nq) coordinates from rigid fits, continuous in time."""
    chain, links = body.chain, _Links(body)
    nf = data.measured.shape[-1]
    q = np.zeros((nf, len(chain.coordinates)))
    moments = SegmentMoments(data)
    fits = moments.fits()
    root = fits.get(0)
    done = set(range(ROOT_COORDINATES))
    if root is None or not root.determined.any():
        root, path = _carried_root(links, fits)
        done.update(path)
    if root is not None:
        known = root.determined
        angles = _fill(_unwrap(compute_root_angles(root.rotation), known), known)
        q[:, :ROOT_COORDINATES] = np.hstack([_fill(root.origin, known), angles])
    so_far = _SoFar(links, q)
    wrapped: list[
        int
        # coordinates known in every frame, whose whole turns are taken out in the end, all at once
    ] = []
    for s in range(1, len(chain.segments)):
        turns, fit = [k for k in _path(links, s) if k not in done], fits.get(s)
        if turns and fit is not None:
            before = so_far.rotation(links.parents[turns[0]])
            to_joint = links.segment_rotation[s]
            straight: Array | None = None
            if fit.determined.any():
                spread, known = fit.rotation, fit.determined
            else:
                local_centre = -to_joint.T @ links.segment_translation[s]
                spread, known = moments.about(s, so_far.centre(turns[0]), local_centre)
                scale = np.sqrt((spread**2).sum(axis=(1, 2)))
                unturned = np.eye(3)
                for k in turns:
                    unturned = unturned @ links.offset_rotation[k]
                straight = spread + STRAIGHT * scale[:, None, None] * (before @ unturned @ to_joint)
                if (
                    not known.any()
                ):  # one marker: the joint's line towards it, turned about it as little as can be
                    spread, known, straight = straight, scale > 0, None
            if known.any():
                wanted = spread if straight is None else np.stack([spread, straight])
                joint = before.transpose(0, 2, 1) @ wanted @ to_joint.T
                angles = _turns(links, turns, joint.reshape(-1, 3, 3))
                if straight is not None:
                    angles, held = np.split(angles, 2)
                    apart = np.abs(np.angle(np.exp(1j * (angles - held)[known])))
                    angles = held if (apart > BELIEVED).any() else angles  # for the whole trial
                determined = bool(fit.determined.any())
                angles = within_walls(
                    [chain.coordinates[k] for k in turns], angles, known, determined=determined
                )
                if known.all():
                    q[:, turns] = angles
                    wrapped += turns
                else:
                    q[:, turns] = _fill(_unwrap(angles, known), known)
        # a segment without markers on which others hang leaves its turns to them
        if turns and (
            fit is not None or (chain.support[links.segment_coordinate[s]] > 0).sum() <= 1
        ):
            done.update(turns)
    q[:, wrapped] = _unwrap(q[:, wrapped], np.ones(nf, dtype=bool))
    return q


class _Links:
    """What is constant between the coordinates of a linkage: the poses of their frames at zero
    coordinates.

    The frame of coordinate k has the pose X_k = X_parent C_k M_k, M_k the motion of the coordinate;
    a segment D_s beyond its last coordinate. Frames of reversed axes are turned back
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


def _carried_root(links: _Links, fits: Mapping[int, RigidFit]) -> tuple[RigidFit | None, list[int]]:
    """The root as the first segment with a rigid fit carries it, and the coordinates between them,
    which are zero.
    """
    for s, fit in sorted(fits.items()):
        if fit.determined.any():
            rotation = fit.rotation @ links.rotation_at_zero[s].T
            return RigidFit(
                rotation, fit.origin - rotation @ links.origin_at_zero[s], fit.determined
            ), _path(links, s)
    return None, []


class _SoFar:
    """Frames of the coordinates that are settled already, worked out when asked for."""

    def __init__(self, links: _Links, q: Array) -> None:
        self.links, self.q = links, q
        self._rotations: dict[int, Array] = {-1: np.broadcast_to(np.eye(3), (len(q), 3, 3))}
        self._origins: dict[int, Array] = {-1: np.zeros((len(q), 3))}

    def rotation(self, k: int) -> Array:
        """(nf, 3, 3) of the frame of coordinate k."""
        if k not in self._rotations:
            links = self.links
            rotation = self.rotation(links.parents[k])
            if not links.plain[k]:
                rotation = rotation @ links.offset_rotation[k]
            angle = links.signs[k] * self.q[:, k]
            self._rotations[k] = (
                _turned(rotation, links.axes[k], angle) if links.rotates[k] else rotation
            )
        return self._rotations[k]

    def centre(self, k: int) -> Array:
        """(nf, 3) m, where the turn of coordinate k takes place."""
        parent = self.links.parents[k]
        return self._origin(parent) + self.rotation(parent) @ self.links.offset_translation[k]

    def _origin(self, k: int) -> Array:
        if k not in self._origins:
            origin, links = self.centre(k), self.links
            if not links.rotates[k]:
                along = self.rotation(k)[:, :, links.axes[k]]
                origin = origin + along * (links.signs[k] * self.q[:, k, None])
            self._origins[k] = origin
        return self._origins[k]


def _path(links: _Links, segment: int) -> list[int]:
    """The coordinates from the root to a segment."""
    path, k = [], links.segment_coordinate[segment]
    while k >= 0:
        path.append(k)
        k = links.parents[k]
    return path[::-1]


def _unwrap(angles: Array, known: BoolArray) -> Array:
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


def _turned(rotation: Array, axis: int, angle: Array) -> Array:
    """(nf, 3, 3) rotation @ R_axis(angle), of one rotation (1, 3, 3) or of many."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = np.empty((len(angle), 3, 3))
    out[:, :, axis] = rotation[:, :, axis]
    out[:, :, a] = c * rotation[:, :, a] + s * rotation[:, :, b]
    out[:, :, b] = c * rotation[:, :, b] - s * rotation[:, :, a]
    return out


def _turns(links: _Links, turns: list[int], target: Array) -> Array:
    """(nf, n) coordinates whose turns, one after the other, come nearest to the matrices `target`
    (nf, 3, 3).
    """
    axes, plain = [links.axes[k] for k in turns], [links.plain[k] for k in turns]
    signs = links.signs[turns]
    if axes == [2, 0, 1] and all(plain[1:]):
        return signs * compute_root_angles(
            target if plain[0] else links.offset_rotation[turns[0]].T @ target
        )
    angles = np.zeros((len(target), len(turns)))
    for _ in range(SWEEPS if len(turns) > 1 else 1):
        # left-hand sides are peeled off as they are settled, right-hand sides kept from the last
        # sweep
        after: list[Array] = []
        for i in range(len(turns) - 1, 0, -1):
            inner = _turned(links.offset_rotation[None, turns[i]], axes[i], angles[:, i])
            after.append(inner @ after[-1] if after else inner)
        remaining = target
        for i, k in enumerate(turns):
            if not plain[i]:
                remaining = links.offset_rotation[k].T @ remaining
            last = i + 1 == len(turns)
            g = remaining if last else remaining @ after[len(turns) - 2 - i].transpose(0, 2, 1)
            b, c = (axes[i] + 1) % 3, (axes[i] + 2) % 3
            angles[:, i] = np.arctan2(g[:, c, b] - g[:, b, c], g[:, b, b] + g[:, c, c])
            if not last:
                remaining = _turned(remaining.transpose(0, 2, 1), axes[i], angles[:, i]).transpose(
                    0, 2, 1
                )
    return signs * angles
