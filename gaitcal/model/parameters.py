"""All parameters of one person's linkage: joint parameters, inertial parameters, zero angles.

Joint parameters (JPs) are the positions and orientations of each joint in the two segments that it
connects. The tables of `linkage.py` define them; this module lists them in the order of files and
arrays. Reinbolt et al., IEEE TBME 2007, Table II lists the 27 of one leg. The lists for back,
shoulder and elbow (6, 10, 9) are the natural split of the remaining 98 - 2 * 27 = 44. Positions are
`ant sup lat` (x y z), orientations `front trans sag` (about x, y, z) of the segment's frame: x
anterior, y superior, z to the right on both sides. A left value is the mirror image z -> -z of the
right one.

Inertial parameters (IPs) are mass, mass centre and principal moments of the segments that have
mass. Moments are about the mass centre, principal axes parallel to the segment axes. The talus is
massless. The 36 symmetric IPs (left = right) are those of Reinbolt et al. 2007, Table IV, without
`foot superior`.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.display import Displayed, shorten
from gaitcal.io.toml import find_models_folder
from gaitcal.model import linkage

MASSIVE_SEGMENTS: tuple[str, ...] = tuple(
    s for s in linkage.SEGMENTS if linkage.get_segment(s).parts
)
"""Those with inertia: row s of a (ns, 7) table of IPs is [mass, com x y z, moment x y z]."""

QUANTITIES = ("mass", "com.ant", "com.sup", "com.lat", "moi.ant", "moi.sup", "moi.lat")
UNITS = ("kg", "mm", "mm", "mm", "kg*mm^2", "kg*mm^2", "kg*mm^2")
_TO_SI = (1.0, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6)

IP_NAMES: tuple[str, ...] = tuple(f"{s}.{q}" for s in MASSIVE_SEGMENTS for q in QUANTITIES)
"""All, in the order of every (ni,) array of inertial parameters (kg, m, kg m^2)."""

IP_INDEX: dict[str, int] = {name: i for i, name in enumerate(IP_NAMES)}
IP_UNITS: tuple[str, ...] = UNITS * len(MASSIVE_SEGMENTS)
IP_TO_SI: Array = np.array(
    _TO_SI * len(MASSIVE_SEGMENTS)
)  # (ni,) factors from kg, mm, kg mm^2 to SI


@dataclass(frozen=True)
class InertialSet:
    """Free variables x of an IP calibration: IPs = selection @ x; others keep their values."""

    # of the free variables: `pelvis.mass`, `thigh.com.sup`, ... or the IP names (all)
    names: tuple[str, ...]
    selection: Array
    """(ni, n): column k holds the factors (1, or -1 for a mirrored coordinate) with which variable
    k enters the IPs.
    """


def make_symmetric_set() -> InertialSet:
    """Make the set of symmetric IPs (left = right).

    Returns
    -------
    InertialSet
        Masses, mass-centre coordinates in `free_centre`, and moments.
    """
    centres = {row.name: row.free_centre for row in linkage.SEGMENT_TABLE.values() if row.parts}
    masses, moments = (
        dict.fromkeys(centres, ("mass",)),
        dict.fromkeys(centres, ("moi.ant", "moi.sup", "moi.lat")),
    )
    free = [
        (body, q)
        for group in (masses, centres, moments)
        for body, quantities in group.items()
        for q in quantities
    ]
    selection = np.zeros((len(IP_NAMES), len(free)))
    for k, (body, quantity) in enumerate(free):
        for segment in MASSIVE_SEGMENTS:
            if linkage.get_segment(segment).name == body:
                selection[IP_INDEX[f"{segment}.{quantity}"], k] = 1.0
    return InertialSet(tuple(f"{body}.{quantity}" for body, quantity in free), selection)


def make_full_set() -> InertialSet:
    """Make the set in which each IP is free."""
    return InertialSet(IP_NAMES, np.eye(len(IP_NAMES)))


def view_as_table(inertial: Array) -> Array:
    """View (ni,) inertial parameters as a table (ns, 7): mass, mass centre, moments."""
    return inertial.reshape(len(MASSIVE_SEGMENTS), len(QUANTITIES))


_DIAGONAL, _OFF_DIAGONAL = ((0, 4), (1, 6), (2, 9)), ((0, 1, 5), (0, 2, 7), (1, 2, 8))
"""Axes, and where the ten dynamic parameters hold their entry of the inertia."""


def compute_dynamic_parameters(inertial: Array) -> Array:
    """Compute the parameters in which the dynamics is linear.

    Parameters
    ----------
    inertial : (ni,) array
        Inertial parameters, SI units.

    Returns
    -------
    (ns, 10) array
        m, m c, and the inertia about the segment origin, in Pinocchio's order: m, mcx, mcy, mcz,
        Ixx, Ixy, Iyy, Ixz, Iyz, Izz; kg, kg m, kg m^2.
    """
    rows = view_as_table(inertial)
    m, c, moments = rows[:, 0], rows[:, 1:4], rows[:, 4:7]
    out = np.empty((len(rows), 10))
    out[:, 0] = m
    out[:, 1:4] = m[:, None] * c
    square = np.sum(c * c, axis=1)
    for axis, column in _DIAGONAL:
        out[:, column] = moments[:, axis] + m * (square - c[:, axis] ** 2)
    for a, b, column in _OFF_DIAGONAL:
        out[:, column] = -m * c[:, a] * c[:, b]
    return out


def compute_dynamic_jacobian(inertial: Array) -> Array:
    """Compute the derivative of `compute_dynamic_parameters`.

    Parameters
    ----------
    inertial : (ni,) array
        Inertial parameters, SI units.

    Returns
    -------
    (ns, 10, 7) array
        Derivative by the seven IPs of the same segment.
    """
    rows = view_as_table(inertial)
    m, c = rows[:, 0], rows[:, 1:4]
    jac = np.zeros((len(rows), 10, 7))
    jac[:, 0, 0] = 1.0
    square = np.sum(c * c, axis=1)
    for axis in range(3):
        jac[:, 1 + axis, 0] = c[:, axis]
        jac[:, 1 + axis, 1 + axis] = m
    for axis, column in _DIAGONAL:
        jac[:, column, 0] = square - c[:, axis] ** 2
        jac[:, column, 4 + axis] = 1.0
        for other in range(3):
            if other != axis:
                jac[:, column, 1 + other] = 2.0 * m * c[:, other]
    for a, b, column in _OFF_DIAGONAL:
        jac[:, column, 0] = -c[:, a] * c[:, b]
        jac[:, column, 1 + a] = -m * c[:, b]
        jac[:, column, 1 + b] = -m * c[:, a]
    return jac


def is_physical(inertial: Array) -> BoolArray:
    """Return which segments are physically possible (pseudo-inertia > 0).

    Parameters
    ----------
    inertial : (ni,) array
        Inertial parameters, SI units.

    Returns
    -------
    (ns,) bool array
        Whether mass and moments are positive and moments obey the triangle inequality.
    """
    rows = view_as_table(inertial)
    moments = np.sort(rows[:, 4:7], axis=1)
    return (rows[:, 0] > 0) & (moments[:, 0] > 0) & (moments[:, 0] + moments[:, 1] > moments[:, 2])


def find_impossible_bodies(inertial: Array) -> tuple[str, ...]:
    """Find the segments whose inertial parameters no real body can have."""
    return tuple(
        s
        for s, possible in zip(MASSIVE_SEGMENTS, is_physical(inertial), strict=True)
        if not possible
    )


class ParameterKind(Enum):
    """Kind of a joint parameter: position (mm in files, m inside) or orientation (deg, rad)."""

    POSITION = "position"
    ORIENTATION = "orientation"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "mm" if self is ParameterKind.POSITION else "deg"

    @property
    def to_si(self) -> float:
        """Factor from the unit in files to m or rad."""
        return 1e-3 if self is ParameterKind.POSITION else float(np.pi / 180.0)


@dataclass(frozen=True, kw_only=True)
class JointParameter:
    """One joint parameter of the catalogue."""

    name: str  # for example `hip_r.pelvis.ant`
    joint: str  # `hip_r`, `back`, ...
    segment: str  # in whose frame it is measured: `pelvis`, `thigh_r`, ...
    kind: ParameterKind
    # 0, 1, 2: the coordinate (position) or the axis turned about (orientation)
    axis: int

    @property
    def mirrored(self) -> bool:
        """Whether the left value has the opposite sign of the right one."""
        lateral = self.axis == 2
        return lateral if self.kind is ParameterKind.POSITION else not lateral


def _list_joint_parameters() -> Iterator[JointParameter]:
    """List all joint parameters, joint by joint.

    The parent's come before the child's, orientations before positions, each by axis.
    """
    for joint in linkage.JOINTS:
        moves = next(
            i for i, e in enumerate(joint.elements) if e.source is linkage.Source.COORDINATE
        )
        for segment, elements in (
            (joint.parent, joint.elements[:moves]),
            (joint.child, joint.elements[moves:]),
        ):
            for e in sorted(elements, key=lambda e: (not e.rotates, e.axis)):
                if e.source is linkage.Source.JOINT_PARAMETER:
                    kind = ParameterKind.ORIENTATION if e.rotates else ParameterKind.POSITION
                    yield JointParameter(
                        name=e.name, joint=joint.name, segment=segment, kind=kind, axis=e.axis
                    )


JOINT_PARAMETERS: tuple[JointParameter, ...] = tuple(_list_joint_parameters())
"""All, in the order of every (np,) array of joint parameters."""

JP_NAMES: tuple[str, ...] = tuple(p.name for p in JOINT_PARAMETERS)
JP_INDEX: dict[str, int] = {name: i for i, name in enumerate(JP_NAMES)}
JP_TO_SI: Array = np.array(
    [p.kind.to_si for p in JOINT_PARAMETERS]
)  # (np,) factors from mm and deg to m and rad


def list_isolated_parameters(isolated: str) -> tuple[str, ...]:
    """List the JPs that a functional trial determines.

    Parameters
    ----------
    isolated : str
        `hip_r`, `knee_r`, `ankle_r` (or `_l`).

    Returns
    -------
    tuple of str
        6, 9 or 12 names.
    """
    joints = [joint.name for joint in linkage.list_moved_joints(isolated)]
    return tuple(p.name for p in JOINT_PARAMETERS if p.joint in joints)


def list_gait_parameters(side: str) -> tuple[str, ...]:
    """List the 17 JPs of one leg that a gait trial determines.

    They are the rows of Table II that change from the functional trials. Hip: pelvis and thigh,
    anterior and superior; knee: all nine; talocrural: all but lateral.

    Parameters
    ----------
    side : str
        `r` or `l`.

    Returns
    -------
    tuple of str
        Names in the order of `JP_NAMES`.
    """
    hip = [p for p in JOINT_PARAMETERS if p.joint == f"hip_{side}" and p.axis != 2]
    knee = [p for p in JOINT_PARAMETERS if p.joint == f"knee_{side}"]
    ankle = [p for p in JOINT_PARAMETERS if p.joint == f"talocrural_{side}"]
    ankle = [p for p in ankle if p.kind is ParameterKind.ORIENTATION or p.axis != 2]
    return tuple(p.name for p in (*hip, *knee, *ankle))


def list_leg_parameters(side: str) -> tuple[str, ...]:
    """List the JPs of one leg.

    Parameters
    ----------
    side : str
        `r` or `l`.

    Returns
    -------
    tuple of str
        Names in the order of `JP_NAMES`.
    """
    joints = [linkage.JOINT_OF_CHILD[segment].name for segment in linkage.LEGS[side]]
    return tuple(p.name for p in JOINT_PARAMETERS if p.joint in joints)


@dataclass(frozen=True, repr=False)
class Parameters(Displayed):
    """Parameters in SI units (m, rad, kg, kg m^2). Arrays are not to be changed in place."""

    joint: Array
    """(np,) m, rad: joint parameters in the order of `gaitcal.model.parameters.JP_NAMES`."""
    inertial: Array
    """(ni,) kg, m, kg m^2: inertial parameters in the order of `gaitcal.model.parameters.IP_NAMES`.
    """
    zero_angles: Array
    """(nz,) rad: constants that make zero ankle coordinates the posture with the foot at right
    angles to the shank, in the order of `gaitcal.model.linkage.ZERO_ANGLES`."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        rows = []
        for label, names, values, units in (
            ("joint", JP_NAMES, self.joint, "m, rad"),
            ("inertial", IP_NAMES, self.inertial, "kg, m, kg m^2"),
            ("ankle zeros", linkage.ZERO_ANGLES, self.zero_angles, "rad"),
        ):
            parts = [f"{name} {value:.3g}" for name, value in zip(names, values, strict=True)]
            rows.append((label, f"{len(names)} ({units}): {shorten(parts, 3)}"))
        return "Parameters", rows

    def with_joint(self, names: tuple[str, ...], values: Array) -> "Parameters":
        """Return a copy with some joint parameters (m, rad) replaced."""
        joint = self.joint.copy()
        joint[[JP_INDEX[name] for name in names]] = values
        return replace(self, joint=joint)

    def with_inertial(self, inertial: Array) -> "Parameters":
        """Return a copy with other inertial parameters (ni,)."""
        return replace(self, inertial=np.array(inertial, dtype=float))

    def centre(self, joint: str, segment: str) -> Array:
        """Get the centre of a joint in an adjacent segment.

        Parameters
        ----------
        joint, segment : str
            Names of the joint and of its parent or child.

        Returns
        -------
        (3,) array
            m; a coordinate without a parameter is zero by the definition of the frames.
        """
        out = np.zeros(3)
        for p in JOINT_PARAMETERS:
            if (p.joint, p.segment, p.kind) == (joint, segment, ParameterKind.POSITION):
                out[p.axis] = self.joint[JP_INDEX[p.name]]
        return out

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return float(view_as_table(self.inertial)[:, 0].sum())


