"""The linkage as a `pinocchio.Model`: the whole body or a part of it, with any joint parameters
free.

Every element of the linkage (`linkage.py`) is a joint of one degree of freedom here: coordinates,
joint parameters and zero angles alike, in one *open* model for each part of the body. Where their
values are known, `pin.buildReducedModel` locks the joint parameters and zero angles: they become
the joint placements of the *body*, a `LinkageModel`. A joint parameter that is left free stays a
joint, constant in time, whose coordinate is its value. Pinocchio's derivatives by it are those of
the joint parameter, and nothing is built anew when it changes.

Two more kinds of joints may be there. The *reactions* are locked: the generalised forces of these
joints are the knees' internal abduction moments. The *secondary motions* of the knees (`SECONDARY`)
are prescribed: they have amounts in every frame, which may depend on separate unknowns.
"""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model import linkage
from gaitcal.model.parameters import JP_INDEX, MASSIVE_SEGMENTS, Parameters, view_as_table
from gaitcal.model.subject_model import GRAVITY, SubjectModel
from gaitcal.runtime import with_one_blas_thread

_REVOLUTE = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
_PRISMATIC = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
HALF_TURNS = [np.diag(d) for d in ((-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0))]
"""Half turns that reverse the x, y and z axis. They are exact in floating point, so that a joint
about -x is a joint about x in a turned frame, which Pinocchio evaluates faster than any axis."""


@lru_cache(maxsize=64)
def _open_model(
    root: str, segments: tuple[str, ...], reactions: bool, secondary: bool
) -> tuple[pin.Model, dict[str, linkage.Element]]:
    """Build the model in which every element is a joint, named like the element; and these
    elements.
    """
    model = pin.Model()
    model.name = "gaitcal"
    model.gravity.linear = np.array([0.0, -GRAVITY, 0.0])
    elements: dict[str, linkage.Element] = {}
    # segment -> the joint that carries it, and its placement in the frame of that joint
    carrier: dict[str, tuple[int, pin.SE3]] = {"": (0, pin.SE3.Identity())}
    walks = [(linkage.make_root_elements(root), "", root)]
    for joint in linkage.JOINTS:
        if joint.child in segments and joint.child != root:
            walks.append(
                (linkage.list_joint_elements(joint, reactions=reactions), joint.parent, joint.child)
            )
    for walk, parent, child in walks:
        on, place = carrier[parent]
        for e in _with_secondary(walk) if secondary else walk:
            turned = pin.SE3(np.eye(3) if e.sign > 0 else HALF_TURNS[e.axis], np.zeros(3))
            kind = (_REVOLUTE if e.rotates else _PRISMATIC)[e.axis]()
            on = model.addJoint(on, kind, place * turned, e.name)
            model.addJointFrame(on)
            place = turned.inverse()
            elements[e.name] = e
        carrier[child] = on, place
        model.addFrame(pin.Frame(child, on, place, pin.FrameType.BODY))
    return model, elements


def _with_secondary(walk: Iterable[linkage.Element]) -> Iterable[linkage.Element]:
    """Put the secondary motions of a joint before the coordinate that they belong to."""
    for e in walk:
        yield from linkage.SECONDARY.get(e.name, ())
        yield e


