"""The linkage as a `pinocchio.Model`: the whole body or a part of it, with any joint parameters free.

Every element of the linkage (`linkage.py`) is a joint of one degree of freedom here: coordinates,
joint parameters and zero angles alike, in one *open* model for each part of the body. Where their
values are known, `pin.buildReducedModel` locks the joint parameters and zero angles: they become
the joint placements of the *body*, a `LinkageModel`. A joint parameter that is left free stays a
joint, constant in time, whose coordinate is its value. Pinocchio's derivatives by it are those of
the joint parameter, and nothing is built anew when it changes.

Two more kinds of joints may be there. The *reactions* are locked: the generalised forces of these
joints are the knees' internal abduction moments. The *secondary motions* of the knees (`SECONDARY`)
are prescribed: they have amounts in every frame, which may depend on unknowns of their own.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, IntArray
from gaitcal.model import linkage
from gaitcal.model.parameters import JP_INDEX, MASSIVE_SEGMENTS, Parameters, table
from gaitcal.model.subject_model import GRAVITY
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
    """Build the model in which every element is a joint, named like the element; and these elements."""
    model = pin.Model()
    model.name = "gaitcal"
    model.gravity.linear = np.array([0.0, -GRAVITY, 0.0])
    elements: dict[str, linkage.Element] = {}
    # segment -> the joint that carries it, and its placement in the frame of that joint
    carrier: dict[str, tuple[int, pin.SE3]] = {"": (0, pin.SE3.Identity())}
    walks = [(linkage.root_elements(root), "", root)]
    for joint in linkage.JOINTS:
        if joint.child in segments and joint.child != root:
            walks.append((linkage.joint_elements(joint, reactions=reactions), joint.parent, joint.child))
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

    Parameters
    ----------
    root : base segment, free in the laboratory (six coordinates).
    segments : segments of the part, the base included.
    free : joint parameters whose derivatives are wanted, and variables of secondary motions (names of
        `SECONDARY` with one of `BENDS`); those that the part does not pass are left out.
    reactions : whether the knees carry their locked reaction joints (two more coordinates).

    Attributes
    ----------
    coordinates : names of the nq coordinates, each after those before it in the linkage.
    free : names of the np free joint parameters and secondary variables.
    support : (nq + np, ns) 1 where a coordinate or a free variable moves a segment.
    moved_sets : (n, ns) the distinct rows of `support`.
    moved_set : (nq + np,) which of them each variable has.
    """

    def __init__(
        self,
        root: str = "pelvis",
        segments: tuple[str, ...] = linkage.SEGMENTS,
        free: tuple[str, ...] = (),
        *,
        reactions: bool = False,
    ) -> None:
        self.root, self.reactions = root, reactions
        self._parts: dict[bool, _Parts] = {}
        self.segments = tuple(s for s in linkage.SEGMENTS if s in segments)
        secondary_variables = {
            element.name + bend: (coordinate, element, k)
            for coordinate, motions in linkage.SECONDARY.items()
            for element in motions
            for k, bend in enumerate(linkage.BENDS)
        }
        asked = any(name in secondary_variables for name in free)
        model, elements = _open_model(root, self.segments, reactions, asked)
        self.coordinates: tuple[str, ...] = tuple(
            name
            for name, e in elements.items()
            if e.source is linkage.Source.COORDINATE and name not in linkage.SECONDARY_NAMES
        )
        known = {name: elements.get(v[1].name) for name, v in secondary_variables.items()}
        self.free: tuple[str, ...] = tuple(name for name in free if name in elements or known.get(name))
        self.secondary: dict[str, tuple[str, str, int]] = {
            name: (coordinate, element.name, k)
            for name, (coordinate, element, k) in secondary_variables.items()
            if name in self.free
        }
        """Free secondary variable -> its coordinate, its motion, and its index in `BENDS`."""

        of_segment = [set(model.supports[model.frames[model.getFrameId(s)].parentJoint]) for s in self.segments]
        joints = [model.getJointId(self.motion_of(name)) for name in (*self.coordinates, *self.free)]
        self.support: Array = np.array([[float(joint in passed) for passed in of_segment] for joint in joints])
        self.moved_sets, row_of = np.unique(self.support, axis=0, return_inverse=True)
        self.moved_set: IntArray = row_of.ravel()

    def motion_of(self, variable: str) -> str:
        """Name the joint of the model that a variable moves: itself, but for secondary variables."""
        return self.secondary[variable][1] if variable in self.secondary else variable

    def __reduce__(self) -> tuple[Any, ...]:
        return _chain, (self.root, self.segments, self.free, self.reactions)

    def parts(self, secondary: bool) -> "_Parts":
        """Find out once where the variables are in the models of this chain."""
        if secondary not in self._parts:
            self._parts[secondary] = _Parts(self, secondary=secondary)
        return self._parts[secondary]

    def body(self, parameters: Parameters, *, secondary: bool = False) -> "LinkageModel":
        """Lock all joints but coordinates, free variables and secondary motions at their values.

        Parameters
        ----------
        parameters : values of joint parameters and zero angles (m, rad).
        secondary : whether the knees' secondary motions are joints of the model.
        """
        parts = self.parts(secondary or bool(self.secondary))
        values = np.zeros(parts.open_model.nq)
        values[parts.at_joint_parameters] = parameters.joint[parts.joint_parameters]
        values[parts.at_zero_angles] = parameters.zero_angles[parts.zero_angles]
        model = pin.buildReducedModel(parts.open_model, parts.locked, values)
        return LinkageModel(self, parts, model, parameters.joint[parts.free_joint_parameters])


