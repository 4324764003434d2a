"""The linkage, compiled: one moving frame per coordinate, with everything constant in time folded away.

Between two coordinates the chain is constant in time, however many joint parameters it passes, so a trial of many
frames needs one frame per *coordinate* only. Frame k has the pose

    X_k(t) = X_parent(t) C_k M_k(q_k(t)),

C_k constant, M_k the elementary motion of coordinate k. A segment, and the axis of a joint parameter, are constants
in the frame of the coordinate before them: X_segment = X_b D_s; a joint parameter moves all that comes after it along
(or about) the axis a_p through the point c_p of frame b. These constants depend on the joint parameters alone.

Kinematics are for all frames at once, the frame index last, so that each elementary operation is one pass over
contiguous memory. Poses are the three axis vectors of a frame and its origin, in the laboratory; the columns of the
Jacobian are spatial velocities **about the laboratory origin** [v; w]: a turn about the unit axis a through the point
c is [c x a; a], a slide along a is [a; 0]. They agree with Pinocchio's `computeJointJacobians` (tested).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import cos, sin
from typing import NamedTuple

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model import linkage
from gaitcal.model.parameters import JP_INDEX, Parameters


class _Step(NamedTuple):
    """One element in its place: which frame it is constant in, and what it acts on."""

    element: linkage.Element
    source: int  # index of the coordinate, joint parameter or zero angle


@dataclass(frozen=True, kw_only=True)
class ChainConstants:
    """What the joint parameters fix. Rotations as 3 x 3, lengths in m."""

    offset_rotation: Array  # (nq, 3, 3) rotation of C_k
    offset_translation: Array  # (nq, 3) translation of C_k
    segment_rotation: Array  # (ns, 3, 3) rotation of D_s
    segment_translation: Array  # (ns, 3) translation of D_s
    parameter_axis: Array  # (np, 3) a_p, with the sign of the element
    parameter_point: Array  # (np, 3) c_p

    def without_parameters(self) -> "ChainConstants":
        """The constants of the same chain with no joint parameter free."""
        return replace(self, parameter_axis=np.empty((0, 3)), parameter_point=np.empty((0, 3)))

    @cached_property
    def plain_offsets(self) -> tuple[list[bool], list[bool]]:
        """Per coordinate: whether C_k does not turn, and whether it does not shift."""
        plain = (self.offset_rotation == np.eye(3)).all(axis=(1, 2))
        return plain.tolist(), (self.offset_translation == 0.0).all(axis=1).tolist()

    @cached_property
    def segment_placement(self) -> Array:
        """(ns, 4, 3) axes and origin of each segment, in the frame it hangs on."""
        return np.concatenate([self.segment_rotation.transpose(0, 2, 1), self.segment_translation[:, None]], axis=1)

    @cached_property
    def parameter_placement(self) -> Array:
        """(np, 2, 3) a_p and c_p."""
        return np.stack([self.parameter_axis, self.parameter_point], axis=1)


class Chain:
    """A part of the linkage below a root segment, with the joint parameters of interest marked.

    `root`: segment that is free in the laboratory (six coordinates).
    `segments`: the segments of the part, root included.
    `free`: names of the joint parameters whose derivatives are wanted, and of secondary motions (of `SECONDARY`, with
    one of `BENDS`); those the part does not pass are left out.
    `reactions`: whether the knees carry their locked reaction joints (two more coordinates).
    """

    def __init__(
        self,
        root: str = "pelvis",
        segments: tuple[str, ...] = linkage.SEGMENTS,
        free: tuple[str, ...] = (),
        *,
        reactions: bool = False,
    ) -> None:
        self.root = root
        self.segments = tuple(s for s in linkage.SEGMENTS if s in segments)
        elements: list[linkage.Element] = []
        parents: list[int] = []
        # per segment, the frame it hangs on and the constant steps from there; per coordinate, those before it
        self._walks: dict[str, tuple[int, list[_Step]]] = {"": (-1, [])}
        self._before: list[list[_Step]] = []
        # per free joint parameter, the frame it is constant in and the steps from there up to itself
        passed: dict[str, tuple[int, list[_Step]]] = {}
        moved_by: dict[str, set[str]] = {"": set()}  # per segment, the coordinates and free joint parameters
        walks = [(linkage.root_elements(root), "", root)]
        walks += [
            (linkage.joint_elements(joint, reactions=reactions), joint.parent, joint.child)
            for joint in linkage.JOINTS
            if joint.child in self.segments and joint.child != root
        ]
        for sequence, parent, child in walks:
            # `pending` gathers constant steps until a coordinate makes a new frame of them. Lists are built anew, not
            # extended: the walks of all children begin with that of their parent.
            (frame, pending), above = self._walks[parent], set(moved_by[parent])
            for e in sequence:
                if e.source is linkage.Source.COORDINATE:
                    for second in linkage.SECONDARY.get(e.name, ()):
                        for name in (second.name + bend for bend in linkage.BENDS if second.name + bend in free):
                            passed[name] = (frame, [*pending, _Step(second, len(elements))])
                            above.add(name)
                    self._before.append(pending)
                    elements.append(e)
                    parents.append(frame)
                    frame, pending = len(elements) - 1, []
                    above.add(e.name)
                    continue
                index = (
                    JP_INDEX[e.name]
                    if e.source is linkage.Source.JOINT_PARAMETER
                    else linkage.ZERO_ANGLES.index(e.name)
                )
                pending = [*pending, _Step(e, index)]
                if e.name in free:
                    passed[e.name] = (frame, pending)
                    above.add(e.name)
            self._walks[child], moved_by[child] = (frame, pending), above

        self.coordinates: tuple[str, ...] = tuple(e.name for e in elements)
        self.elements: tuple[linkage.Element, ...] = tuple(elements)
        self.parents: tuple[int, ...] = tuple(parents)
        self.free: tuple[str, ...] = tuple(name for name in free if name in passed)
        self._passed = [passed[name] for name in self.free]
        self.secondary: tuple[tuple[int, int, linkage.Element, int], ...] = tuple(
            (k, steps[-1].source, steps[-1].element, linkage.BENDS.index(name[-len(linkage.BENDS[0]) :]))
            for k, (name, (_, steps)) in enumerate(zip(self.free, self._passed, strict=True))
            if steps[-1].element.source is linkage.Source.COORDINATE
        )
        # of every free secondary motion: place in `free`, frame of its coordinate, element, index in `BENDS`
        self.segment_frame: IntArray = np.array([self._walks[s][0] for s in self.segments], dtype=np.intp)
        self.parameter_frame: IntArray = np.array([frame for frame, _ in self._passed], dtype=np.intp)
        self.parameter_rotates: BoolArray = np.array([w[-1].element.rotates for _, w in self._passed], bool)
        self.coordinate_rotates: BoolArray = np.array([e.rotates for e in self.elements], bool)
        self.coordinate_axis: IntArray = np.array([e.axis for e in self.elements], dtype=np.intp)
        self.coordinate_slides: IntArray = np.flatnonzero(~self.coordinate_rotates)
        self.parameter_slides: IntArray = np.flatnonzero(~self.parameter_rotates)
        self.reversed_coordinates: tuple[int, ...] = tuple(k for k, e in enumerate(self.elements) if e.sign < 0)
        names = (*self.coordinates, *self.free)
        self.support: Array = np.array([[float(name in moved_by[s]) for s in self.segments] for name in names])
        """(nq + np, ns): 1 where a coordinate or a free joint parameter moves a segment."""
        self.moved_sets, row_of = np.unique(self.support, axis=0, return_inverse=True)
        self.moved_set: IntArray = row_of.ravel()
        """(n, ns) the distinct rows of `support`, and (nq + np,) which of them each variable has."""

    def constants(self, joint: Array, zero_angles: Array) -> ChainConstants:
        """The constants for joint parameters (np,) and zero angles (4,), in m and rad."""
        offsets = [_compose(steps, joint, zero_angles) for steps in self._before]
        places = [_compose(self._walks[s][1], joint, zero_angles) for s in self.segments]
        ahead = [(_compose(steps[:-1], joint, zero_angles), steps[-1].element) for _, steps in self._passed]
        return ChainConstants(
            offset_rotation=np.array([rotation for rotation, _ in offsets]),
            offset_translation=np.array([translation for _, translation in offsets]),
            segment_rotation=np.array([rotation for rotation, _ in places]),
            segment_translation=np.array([translation for _, translation in places]),
            parameter_axis=np.array([e.sign * rotation[:, e.axis] for (rotation, _), e in ahead]).reshape(-1, 3),
            parameter_point=np.array([translation for (_, translation), _ in ahead]).reshape(-1, 3),
        )


@lru_cache(maxsize=64)
def chain_of(
    root: str = "pelvis",
    segments: tuple[str, ...] = linkage.SEGMENTS,
    free: tuple[str, ...] = (),
    *,
    reactions: bool = False,
) -> Chain:
    """The chain of a part of the linkage, compiled once: every trial of a person has the same."""
    return Chain(root, segments, free, reactions=reactions)


def _compose(steps: list[_Step], joint: Array, zero_angles: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of constant steps one after the other."""
    # in plain floats: these chains of single 3 x 3 products are what NumPy is slowest at
    axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    x = [0.0, 0.0, 0.0]
    for step in steps:
        e = step.element
        amount = e.sign * float((joint if e.source is linkage.Source.JOINT_PARAMETER else zero_angles)[step.source])
        if not e.rotates:
            u = axes[e.axis]
            x = [x[0] + u[0] * amount, x[1] + u[1] * amount, x[2] + u[2] * amount]
        elif amount != 0.0:
            c, s = cos(amount), sin(amount)
            a, b = (e.axis + 1) % 3, (e.axis + 2) % 3
            u, v = axes[a], axes[b]
            axes[a] = [c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2]]
            axes[b] = [c * v[0] - s * u[0], c * v[1] - s * u[1], c * v[2] - s * u[2]]
    return np.array(axes).T, np.array(x)


