"""The linkage, compiled: one moving frame per coordinate, with everything constant in time folded away.

Between two coordinates the chain is constant in time, however many joint parameters it passes, so a trial of many
frames needs one frame per *coordinate* only. Frame k has the pose

    X_k(t) = X_parent(t) C_k M_k(q_k(t)),

C_k constant, M_k the elementary motion of coordinate k. A segment, and the axis of a joint parameter, are constants
in the frame of the coordinate before them: X_segment = X_b D_s; a joint parameter moves all that comes after it along
(or about) the axis a_p through the point c_p of frame b. These constants depend on the joint parameters alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import cos, sin

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.linkage import (
    BENDS,
    JOINTS,
    SECONDARY,
    SEGMENTS,
    ZERO_ANGLES,
    Element,
    Source,
    joint_elements,
    root_elements,
)


@dataclass(frozen=True)
class _Step:
    """One element in its place: which frame it is constant in, and what it acts on."""

    element: Element
    source: int
    """Index of the coordinate, joint parameter or zero angle."""


@dataclass(frozen=True, kw_only=True)
class ChainConstants:
    """What the joint parameters fix. Rotations as 3 x 3, lengths in m."""

    offset_rotation: Array
    """(nq, 3, 3) rotation of C_k."""
    offset_translation: Array
    """(nq, 3) translation of C_k."""
    segment_rotation: Array
    """(ns, 3, 3) rotation of D_s."""
    segment_translation: Array
    """(ns, 3) translation of D_s."""
    parameter_axis: Array
    """(np, 3) a_p, with the sign of the element."""
    parameter_point: Array
    """(np, 3) c_p."""

    def without_parameters(self) -> ChainConstants:
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

    Parameters
    ----------
    root : segment that is free in the laboratory (six coordinates).
    segments : the segments of the part, root included.
    free : names of the joint parameters whose derivatives are wanted, and of secondary motions (of
        `SECONDARY`, with one of `BENDS`); those the part does not pass are left out.
    reactions : whether the knees carry their locked reaction joints (two more coordinates).
    """

    def __init__(
        self,
        root: str = "pelvis",
        segments: tuple[str, ...] = SEGMENTS,
        free: tuple[str, ...] = (),
        *,
        reactions: bool = False,
    ) -> None:
        self.root = root
        self.segments = tuple(s for s in SEGMENTS if s in segments)
        coordinates: list[str] = []
        elements: list[Element] = []
        parents: list[int] = []
        self._walks: dict[str, tuple[int, list[_Step]]] = {}
        """Per segment: the frame it hangs on, and the constant steps from there."""
        self._before: list[list[_Step]] = []
        """Per coordinate: the constant steps between it and the coordinate before."""
        passed: dict[str, tuple[int, list[_Step]]] = {}
        """Per free joint parameter: the frame it is constant in, and the steps from there up to itself."""
        ancestors: dict[str, tuple[set[int], set[str]]] = {}
        """Per segment: the coordinates and the free joint parameters that move it."""

        def walk(sequence: tuple[Element, ...], start: str | None, child: str) -> None:
            # `pending` gathers constant steps until a coordinate makes a new frame of them. Lists are built anew, not
            # extended: the walks of all children begin with that of their parent.
            if start is None:
                frame, pending, above = -1, [], (set[int](), set[str]())
            else:
                frame, before = self._walks[start]
                pending, above = list(before), (set(ancestors[start][0]), set(ancestors[start][1]))
            for e in sequence:
                if e.source is Source.COORDINATE:
                    for second in SECONDARY.get(e.name, ()):
                        for name in (second.name + bend for bend in BENDS if second.name + bend in free):
                            passed[name] = (frame, [*pending, _Step(second, len(coordinates))])
                            above[1].add(name)
                    coordinates.append(e.name)
                    elements.append(e)
                    parents.append(frame)
                    self._before.append(pending)
                    frame, pending = len(coordinates) - 1, []
                    above[0].add(frame)
                    continue
                index = JP_INDEX[e.name] if e.source is Source.JOINT_PARAMETER else ZERO_ANGLES.index(e.name)
                step = _Step(e, index)
                if e.name in free:
                    passed[e.name] = (frame, [*pending, step])
                    above[1].add(e.name)
                pending = [*pending, step]
            self._walks[child] = (frame, pending)
            ancestors[child] = above

        walk(root_elements(root), None, root)
        for joint in JOINTS:
            if joint.child in self.segments and joint.child != root:
                walk(joint_elements(joint, reactions=reactions), joint.parent, joint.child)

        self.coordinates: tuple[str, ...] = tuple(coordinates)
        self.elements: tuple[Element, ...] = tuple(elements)
        self.parents: tuple[int, ...] = tuple(parents)
        self.free: tuple[str, ...] = tuple(name for name in free if name in passed)
        self._passed = [passed[name] for name in self.free]
        self.secondary: tuple[tuple[int, int, Element, int], ...] = tuple(
            (k, steps[-1].source, steps[-1].element, BENDS.index(name[-len(BENDS[0]) :]))
            for k, (name, (_, steps)) in enumerate(zip(self.free, self._passed, strict=True))
            if steps[-1].element.source is Source.COORDINATE
        )
        """Of every free secondary motion: place in `free`, frame of its coordinate, element, index in `BENDS`."""
        self.segment_frame: IntArray = np.array([self._walks[s][0] for s in self.segments], dtype=np.intp)
        self.parameter_frame: IntArray = np.array([frame for frame, _ in self._passed], dtype=np.intp)
        self.parameter_rotates: BoolArray = np.array([w[-1].element.rotates for _, w in self._passed], bool)
        self.coordinate_rotates: BoolArray = np.array([e.rotates for e in self.elements], bool)
        self.coordinate_axis: IntArray = np.array([e.axis for e in self.elements], dtype=np.intp)
        self.coordinate_slides: IntArray = np.flatnonzero(~self.coordinate_rotates)
        self.parameter_slides: IntArray = np.flatnonzero(~self.parameter_rotates)
        self.reversed_coordinates: tuple[int, ...] = tuple(k for k, e in enumerate(self.elements) if e.sign < 0)
        nq, n_free = len(coordinates), len(self.free)
        support = np.zeros((nq + n_free, len(self.segments)))
        for column, segment in enumerate(self.segments):
            frames, names = ancestors[segment]
            support[list(frames), column] = 1.0
            for k, name in enumerate(self.free):
                support[nq + k, column] = float(name in names)
        self.support: Array = support
        """(nq + np, ns): 1 where a coordinate or a free joint parameter moves a segment."""
        self.moved_sets, self.moved_set = _distinct_rows(support)
        """(n, ns) the distinct rows of `support`, and (nq + np,) which of them each variable has."""

    def constants(self, joint: Array, zero_angles: Array) -> ChainConstants:
        """The constants for joint parameters (np,) and zero angles (4,), in m and rad."""
        offsets = [_compose(steps, joint, zero_angles) for steps in self._before]
        places = [_compose(self._walks[s][1], joint, zero_angles) for s in self.segments]
        axes, points = np.empty((len(self.free), 3)), np.empty((len(self.free), 3))
        for k, (_, steps) in enumerate(self._passed):
            rotation, translation = _compose(steps[:-1], joint, zero_angles)
            axes[k] = steps[-1].element.sign * rotation[:, steps[-1].element.axis]
            points[k] = translation
        return ChainConstants(
            offset_rotation=np.array([rotation for rotation, _ in offsets]),
            offset_translation=np.array([translation for _, translation in offsets]),
            segment_rotation=np.array([rotation for rotation, _ in places]),
            segment_translation=np.array([translation for _, translation in places]),
            parameter_axis=axes,
            parameter_point=points,
        )