class _Parts:
    """Where the variables of a chain are in the open model, and in the model that is built of it.

    All joints have one degree of freedom: joint k has entry k - 1 of configuration and velocity.
    """

    def __init__(self, chain: Chain, *, secondary: bool) -> None:
        self.open_model, elements = _open_model(chain.root, chain.segments, chain.reactions, secondary)
        names = list(elements)
        parameters = [n for n in names if elements[n].source is linkage.Source.JOINT_PARAMETER]
        zeros = [n for n in names if elements[n].source is linkage.Source.ZERO_ANGLE]
        self.at_joint_parameters = np.array([names.index(n) for n in parameters], dtype=np.intp)
        self.joint_parameters = np.array([JP_INDEX[n] for n in parameters], dtype=np.intp)
        self.at_zero_angles = np.array([names.index(n) for n in zeros], dtype=np.intp)
        self.zero_angles = np.array([linkage.ZERO_ANGLES.index(n) for n in zeros], dtype=np.intp)
        locked = [n for n in (*parameters, *zeros) if n not in chain.free]
        self.locked = [names.index(n) + 1 for n in locked]

        kept = [n for n in names if n not in locked]
        self.names: tuple[str, ...] = tuple(kept)
        """(nv,) names of the joints of the model that is built."""
        free = [n for n in chain.free if n in JP_INDEX]
        self.free_joint_parameters = np.array([JP_INDEX[n] for n in free], dtype=np.intp)
        self.at_free = np.array([kept.index(n) for n in free], dtype=np.intp)
        self.at_coordinates = np.array([kept.index(n) for n in chain.coordinates], dtype=np.intp)
        motions = [chain.motion_of(n) for n in (*chain.coordinates, *chain.free)]
        self.at_variables = np.array([kept.index(n) for n in motions], dtype=np.intp)
        """(nq + np,) joint that each variable moves."""
        self.at_secondary = {
            coordinate: np.array([kept.index(e.name) for e in motions], dtype=np.intp)
            for coordinate, motions in linkage.SECONDARY.items()
            if secondary and coordinate in chain.coordinates
        }
        """Coordinate -> joints of its secondary motions, in their order."""
        self.signs = np.array([elements[n].sign for n in kept])
        """(nv,) -1 of a joint in a frame that is turned by half about its neighbour's axis."""
        self.axes = np.array([elements[n].axis for n in kept], dtype=np.intp)
        self.rotates = np.array([elements[n].rotates for n in kept], dtype=bool)
        # the structure of all models that are built: the same for any values of the locked joints
        template = pin.buildReducedModel(self.open_model, self.locked, np.zeros(self.open_model.nq))
        self.segment_frame = [template.getFrameId(s) for s in chain.segments]
        self.segment_joint = np.array([template.frames[k].parentJoint for k in self.segment_frame], dtype=np.intp)
        """(ns,) joint of the model that carries each segment."""
        self.supports = [list(support) for support in template.supports]
        """(nv + 1,) joints on the way from the ground to each joint, the ground and the joint included."""
        self.after = np.array([np.isin(np.arange(1, len(kept) + 1), support) for support in self.supports[1:]])
        """(nv, nv) whether joint i + 1 is joint j + 1, or comes after it on the way from the ground."""
        self._chain, self._secondary, self._template = chain, secondary, template
        self._of_thread = threading.local()

    def __reduce__(self) -> tuple[Any, ...]:
        return Chain.parts, (self._chain, self._secondary)

    @property
    def data(self) -> pin.Data:
        """Work space of Pinocchio's algorithms, one for each thread.

        It depends on the structure of the model alone. With 100 joints it is 50 MB, of tensors that
        are not used here: too large to be made for each model.
        """
        if not hasattr(self._of_thread, "data"):
            self._of_thread.data = self._template.createData()
        found: pin.Data = self._of_thread.data
        return found