def axis_rotation(axis: int, angle: float) -> Array:
    """(3, 3) right-handed rotation by `angle` (rad) about coordinate axis 0, 1 or 2."""
    c, s = np.cos(angle), np.sin(angle)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[a, a] = rotation[b, b] = c
    rotation[a, b], rotation[b, a] = -s, s
    return rotation


def root_angles(r: Array) -> Array:
    """(..., 3) a, b, c of rotations (..., 3, 3) Rz(a) Rx(b) Ry(c): tilt, list and rotation of a root segment."""
    angles = (
        np.arctan2(-r[..., 0, 1], r[..., 1, 1]),
        np.arcsin(np.clip(r[..., 2, 1], -1.0, 1.0)),
        np.arctan2(-r[..., 2, 0], r[..., 2, 2]),
    )
    return np.stack(angles, axis=-1)


@dataclass(frozen=True)
class Poses:
    """Poses of the moving frames of a chain."""

    axes: Array  # (nq, 3, 3, nf): axes[k, j] is the j-th unit axis of frame k in the laboratory
    origins: Array  # (nq, 3, nf) m
    secondary_axes: dict[int, Array] = field(default_factory=dict)
    """Frame -> (3, nf) y about which the last of its joint's secondary motions turns."""


@dataclass(frozen=True, kw_only=True)
class SecondaryMotion:
    """What joints do besides moving along their coordinates (`linkage.SECONDARY`)."""

    amounts: dict[str, Array]
    """Coordinate -> (4, nf) m, rad: slides along x and y, then turns about x and y, before the coordinate moves."""
    regressors: dict[str, tuple[Array, Array]]  # coordinate -> (nf,) of each of `BENDS`: d amount / d variable

    def frames(self, part: slice | IntArray) -> "SecondaryMotion":
        """The same for some frames."""
        return SecondaryMotion(
            amounts={name: values[:, part] for name, values in self.amounts.items()},
            regressors={name: (a[part], b[part]) for name, (a, b) in self.regressors.items()},
        )


