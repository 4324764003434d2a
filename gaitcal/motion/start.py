"""Where tracking starts: rigid fits of the segments turned into coordinates, frame by frame.

The root follows its own markers; every joint then takes the angles that bring the child's orientation nearest to its
rigid fit. For one turn q about axis e between rotations P and Q, the q that maximises trace(B^T P Re(q) Q) is
atan2(G_cb - G_bc, G_bb + G_cc),  G = P^T B Q^T, (b, c) the axes after e; several turns of one joint are visited one
after the other until they settle, and three orthogonal ones are read off. None starts beyond a wall
(`coordinate_prior.py`); a foot whose markers lie nearly on one line with the ankle may come out upside down, and
starts from zero then. B is the rigid fit. A segment of too few
markers for one has  B = sum w (x - c) (l - l_c)^T  instead, c its joint's centre as the segments before it place it:
the turns then bring its markers nearest to where they were seen. Frames that determine neither are interpolated.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.chain import Chain, ChainConstants, forward, root_angles, segment_poses
from gaitcal.motion.coordinate_prior import within_walls
from gaitcal.motion.marker_residual import MarkerData
from gaitcal.motion.rigid import RigidFit, SegmentMoments
from gaitcal.motion.spline import SplineBasis

SWEEPS = 2
"""Visits to the turns of a joint of several, until they settle; tracking does the rest."""
STRAIGHT = 0.02
"""Weight of the straight joint against the markers of a segment that are too few for a rigid fit: it outweighs one that
lies within 40 mm of a line of 300 mm from the joint through another."""
BELIEVED = np.deg2rad(60.0)
"""Two markers are believed where they turn the joint by at most so much from where they and a straight joint have it: a
thigh marker 30 mm off the line from hip to knee turned a child's leg about itself by 150 degrees."""
ROOT_COORDINATES = 6
SAMPLES_PER_NODE = 3
"""Frames looked at per spline node: a start needs no more."""


def starting_nodes(chain: Chain, constants: ChainConstants, data: MarkerData, basis: SplineBasis) -> Array:
    """(nn, nq) nodes to start from."""
    nf = len(basis.time)
    wanted = SAMPLES_PER_NODE * basis.nodes
    if nf <= wanted:
        return basis.fit(starting_coordinates(chain, constants, data))
    chosen = np.unique(np.round(np.linspace(0, nf - 1, wanted)).astype(int))
    return basis.at(chosen).fit(starting_coordinates(chain, constants, data.frames(chosen)))


def starting_coordinates(chain: Chain, constants: ChainConstants, data: MarkerData) -> Array:
    """(nf, nq) coordinates from rigid fits, continuous in time."""
    nf = data.measured.shape[-1]
    q = np.zeros((nf, len(chain.coordinates)))
    moments = SegmentMoments(data)
    fits = moments.fits()
    root = fits.get(0)
    done = set(range(ROOT_COORDINATES))
    if root is None or not root.determined.any():
        root, path = _carried_root(chain, constants, fits)
        done.update(path)
    if root is not None:
        q[:, :ROOT_COORDINATES] = _root_coordinates(root)
    so_far = _SoFar(chain, constants, q)
    wrapped: list[int] = []
    """Coordinates known in every frame, whose whole turns are taken out in the end, all at once."""
    for s in range(1, len(chain.segments)):
        path = _path(chain, s)
        own = [k for k in path if k not in done]
        fit = fits.get(s)
        if own and fit is not None:
            before = so_far.rotation(chain.parents[own[0]])
            to_joint = constants.segment_rotation[s]
            straight: Array | None = None
            if fit.determined.any():
                spread, known = fit.rotation, fit.determined
            else:
                centre, local_centre = so_far.centre(own), _local_centre(constants, s)
                spread, known = moments.about(s, centre, local_centre)
                scale = np.sqrt((spread**2).sum(axis=(1, 2)))
                straight = spread + STRAIGHT * scale[:, None, None] * (before @ _straight(constants, own) @ to_joint)
                if not known.any():  # one marker: the joint's line towards it, turned about it as little as can be
                    spread, known, straight = straight, scale > 0, None
            if known.any():
                inverse = before.transpose(0, 2, 1)
                angles = _turns(chain, constants, own, inverse @ spread @ to_joint.T)
                if straight is not None:
                    angles = _or_straight(angles, _turns(chain, constants, own, inverse @ straight @ to_joint.T), known)
                angles = within_walls([chain.coordinates[k] for k in own], angles, known, told=fit.determined.any())
                if known.all():
                    q[:, own] = angles
                    wrapped += own
                else:
                    q[:, own] = _fill(_unwrap(angles, known), known)
        if own and (fit is not None or not _carries_more(chain, s)):
            done.update(own)
    q[:, wrapped] = _unwrap(q[:, wrapped], np.ones(nf, dtype=bool))
    return q


def _carried_root(
    chain: Chain, constants: ChainConstants, fits: Mapping[int, RigidFit]
) -> tuple[RigidFit | None, list[int]]:
    """The root as the first segment with a rigid fit carries it, and the coordinates between them, which are zero."""
    for s, fit in sorted(fits.items()):
        if fit.determined.any():
            axes, origins = segment_poses(
                chain, constants, forward(chain, constants, np.zeros((1, len(chain.coordinates))))
            )
            turned, shift = axes[s, :, :, 0].T, origins[s, :, 0]
            rotation = fit.rotation @ turned.T
            return RigidFit(rotation, fit.origin - rotation @ shift, fit.determined), _path(chain, s)
    return None, []