def read_published_parameters() -> Parameters:
    """Read the nominal subject of the reproduction (male, 69.4 kg, 1.70 m).

    Returns
    -------
    parameters : Parameters
        SI units, from `models/nominal_subject.json`.
    """
    data = json.loads((find_models_folder() / "nominal_subject.json").read_text(encoding="utf-8"))
    listed = data["joint_parameters"]
    joint = np.empty(len(JP_NAMES))
    for i, name in enumerate(JP_NAMES):
        joint_name, _, place = name.partition(".")
        kind, _, side = joint_name.partition("_")
        joint[i] = listed[side or "back"][f"{kind}.{place}"]
    inertial = np.empty((len(MASSIVE_SEGMENTS), 7))
    for i, segment in enumerate(MASSIVE_SEGMENTS):
        entry = data["inertial_parameters"][linkage.get_segment(segment).name.replace("_", "")]
        com = np.array(entry["com_mm"])
        com[2] *= 1.0 if not segment.endswith("_l") else -1.0
        inertial[i] = [entry["mass_kg"], *(1e-3 * com), *(1e-6 * np.array(entry["moi_kg_mm2_xyz"]))]
    zero = data["fixed_zero_offsets_deg"]
    angles = [zero["theta_tc0"], zero["theta_st0_right"], zero["theta_tc0"], zero["theta_st0_left"]]
    return Parameters(joint * JP_TO_SI, inertial.ravel(), np.deg2rad(angles))