@dataclass(frozen=True, eq=False)
class LinkageModel:
    """A chain with its parameters: a Pinocchio model in which each variable is a joint."""

    chain: Chain
    parts: _Parts
    model: pin.Model
    """Its joint placements hold the locked joint parameters. Massless until `set_inertias`."""
    free_values: Array
    """Values of the free joint parameters (m, rad)."""

    @property
    def data(self) -> pin.Data:
        """Work space of Pinocchio's algorithms, which all models of this structure share."""
        return self.parts.data

    @cached_property
    def segment_placement(self) -> list[pin.SE3]:
        """(ns,) each segment in the frame of the joint that carries it."""
        return [self.model.frames[k].placement for k in self.parts.segment_frame]

    def index(self, name: str) -> int:
        """Find the entry of a coordinate, free joint parameter or reaction in configurations."""
        return self.parts.names.index(name)

    def configurations(self, q: Array) -> Array:
        """Fill in all joints (nf, nv) at coordinates (nf, nq); free joint parameters have their values."""
        out = np.zeros((len(q), self.model.nv))
        out[:, self.parts.at_coordinates] = q
        out[:, self.parts.at_free] = self.free_values
        return out

    def set_inertias(self, bodies: dict[str, pin.Inertia]) -> None:
        """Give segments their inertias, each in the axes and about the origin of its segment."""
        for segment, joint, placement in zip(
            self.chain.segments, self.parts.segment_joint, self.segment_placement, strict=True
        ):
            if segment in bodies:
                self.model.inertias[int(joint)] = placement.act(bodies[segment])


def inertias(inertial: Array) -> dict[str, pin.Inertia]:
    """Make the bodies of inertial parameters (ni,): massive segment -> inertia in the segment's frame.

    The published cost may return bodies that cannot exist. These are reported elsewhere, so the
    inertias are filled in piece by piece: Pinocchio's constructor would refuse them.
    """
    out = {}
    for segment, row in zip(MASSIVE_SEGMENTS, table(inertial), strict=True):
        body = pin.Inertia.Zero()
        body.mass, body.lever, body.inertia = float(row[0]), row[1:4], np.diag(row[4:7])
        out[segment] = body
    return out


@lru_cache(maxsize=64)
def chain_of(
    root: str = "pelvis",
    segments: tuple[str, ...] = linkage.SEGMENTS,
    free: tuple[str, ...] = (),
    *,
    reactions: bool = False,
) -> Chain:
    """Make the chain of a part of the linkage once: every trial of a person has the same."""
    return Chain(root, segments, free, reactions=reactions)


def _chain(root: str, segments: tuple[str, ...], free: tuple[str, ...], reactions: bool) -> Chain:
    """Find a chain that another process has sent."""
    return chain_of(root, segments, free, reactions=reactions)


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
    body = chain_of(root, segments, free, reactions=reactions).body(parameters, secondary=secondary)
    body.set_inertias(inertias(parameters.inertial))
    return body


@with_one_blas_thread
def build_model(parameters: Parameters) -> pin.Model:
    """Build the 27-degree-of-freedom model with all joint parameters in its joint placements.

    Parameters
    ----------
    parameters : joint parameters, inertial parameters and zero angles, SI units.

    Returns
    -------
    Coordinates in the order of `gaitcal.COORDINATES` (m, rad); y up, gravity along -y. Segment frames
    are body frames with the names of the segments.
    """
    return build_linkage(parameters).model