class Chain:
    """A part of the linkage below a base segment: its variables, and which segments they move.

    All joints of its models have one degree of freedom: joint k has entry k - 1 of configurations.

    Parameters
    ----------
    root : str
        Base segment, free in the laboratory (six coordinates).
    segments : tuple of str
        Segments of the part, the base included.
    free : tuple of str
        Joint parameters whose derivatives are wanted, and variables of secondary motions (names of
        `SECONDARY` with one of `BENDS`). Those of joints outside the part are left out.
    reactions : bool
        Whether the knees have their locked reaction joints.
    secondary : bool
        Whether the knees' secondary motions are joints, whose values are prescribed.

    Attributes
    ----------
    coordinates : tuple of str
        Names of the nq coordinates, each after those before it in the linkage.
    free : tuple of str
        Names of the np free joint parameters and secondary variables.
    variables : tuple of str
        Coordinates, reactions, then the free ones: n names.
    joints : tuple of str
        Names of the nv joints of its models.
    at_variables : (n,) array
        Entry in configurations of the joint that each variable moves.
    segment_joint : (ns,) array
        Joint that carries each segment.
    frames_when_locked : array
        Frames of the joints, then of the segments, in a model with all joints locked.
    parents : (nq,) array
        Index of the last coordinate before each coordinate; -1 without one.
    segment_coordinate : (ns,) array
        Index of the last coordinate that moves each segment.
    support : (n, ns) array
        1 where a variable moves a segment.
    moved_sets : array
        The distinct rows of `support`.
    moved_set : (n,) array
        The row of `moved_sets` of each variable.
    after : (nv, nv) array
        Whether joint i + 1 is joint j + 1, or comes after it on the way from the ground.
    """

    def __init__(
        self,
        root: str = "pelvis",
        segments: tuple[str, ...] = linkage.SEGMENTS,
        free: tuple[str, ...] = (),
        *,
        reactions: bool = False,
        secondary: bool = False,
    ) -> None:
        self.root = root
        self.segments = tuple(s for s in linkage.SEGMENTS if s in segments)
        secondary = secondary or any(name in linkage.SECONDARY_VARIABLES for name in free)
        self._asked = (root, self.segments, free, reactions, secondary)
        self._open_model, self.elements = _open_model(root, self.segments, reactions, secondary)
        passed = list(self.elements)

        # variables, by what their values come from
        moving = [n for n in passed if self.elements[n].source is linkage.Source.COORDINATE]
        self.coordinates = tuple(
            n for n in moving if n not in {*linkage.REACTIONS, *linkage.SECONDARY_NAMES}
        )
        motions = {name: motion for name, (_, motion, _) in linkage.SECONDARY_VARIABLES.items()}
        self.free = tuple(n for n in free if motions.get(n, n) in self.elements)
        self.variables = (
            *self.coordinates,
            *(n for n in moving if n in linkage.REACTIONS),
            *self.free,
        )

        # joints of the open model: where the values of parameters go, and which are locked
        parameters = [
            n for n in passed if self.elements[n].source is linkage.Source.JOINT_PARAMETER
        ]
        zeros = [n for n in passed if self.elements[n].source is linkage.Source.ZERO_ANGLE]
        self._at_parameters = [passed.index(n) for n in parameters]
        self._parameters = [JP_INDEX[n] for n in parameters]
        self._at_zeros = [passed.index(n) for n in zeros]
        self._zeros = [linkage.ZERO_ANGLES.index(n) for n in zeros]
        locked = {n for n in (*parameters, *zeros) if n not in self.free}
        self._locked = [passed.index(n) + 1 for n in passed if n in locked]

        # joints of the models that are built
        self.joints = tuple(n for n in passed if n not in locked)
        free_parameters = [n for n in self.free if n in JP_INDEX]
        self.free_parameters = [JP_INDEX[n] for n in free_parameters]
        self.at_free = [self.joints.index(n) for n in free_parameters]
        self.at_variables = np.array([self.joints.index(motions.get(n, n)) for n in self.variables])
        self.at_coordinates = self.at_variables[: len(self.coordinates)]
        self.at_secondary = {
            coordinate: [self.joints.index(e.name) for e in elements]
            for coordinate, elements in linkage.SECONDARY.items()
            if secondary and coordinate in self.coordinates
        }
        """Coordinate -> entries of its secondary motions, in their order."""
        self._template = pin.buildReducedModel(
            self._open_model, self._locked, np.zeros(len(passed))
        )
        self.segment_frame = [self._template.getFrameId(s) for s in self.segments]
        every = list(range(1, self._template.njoints))
        locked_too = pin.buildReducedModel(self._template, every, np.zeros(self._template.nq))
        self.frames_when_locked = [
            locked_too.getFrameId(name) for name in (*self.joints, *self.segments)
        ]
        carriers = [self._template.frames[k].parentJoint for k in self.segment_frame]
        self.segment_joint = np.array(carriers, dtype=np.intp)
        supports = [list(support) for support in self._template.supports]
        self.after = np.array(
            [np.isin(np.arange(1, len(supports)), on_way) for on_way in supports[1:]]
        )
        self.support: Array = self.after[self.segment_joint - 1][:, self.at_variables].T.astype(
            float
        )
        # coordinates are numbered along the linkage: the last one on the way is the nearest
        on_way = self.after[self.at_coordinates][:, self.at_coordinates] & ~np.eye(
            len(self.coordinates), dtype=bool
        )
        self.parents = [_find_last(row) for row in on_way]
        self.segment_coordinate = [
            _find_last(row) for row in self.support[: len(self.coordinates)].T
        ]
        self.moved_sets, row_of = np.unique(self.support, axis=0, return_inverse=True)
        self.moved_set: IntArray = row_of.ravel()

    def __reduce__(self) -> tuple[Any, ...]:
        return _make_chain, self._asked

    @contextmanager
    def lend_work_space(self) -> Iterator[pin.Data]:
        """Lend a work space of Pinocchio's algorithms to one user at a time.

        It depends on the structure of a model alone. With 100 joints it has 35 MB and takes a tenth
        of a second to make. Idle work spaces are kept for the next user, of any thread, up to
        `IDLE_BYTES`.

        Yields
        ------
        pin.Data
            Work space of the models of this chain.
        """
        with _idle_lock:
            found = next((k for k, (chain, _) in enumerate(_idle) if chain is self), None)
            data = None if found is None else _idle.pop(found)[1]
        data = data or self._template.createData()
        try:
            yield data
        finally:
            with _idle_lock:
                _idle.append((self, data))
                while (
                    len(_idle) > 1
                    and sum(_compute_work_space_bytes(chain) for chain, _ in _idle) > IDLE_BYTES
                ):
                    _idle.pop(0)

    def with_secondary(self) -> "Chain":
        """Find the chain with the knees' secondary motions as joints."""
        root, segments, free, reactions, _ = self._asked
        return _make_chain(root, segments, free, reactions, True)

    def body(self, parameters: Parameters) -> "LinkageModel":
        """Lock all joints but coordinates, reactions, free and secondary ones.

        Parameters
        ----------
        parameters : Parameters
            Values of the locked and the free joints, m and rad.

        Returns
        -------
        LinkageModel
            Shared by all callers with the same chain and parameters; must not be changed.
        """
        values = np.zeros(self._open_model.nq)
        values[self._at_parameters] = parameters.joint[self._parameters]
        values[self._at_zeros] = parameters.zero_angles[self._zeros]
        return _lock_joints(
            self, values.tobytes(), parameters.joint[self.free_parameters].tobytes()
        )

    def build_locked_model(self, values: Array) -> pin.Model:
        """Lock all other joints at `values` of the joints of the open model."""
        return pin.buildReducedModel(self._open_model, self._locked, values)