def forward(chain: Chain, constants: ChainConstants, q: Array, secondary: SecondaryMotion | None = None) -> Poses:
    """Poses of all moving frames for coordinates `q` (nf, nq), m and rad."""
    given, second = secondary.amounts if secondary else {}, dict[int, Array]()
    nf, nq = q.shape
    columns = np.ascontiguousarray(q.T)
    cos, sin = np.cos(columns), np.sin(columns)
    axes, origins = np.empty((nq, 3, 3, nf)), np.empty((nq, 3, nf))
    identity = np.zeros((3, 3, nf))
    identity[0, 0] = identity[1, 1] = identity[2, 2] = 1.0
    ground = np.zeros((3, nf))
    plain, still = constants.plain_offsets
    for k, (parent, e) in enumerate(zip(chain.parents, chain.elements, strict=True)):
        frame, origin = (identity, ground) if parent < 0 else (axes[parent], origins[parent])
        # X_k = X_parent C_k M_k. Axis vectors are rows here, so that C_k acts as R^T on (3, 3 nf); most C_k only shift,
        # and some do nothing, which saves a pass over all frames each.
        if still[k]:
            origins[k] = origin
        else:
            np.matmul(constants.offset_translation[k], frame.reshape(3, 3 * nf), out=origins[k].reshape(3 * nf))
            origins[k] += origin
        if not plain[k]:
            frame = np.matmul(constants.offset_rotation[k].T, frame.reshape(3, 3 * nf)).reshape(3, 3, nf)
        if (name := chain.coordinates[k]) in given:
            x, y, front, trans = given[name]
            origins[k] += frame[0] * x + frame[1] * y
            frame = _turned(frame, 0, np.cos(front), np.sin(front))
            second[k] = frame[1]
            frame = _turned(frame, 1, np.cos(trans), np.sin(trans))
        if not e.rotates:
            axes[k] = frame
            origins[k] += frame[e.axis] * (e.sign * columns[k])
            continue
        _turned(frame, e.axis, cos[k], sin[k] if e.sign > 0 else -sin[k], out=axes[k])
    return Poses(axes, origins, second)