@lru_cache(maxsize=64)
def chain_of(
    root: str = "pelvis", segments: tuple[str, ...] = SEGMENTS, free: tuple[str, ...] = (), *, reactions: bool = False
) -> Chain:
    """The chain of a part of the linkage, compiled once: every trial of a person has the same."""
    return Chain(root, segments, free, reactions=reactions)


def _distinct_rows(support: Array) -> tuple[Array, IntArray]:
    rows, row_of = np.unique(support, axis=0, return_inverse=True)
    return rows, row_of.ravel()


def _compose(steps: list[_Step], joint: Array, zero_angles: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of constant steps one after the other."""
    # in plain floats: these chains of single 3 x 3 products are what NumPy is slowest at
    axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    x = [0.0, 0.0, 0.0]
    for step in steps:
        e = step.element
        amount = e.sign * float((joint if e.source is Source.JOINT_PARAMETER else zero_angles)[step.source])
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
    """(nf, 3) a, b, c of rotations (nf, 3, 3) Rz(a) Rx(b) Ry(c): tilt, list and rotation of a root segment."""
    angles = (
        np.arctan2(-r[:, 0, 1], r[:, 1, 1]),
        np.arcsin(np.clip(r[:, 2, 1], -1.0, 1.0)),
        np.arctan2(-r[:, 2, 0], r[:, 2, 2]),
    )
    return np.stack(angles, axis=1)