IDLE_BYTES = 192 << 20
"""Of idle work spaces: those of some chains of a calibration with all joint parameters free."""
_idle: list[tuple[Chain, pin.Data]] = []
_idle_lock = threading.Lock()


def _compute_work_space_bytes(chain: Chain) -> int:
    """Compute the size of a work space: mostly four tensors of (joints, joints, joints)."""
    return 4 * 8 * len(chain.joints) ** 3


@lru_cache(maxsize=32)
def _lock_joints(chain: Chain, values: bytes, free: bytes) -> "LinkageModel":
    return LinkageModel(chain, chain.build_locked_model(np.frombuffer(values)), np.frombuffer(free))


def _find_last(flags: Array | BoolArray) -> int:
    """Find the index of the last entry that is set; -1 where none is."""
    found = np.flatnonzero(flags)
    return int(found[-1]) if len(found) else -1


@dataclass(frozen=True, eq=False)
class LinkageModel:
    """A chain with its parameters: a Pinocchio model in which each variable is a joint."""

    chain: Chain
    model: pin.Model
    """Its joint placements hold the locked joint parameters. Massless until `set_inertias`."""
    free_values: Array
    """Values of the free joint parameters (m, rad)."""

    def with_free(self, parameters: Parameters) -> "LinkageModel":
        """Give the free joint parameters other values: nothing is built anew."""
        return replace(self, free_values=parameters.joint[self.chain.free_parameters])

    @cached_property
    def segment_placement(self) -> list[pin.SE3]:
        """(ns,) each segment in the frame of the joint that carries it."""
        return [self.model.frames[k].placement for k in self.chain.segment_frame]

    @cached_property
    def rest(self) -> tuple[Array, Array]:
        """Place joints (nv + 1, 4, 3), the ground first, and segments (ns, 4, 3) with all
        coordinates at zero.

        Axes, and origin (m), in the laboratory.
        """
        (values,) = self.fill_configurations(np.zeros((1, len(self.chain.coordinates))))
        # with all joints locked, each is a frame of the ground
        locked = pin.buildReducedModel(self.model, list(range(1, self.model.njoints)), values)
        frames = [locked.frames[k].placement.homogeneous for k in self.chain.frames_when_locked]
        placed = np.array([np.eye(4), *frames])[:, :3].transpose(0, 2, 1)
        joints = len(self.chain.joints) + 1
        return placed[:joints], placed[joints:]

    def index(self, name: str) -> int:
        """Find the entry of a coordinate, free joint parameter or reaction in configurations."""
        return self.chain.joints.index(name)

    def fill_configurations(self, q: Array) -> Array:
        """Fill in the values of all joints of the model.

        Parameters
        ----------
        q : (nf, nq) array
            Coordinates, m and rad.

        Returns
        -------
        (nf, nv) array
            Configurations; free joint parameters have their values, all others are zero.
        """
        out = np.zeros((len(q), self.model.nv))
        out[:, self.chain.at_coordinates] = q
        out[:, self.chain.at_free] = self.free_values
        return out

    def set_inertias(self, bodies: dict[str, pin.Inertia]) -> None:
        """Give segments their inertias, each in the axes and about the origin of its segment."""
        placements = zip(
            self.chain.segments, self.chain.segment_joint, self.segment_placement, strict=True
        )
        for segment, joint, placement in placements:
            if segment in bodies:
                self.model.inertias[int(joint)] = placement.act(bodies[segment])


