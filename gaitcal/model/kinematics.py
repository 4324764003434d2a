"""Kinematics of a linkage in all frames: segment placements and Jacobian columns.

    R_s(t), o_s(t)      axes and origin of segment s in the laboratory,
    J_k(t) = [v; w]     spatial velocity about the laboratory origin per unit of variable k,

as `pin.computeJointJacobians` gives them: a rotation about the unit axis a through the point c is
[c x a; a], a translation along a is [a; 0]. Pinocchio works on one frame at a time, and a call for
every frame takes three times as long as the same passes over all frames at once. So Pinocchio
places the model at rest, with its coordinates at zero. From this each joint that moves in time has
its place on the one before it, and segments and free joint parameters theirs on the last one.

The frame index is the last one here, so that what follows is one pass over contiguous memory. A
variable of a secondary motion (`tracking/soft_tissue.py`) has the column of the joint that it
moves, times d amount / d variable.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import groupby

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray, stretches
from gaitcal.model import linkage
from gaitcal.model.chain import Chain, LinkageModel, get_chain
from gaitcal.model.parameters import Parameters

BLOCK = 512
"""Frames at a time: bounds the memory for all joints of a long recording."""


@dataclass(frozen=True, kw_only=True)
class SecondaryMotion:
    """Motions of joints besides their coordinates (`linkage.SECONDARY`), in all frames."""

    amounts: dict[str, Array]
    """Coordinate -> (4, nf) m, rad: translations along x and y, then rotations about x and y."""
    regressors: dict[str, tuple[Array, Array]]
    """Coordinate -> (nf,) of each of `BENDS`: d amount / d variable."""

    def frames(self, part: slice | IntArray) -> "SecondaryMotion":
        """Select some frames."""
        return SecondaryMotion(
            amounts={name: values[:, part] for name, values in self.amounts.items()},
            regressors={name: (a[part], b[part]) for name, (a, b) in self.regressors.items()},
        )


@dataclass(frozen=True, kw_only=True)
class _Order:
    """Order in which the joints of a chain are placed, and the base of each segment."""

    moving: IntArray
    """(nm,) their entries in configurations."""
    still: IntArray
    """Entries of all others."""
    rows: IntArray
    """(nv, 4) rows of a placement in the order used here: axis of the joint, the two after it,
    origin.
    """
    slides: BoolArray
    """(n,) whether a variable translates."""
    variables: IntArray
    """(n,) place of the joint of each variable among the moving ones and then the others."""
    base: IntArray
    """(nv,) last moving joint before each joint, counted from 1; 0: the ground."""
    segment_base: IntArray
    """(ns,) last moving joint before each segment, likewise."""
    levels: list[tuple[slice, bool, slice | IntArray]]
    """Joints that do not depend on each other, whether they rotate, and the joints above them."""


@lru_cache(maxsize=64)
def _order_of(chain: Chain) -> _Order:
    """Sort the joints of a chain by their depth in the linkage."""
    turns = np.array([chain.elements[name].rotates for name in chain.joints])
    axis = np.array([chain.elements[name].axis for name in chain.joints])
    free = np.concatenate(
        [chain.at_coordinates, *(np.array(at) for at in chain.at_secondary.values())]
    )
    depth = chain.after[:, free].sum(axis=1)
    moving = np.array(sorted(free.tolist(), key=lambda k: (depth[k], turns[k])), dtype=np.intp)
    still = np.setdiff1d(np.arange(len(turns)), moving)
    # of every joint, the moving ones on the way to it, counted from 1
    passed = chain.after[:, moving] * np.arange(1, len(moving) + 1)
    base = (passed * (np.arange(len(turns))[:, None] != moving)).max(axis=1)
    levels, start = list[tuple[slice, bool, slice | IntArray]](), 0
    for (_, turning), members in groupby(moving.tolist(), key=lambda k: (depth[k], turns[k])):
        on = base[list(members)]
        run = slice(int(on[0]), int(on[-1]) + 1)
        levels.append(
            (slice(start, start + len(on)), bool(turning), run if (np.diff(on) == 1).all() else on)
        )
        start += len(on)
    return _Order(
        moving=moving,
        still=still,
        rows=np.column_stack([axis, (axis + 1) % 3, (axis + 2) % 3, np.full(len(axis), 3)]),
        slides=~turns[chain.at_variables],
        variables=np.argsort(np.concatenate([moving, still]))[chain.at_variables],
        base=base,
        segment_base=passed[chain.segment_joint - 1].max(axis=1),
        levels=levels,
    )


@lru_cache(maxsize=64)
def _compute_offsets(body: LinkageModel) -> tuple[Array, Array, Array]:
    """Compute placements relative to the bases.

    Returns moving joints (nm, 4, 3), axes and origins of the others (., 2, 3), segments (ns, 4, 3).
    """
    order = _order_of(body.chain)
    joints, segments = body.rest
    turned = joints[np.arange(1, len(joints))[:, None], order.rows]
    bases = np.concatenate([np.eye(4, 3)[None], turned[order.moving]])

    def on(placed: Array, base: IntArray) -> Array:
        from_base = placed.copy()
        from_base[:, -1] -= bases[base, 3]
        return np.asarray(from_base @ bases[base, :3].transpose(0, 2, 1))

    return (
        on(turned[order.moving], order.base[order.moving]),
        on(turned[order.still, ::3], order.base[order.still]),
        on(segments, order.segment_base),
    )


def _place_on_bases(local: Array, on: Array, out: Array | None = None) -> Array:
    """Place rows of axes and an origin (n, r, 3) on bases (n, 4, 3, nf): (n, r, 3, nf)."""
    count, rows, width = *local.shape[:2], on.shape[3]
    flat = None if out is None else out.reshape(count, rows, 3 * width)
    placed = np.matmul(local, on[:, :3].reshape(count, 3, 3 * width), out=flat).reshape(
        count, rows, 3, width
    )
    placed[:, -1] += on[:, 3]
    return placed


def _place_moving(body: LinkageModel, values: Array) -> Array:
    """Place the moving joints, the ground first, at their values (nm, nf): (nm + 1, 4, 3, nf), rows
    as in `_Order`.
    """
    local, _, _ = _compute_offsets(body)
    cos, sin = np.cos(values), np.sin(values)
    sines = np.stack([sin, -sin], axis=1)
    frames = np.empty((len(values) + 1, 4, 3, values.shape[1]))
    frames[0] = np.eye(4, 3)[:, :, None]
    for level, turning, on in _order_of(body.chain).levels:
        placed = _place_on_bases(local[level], frames[on], frames[1:][level])
        if turning:
            across = placed[:, 1:3]
            turned = across * cos[level, None, None]
            turned += across[:, ::-1] * sines[level, :, None]
            across[...] = turned
        else:
            placed[:, 3] += placed[:, 0] * values[level, None]
    return frames


class Kinematics:
    """A linkage in all frames of a motion.

    Parameters
    ----------
    body : the linkage with its parameters.
    q : (nf, nq) coordinates, m and rad.
    secondary : prescribed motions of the knees; the body must have joints for them.
    columns : whether Jacobian columns are wanted.

    Attributes
    ----------
    segments : (ns, 4, 3, nf) axes x, y, z of each segment and its origin (m), laboratory.
    columns : (n, 6, nf) [v; w] about the laboratory origin per unit of each variable of the chain.
    """

    def __init__(
        self,
        body: LinkageModel,
        q: Array,
        secondary: SecondaryMotion | None = None,
        *,
        columns: bool = True,
    ) -> None:
        chain, nf = body.chain, len(q)
        if secondary is None and any(name in linkage.SECONDARY_VARIABLES for name in chain.free):
            raise ValueError(
                "free variables of secondary motions need the motions that they are of"
            )
        self.chain = chain
        self.segments = np.empty((len(chain.segments), 4, 3, nf))
        self.columns = np.empty((len(chain.at_variables), 6, nf) if columns else (0, 6, nf))
        order = _order_of(chain)
        _, of_still, of_segments = _compute_offsets(body)
        for part in stretches(nf, BLOCK):
            values = body.fill_configurations(q[part])
            if secondary is not None:
                for name, joints in chain.at_secondary.items():
                    # not of a knee that no marker shows
                    if name in secondary.amounts:
                        values[:, joints] = secondary.amounts[name][:, part].T
            frames = _place_moving(body, np.ascontiguousarray(values[:, order.moving].T))
            self.segments[..., part] = _place_on_bases(of_segments, frames[order.segment_base])
            if columns:
                still = _place_on_bases(of_still, frames[order.base[order.still]])
                lines = np.concatenate([frames[1:, ::3], still])[order.variables]
                self.columns[..., part] = _compute_columns(lines[:, 0], lines[:, 1], order.slides)
        if columns and secondary is not None:
            for k, name in enumerate(chain.variables):
                if name in linkage.SECONDARY_VARIABLES:
                    coordinate, _, bend = linkage.SECONDARY_VARIABLES[name]
                    self.columns[k] *= secondary.regressors[coordinate][bend]

    @property
    def axes(self) -> Array:
        """(ns, 3, 3, nf): axis j of segment s in [s, j]."""
        return self.segments[:, :3]

    @property
    def origins(self) -> Array:
        """(ns, 3, nf) m."""
        return self.segments[:, 3]

    @cached_property
    def columns_by_frame(self) -> Array:
        """(nf, n, 6) the same as `columns`, frames first."""
        return np.ascontiguousarray(self.columns.transpose(2, 0, 1))

    @cached_property
    def segments_by_frame(self) -> Array:
        """(nf, ns, 4, 3) the same as `segments`, frames first."""
        return np.ascontiguousarray(self.segments.transpose(3, 0, 1, 2))

    def axis(self, name: str) -> Array:
        """Get the axis (nf, 3) about which a variable rotates all that is distal to it."""
        return self.columns_by_frame[:, self.chain.variables.index(name), 3:]

    def frame(self, segment: str) -> Array:
        """Get the axes (nf, 3, 3) of a segment in the laboratory, one a row."""
        return self.segments_by_frame[:, self.chain.segments.index(segment), :3]

    def moves(self, segment: str) -> BoolArray:
        """Get which of the n variables move a segment: (n,) bool."""
        return np.asarray(self.chain.support[:, self.chain.segments.index(segment)] > 0)


def _compute_columns(axes: Array, points: Array, slides: BoolArray) -> Array:
    """Compute Jacobian columns (n, 6, nf) of joints with axes and points (n, 3, nf)."""
    out = np.empty((len(axes), 6, axes.shape[2]))
    out[:, 3:] = axes
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(points[:, j], axes[:, k], out=out[:, i])
        out[:, i] -= points[:, k] * axes[:, j]
    out[slides, :3], out[slides, 3:] = axes[slides], 0.0
    return out


def compute_coordinate_axes(body: LinkageModel, q: Array) -> tuple[Array, Array]:
    """Compute the axes of the coordinates.

    Parameters
    ----------
    body : LinkageModel
        The linkage with its parameters.
    q : (nf, nq) array
        Coordinates, m and rad.

    Returns
    -------
    tuple of (nf, nq, 3) array
        Unit axes that positive values move along or about, and the origins (m) of the joints'
        frames on them; laboratory.
    """
    order = _order_of(body.chain)
    frames = _place_moving(body, body.fill_configurations(q)[:, order.moving].T)
    lines = frames[1 + order.variables[: q.shape[1]], ::3].transpose(3, 1, 0, 2)
    return lines[:, 0], lines[:, 1]


def compute_body_poses(
    parameters: Parameters, q: Array
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Compute the poses of all segments of the whole body.

    Parameters
    ----------
    parameters : Parameters
        Parameters of the linkage.
    q : (nf, nq) array
        Coordinates, m and rad.

    Returns
    -------
    tuple of dict
        Segment -> axes (3, 3, nf), one a row, and segment -> origin (3, nf), m; laboratory.
    """
    chain = get_chain()
    found = Kinematics(chain.body(parameters), q, columns=False)
    return (
        dict(zip(chain.segments, found.axes, strict=True)),
        dict(zip(chain.segments, found.origins, strict=True)),
    )