def _turned(frame: Array, axis: int, c: Array, s: Array, out: Array | None = None) -> Array:
    """(3, 3, nf) axes of a frame after a right-handed turn about one of them, of cosine and sine (nf,)."""
    # it mixes the two others: a' = c a + s b, b' = c b - s a
    out, a, b = np.empty_like(frame) if out is None else out, (axis + 1) % 3, (axis + 2) % 3
    out[axis] = frame[axis]
    np.multiply(frame[a], c, out=out[a])
    out[a] += frame[b] * s
    np.multiply(frame[b], c, out=out[b])
    out[b] -= frame[a] * s
    return out


def segment_transforms(chain: Chain, constants: ChainConstants, poses: Poses) -> Array:
    """(ns, 4, 3, nf) segment poses: three axes and the origin (m) of each, in the laboratory."""
    frames = poses.axes[chain.segment_frame]
    ns, nf = len(chain.segments), frames.shape[-1]
    out: Array = np.matmul(constants.segment_placement, frames.reshape(ns, 3, 3 * nf)).reshape(ns, 4, 3, nf)
    out[:, 3] += poses.origins[chain.segment_frame]
    return out


def segment_poses(chain: Chain, constants: ChainConstants, poses: Poses) -> tuple[Array, Array]:
    """Segment axes (ns, 3, 3, nf) (axis j of segment s in [s, j]) and origins (ns, 3, nf), m."""
    both = segment_transforms(chain, constants, poses)
    return both[:, :3], both[:, 3]


def body_poses(parameters: Parameters, q: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    """Of the whole body at coordinates (nf, nq): segment -> axes (3, 3, nf), one a row, and origin (3, nf) m."""
    chain = chain_of()
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, q))
    return dict(zip(chain.segments, axes, strict=True)), dict(zip(chain.segments, origins, strict=True))


def jacobian(chain: Chain, constants: ChainConstants, poses: Poses, secondary: SecondaryMotion | None = None) -> Array:
    """(nq + np, 6, nf) spatial velocity [v; w] about the laboratory origin per unit of each coordinate and free JP, and
    of each free secondary motion, which must be given where one is free.
    """
    nq, n_free, nf = len(chain.coordinates), len(chain.free), poses.origins.shape[-1]
    out = np.empty((nq + n_free, 6, nf))
    axes = out[:nq, 3:]
    axes[...] = poses.axes[np.arange(nq), chain.coordinate_axis]
    for k in chain.reversed_coordinates:
        np.negative(axes[k], out=axes[k])
    _moments(out[:nq], poses.origins, chain.coordinate_slides)
    if n_free:
        frames = poses.axes[chain.parameter_frame].reshape(n_free, 3, 3 * nf)
        placed = np.matmul(constants.parameter_placement, frames).reshape(n_free, 2, 3, nf)
        out[nq:, 3:] = placed[:, 0]
        points = placed[:, 1]
        points += poses.origins[chain.parameter_frame]
        for k, frame, element, _ in chain.secondary if secondary else ():
            if element.rotates:
                points[k] = poses.origins[frame]  # after both slides
                if element.axis == 1:
                    out[nq + k, 3:] = poses.secondary_axes[frame]  # after the turn about x
        _moments(out[nq:], points, chain.parameter_slides)
        if secondary:
            for k, frame, _, bend in chain.secondary:
                out[nq + k] *= secondary.regressors[chain.coordinates[frame]][bend]
    return out


def _moments(columns: Array, points: Array, slides: IntArray) -> None:
    """Complete columns (n, 6, nf) whose lower half holds the axes: those that `slides` names move, the others turn."""
    slid = columns[slides, 3:]
    v, w = columns[:, :3], columns[:, 3:]
    # v = c x a, component by component: np.cross would make arrays of (n, 3, nf) twice over
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(points[:, j], w[:, k], out=v[:, i])
        v[:, i] -= points[:, k] * w[:, j]
    v[slides], w[slides] = slid, 0.0