def _make_inertias(inertial: Array) -> dict[str, pin.Inertia]:
    """Make the Pinocchio inertias of inertial parameters.

    Parameters
    ----------
    inertial : (ni,) array
        kg, m, kg m^2 in the order of `parameters.IP_NAMES`.

    Returns
    -------
    dict
        Massive segment -> inertia in the segment's frame.

    Notes
    -----
    The published cost may give bodies that cannot exist. They are reported elsewhere. Pinocchio's
    constructor would refuse them, so the fields are set one by one.
    """
    out = {}
    for segment, row in zip(MASSIVE_SEGMENTS, view_as_table(inertial), strict=True):
        body = pin.Inertia.Zero()
        body.mass, body.lever, body.inertia = float(row[0]), row[1:4], np.diag(row[4:7])
        out[segment] = body
    return out


def get_chain(
    root: str = "pelvis",
    segments: tuple[str, ...] = linkage.SEGMENTS,
    free: tuple[str, ...] = (),
    *,
    reactions: bool = False,
    secondary: bool = False,
) -> Chain:
    """Get the chain of a part of the linkage, made once for all trials.

    Parameters
    ----------
    root, segments : str and tuple of str
        Base segment, and the segments of the part, the base included.
    free : tuple of str
        Free joint parameters and secondary variables; other names are left out.
    reactions, secondary : bool
        As in `Chain`.

    Returns
    -------
    Chain
        The same object for the same arguments.
    """
    known = tuple(name for name in free if name in JP_INDEX or name in linkage.SECONDARY_VARIABLES)
    return _make_chain(root, segments, known, reactions, secondary)


@lru_cache(maxsize=64)
def _make_chain(
    root: str, segments: tuple[str, ...], free: tuple[str, ...], reactions: bool, secondary: bool
) -> Chain:
    return Chain(root, segments, free, reactions=reactions, secondary=secondary)


def build_linkage(
    parameters: Parameters,
    free: tuple[str, ...] = (),
    *,
    root: str = "pelvis",
    segments: tuple[str, ...] = linkage.SEGMENTS,
    reactions: bool = False,
    secondary: bool = False,
) -> LinkageModel:
    """Build the linkage, or a part of it, with its inertias.

    Parameters
    ----------
    parameters : joint parameters, inertial parameters and zero angles, SI units.
    free : joint parameters that stay joints, whose coordinates are their values.
    root, segments : base segment, and the segments of the part, the base included.
    reactions : whether the knees carry their locked reaction joints.
    secondary : whether the knees' secondary motions are joints, whose values are prescribed.
    """
    kept = get_chain(root, segments, free, reactions=reactions, secondary=secondary).body(
        parameters
    )
    body = replace(kept, model=kept.model.copy())
    body.set_inertias(_make_inertias(parameters.inertial))
    return body


@with_one_blas_thread
def build_model(model: SubjectModel | Parameters) -> pin.Model:
    """Build the 27-degree-of-freedom model with all joint parameters in its joint placements.

    Parameters
    ----------
    model : SubjectModel or Parameters
        A person's model, or the parameters alone: joint and inertial ones and zero angles, SI
        units.

    Returns
    -------
    pinocchio.Model
        Coordinates in the order of `gaitcal.COORDINATES` (m, rad); y up, gravity along -y. Segment
        frames are body frames with the names of the segments.
    """
    return build_linkage(model.parameters if isinstance(model, SubjectModel) else model).model