def _or_straight(angles: Array, straight: Array, known: BoolArray) -> Array:
    """(nf, n) the angles, or those with the straight joint for the whole trial if in any known frame they are apart."""
    apart = np.abs(np.angle(np.exp(1j * (angles - straight)[known])))
    return straight if (apart > BELIEVED).any() else angles


def _straight(constants: ChainConstants, own: list[int]) -> Array:
    """(3, 3) turn of a joint whose coordinates are zero."""
    out = np.eye(3)
    for k in own:
        out = out @ constants.offset_rotation[k]
    return out


def _local_centre(constants: ChainConstants, segment: int) -> Array:
    """(3,) m, where the frame before a segment has its origin, in the segment."""
    out: Array = -constants.segment_rotation[segment].T @ constants.segment_translation[segment]
    return out


class _SoFar:
    """Frames of the coordinates that are settled already, worked out when asked for."""

    def __init__(self, chain: Chain, constants: ChainConstants, q: Array) -> None:
        self.chain, self.constants, self.q = chain, constants, q
        self._rotations: dict[int, Array] = {-1: np.broadcast_to(np.eye(3), (len(q), 3, 3))}
        self._origins: dict[int, Array] = {-1: np.zeros((len(q), 3))}

    def rotation(self, k: int) -> Array:
        """(nf, 3, 3) of the frame of coordinate k."""
        if k not in self._rotations:
            rotation = self.rotation(self.chain.parents[k])
            if not self.constants.plain_offsets[0][k]:
                rotation = rotation @ self.constants.offset_rotation[k]
            e = self.chain.elements[k]
            self._rotations[k] = _turned(rotation, e.axis, e.sign * self.q[:, k]) if e.rotates else rotation
        return self._rotations[k]

    def centre(self, own: list[int]) -> Array:
        """(nf, 3) m, where the first turn of a joint takes place."""
        parent, k = self.chain.parents[own[0]], own[0]
        out: Array = self._origin(parent) + self.rotation(parent) @ self.constants.offset_translation[k]
        return out

    def _origin(self, k: int) -> Array:
        if k not in self._origins:
            parent, e = self.chain.parents[k], self.chain.elements[k]
            origin = self._origin(parent) + self.rotation(parent) @ self.constants.offset_translation[k]
            if not e.rotates:
                origin = origin + self.rotation(k)[:, :, e.axis] * (e.sign * self.q[:, k, None])
            self._origins[k] = origin
        return self._origins[k]


def _carries_more(chain: Chain, segment: int) -> bool:
    """Whether other segments hang on this one: then a segment without markers leaves its turns to them."""
    frame = chain.segment_frame[segment]
    return bool((chain.support[frame] > 0).sum() > 1)


def _path(chain: Chain, segment: int) -> list[int]:
    path, k = [], int(chain.segment_frame[segment])
    while k >= 0:
        path.append(k)
        k = chain.parents[k]
    return path[::-1]


def _root_coordinates(fit: RigidFit) -> Array:
    """(nf, 6) from R = Rz(tilt) Rx(list) Ry(rotation)."""
    angles = root_angles(fit.rotation)
    return np.hstack([_fill(fit.origin, fit.determined), _fill(_unwrap(angles, fit.determined), fit.determined)])


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
    return np.stack([np.interp(frames, frames[known], column[known]) for column in values.T], axis=1)


def _turned(rotation: Array, axis: int, angle: Array) -> Array:
    """(nf, 3, 3) rotation @ R_axis(angle)."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out = rotation.copy()
    out[:, :, a] = c * rotation[:, :, a] + s * rotation[:, :, b]
    out[:, :, b] = c * rotation[:, :, b] - s * rotation[:, :, a]
    return out


def _turns(chain: Chain, constants: ChainConstants, own: list[int], target: Array) -> Array:
    """(nf, n) coordinates whose turns, one after the other, come nearest to the matrices `target` (nf, 3, 3)."""
    axes = [chain.elements[k].axis for k in own]
    plain = [constants.plain_offsets[0][k] for k in own]
    if axes == [2, 0, 1] and all(plain[1:]):
        first = target if plain[0] else constants.offset_rotation[own[0]].T @ target
        angles = root_angles(first)
    else:
        angles = _swept(constants, own, axes, target)
    signs = np.array([chain.elements[k].sign for k in own])
    out: Array = angles * signs
    return out


def _swept(constants: ChainConstants, own: list[int], axes: list[int], target: Array) -> Array:
    angles = np.zeros((len(target), len(own)))
    for _ in range(SWEEPS if len(own) > 1 else 1):
        # left-hand sides are peeled off as they are settled, right-hand sides kept from the last sweep
        after: list[Array] = []
        for i in range(len(own) - 1, 0, -1):
            inner = _turned(np.broadcast_to(constants.offset_rotation[own[i]], target.shape), axes[i], angles[:, i])
            after.append(inner @ after[-1] if after else inner)
        remaining = target
        for i, k in enumerate(own):
            if not constants.plain_offsets[0][k]:
                remaining = constants.offset_rotation[k].T @ remaining
            last = i + 1 == len(own)
            g = remaining if last else remaining @ after[len(own) - 2 - i].transpose(0, 2, 1)
            b, c = (axes[i] + 1) % 3, (axes[i] + 2) % 3
            angles[:, i] = np.arctan2(g[:, c, b] - g[:, b, c], g[:, b, b] + g[:, c, c])
            if not last:
                remaining = _turned(remaining.transpose(0, 2, 1), axes[i], angles[:, i]).transpose(0, 2, 1)
    return angles
